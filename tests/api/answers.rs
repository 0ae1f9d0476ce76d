//! Parts of every answer, request ids and problem bodies, and the pages for operators.

use crate::server::{Server, obj, problem};

#[tokio::test(flavor = "multi_thread")]
async fn request_ids_are_taken_over_or_made() {
    let server = Server::start().await;
    let send = |id: &'static str| {
        server.client.get(server.url("/nowhere")).header("x-request-id", id).send()
    };
    let body = problem(send("job-7").await.unwrap(), 404, "not_found").await;
    assert_eq!(body["request_id"], "job-7");
    let body = problem(send("<script>").await.unwrap(), 404, "not_found").await;
    assert_ne!(body["request_id"], "<script>");
    assert!(server.get("/livez").await.headers().contains_key("x-request-id"));
}

#[tokio::test(flavor = "multi_thread")]
async fn methods_that_do_not_apply() {
    let server = Server::start().await;
    for (method, path) in [
        ("PUT", "/v1/watermarks"),
        ("GET", "/v1/verifications"),
        ("POST", "/v1/watermarks/0198f000-0000-7000-8000-000000000000"),
        ("POST", "/livez"),
        ("BREW", "/docs"),
    ] {
        let method = method.parse().unwrap();
        let response = server.client.request(method, server.url(path)).body(obj()).send().await;
        let response = response.unwrap();
        assert!(response.headers().contains_key("allow"), "{path}");
        problem(response, 405, "method_not_allowed").await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_for_operators() {
    let server = Server::start().await;
    for (path, kind, word) in [
        ("/livez", "application/json", "ok"),
        ("/readyz", "application/json", "ok"),
        ("/metrics", "text/plain", "quadmark_marks 0"),
        ("/openapi.yaml", "application/yaml", "/v1/watermarks/{id}/file"),
        ("/docs", "text/html", "insufficient_capacity"),
    ] {
        let response = server.get(path).await;
        assert_eq!(response.status(), 200, "{path}");
        assert!(response.headers()["content-type"].to_str().unwrap().starts_with(kind), "{path}");
        assert!(response.text().await.unwrap().contains(word), "{path}");
    }
    let metrics = server.get("/metrics").await.text().await.unwrap();
    let line = "quadmark_requests_total{route=\"/livez\",method=\"GET\",status=\"200\"} 1";
    assert!(metrics.contains(line), "{metrics}");
}
