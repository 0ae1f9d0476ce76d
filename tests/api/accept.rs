//! What the caller accepts as the answer to an embedding.

use reqwest::Response;

use crate::server::{Server, file_form, glb, obj, problem};

async fn mark(server: &Server, file: &[u8], accept: &str, query: &str) -> Response {
    let url = server.url(&format!("/v1/watermarks?owner_id=acme{query}"));
    let request = server.client.post(url).header("accept", accept);
    request.body(file.to_vec()).send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_or_the_record() {
    let server = Server::start().await;
    for (accept, kind) in [
        ("application/json, text/plain, */*", "model/obj"),
        ("*/*", "model/obj"),
        ("model/*;q=0.5, application/json;q=0.4", "model/obj"),
        ("model/obj", "model/obj"),
        ("application/json", "application/json"),
        ("application/json, model/obj;q=0.9", "application/json"),
        ("application/json, model/gltf-binary", "application/json"),
    ] {
        let response = mark(&server, obj(), accept, "").await;
        assert_eq!(response.status(), 201, "{accept}");
        assert_eq!(response.headers()["content-type"], kind, "{accept}");
    }
    // The same header answers another upload with its file.
    let response = mark(&server, glb(), "application/json;q=0.9, model/gltf-binary", "").await;
    assert_eq!(response.headers()["content-type"], "model/gltf-binary");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_nobody_takes_is_refused_before_the_work() {
    let server = Server::start().await;
    for accept in ["text/html", "*/*;q=0", "image/*, application/json;q=0"] {
        let refused = problem(mark(&server, obj(), accept, "").await, 406, "not_acceptable").await;
        assert!(refused["detail"].as_str().unwrap().contains("application/json"), "{refused}");
    }
    // The format of the upload decides. A problem is answered whatever is accepted.
    for (file, accept) in [(obj(), "model/gltf-binary"), (glb(), "model/obj, text/html")] {
        problem(mark(&server, file, accept, "").await, 406, "not_acceptable").await;
    }
    problem(mark(&server, b"nonsense", "model/obj", "").await, 415, "unknown_format").await;
    let lost = mark(&server, obj(), "application/json", "&keep_file=false").await;
    problem(lost, 400, "invalid_parameter").await;
    let lost = mark(&server, obj(), "application/json, model/gltf-binary", "&keep_file=false");
    problem(lost.await, 406, "not_acceptable").await;
    server.assert_empty("answers that nobody takes").await;
    let kept = mark(&server, obj(), "application/json, */*", "&keep_file=false").await;
    assert_eq!(
        (kept.status().as_u16(), &kept.headers()["content-type"] == "model/obj"),
        (201, true)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_answers_in_the_form_that_it_takes() {
    let server = Server::start().await;
    let send = |accept: &'static str| {
        let form = file_form(obj()).text("owner_id", "acme");
        let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
        request.header("accept", accept).header("idempotency-key", "k").send()
    };
    for (accept, kind) in [("*/*", "model/obj"), ("application/json", "application/json")] {
        let response = send(accept).await.unwrap();
        assert_eq!(response.status(), 201);
        assert_eq!(response.headers()["content-type"], kind);
    }
    problem(send("model/gltf-binary").await.unwrap(), 406, "not_acceptable").await;
}
