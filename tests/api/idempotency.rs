//! Retries: the same key and request give the same record and bytes.

use crate::server::{Server, file_form, marked, obj, other_obj, problem};

async fn send(server: &Server, key: &str, form: reqwest::multipart::Form) -> reqwest::Response {
    let request = server.client.post(server.url("/v1/watermarks")).header("idempotency-key", key);
    request.multipart(form).send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_gets_the_same_bytes_whether_kept_or_not() {
    for keep in ["true", "false"] {
        let server = Server::start().await;
        let form = || file_form(obj()).text("owner_id", "acme").text("keep_file", keep);
        let first = marked(send(&server, "k-1", form()).await).await;
        let server = server.restart().await;
        let retry = send(&server, "k-1", form()).await;
        assert_eq!(retry.headers()["idempotent-replayed"], "true");
        assert!(marked(retry).await == first, "keep_file={keep}");
        let page = server.get_json("/v1/watermarks").await;
        assert_eq!(page["watermarks"].as_array().unwrap().len(), 1);
        let another = marked(send(&server, "k-2", form()).await).await;
        assert_ne!(another.0, first.0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_request_under_the_same_key_conflicts() {
    let server = Server::start().await;
    let form = || file_form(obj()).text("owner_id", "acme");
    marked(send(&server, "k", form()).await).await;
    for other in [
        form().text("label", "x"),
        form().text("strength", "0.2"),
        form().text("keep_file", "false"),
        file_form(other_obj()).text("owner_id", "acme"),
    ] {
        problem(send(&server, "k", other).await, 409, "idempotency_conflict").await;
    }
    // The same key of another owner is another key.
    marked(send(&server, "k", file_form(obj()).text("owner_id", "other")).await).await;
    problem(send(&server, "a b", form()).await, 400, "invalid_parameter").await;
    problem(send(&server, &"k".repeat(256), form()).await, 400, "invalid_parameter").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_equal_requests_at_once_one_works() {
    let server = Server::start().await;
    let form = || file_form(obj()).text("owner_id", "acme");
    let all = futures::future::join_all((0..5).map(|_| send(&server, "k", form()))).await;
    let mut ids = Vec::new();
    for response in all {
        if response.status() == 201 {
            ids.push(marked(response).await.0);
        } else {
            assert_eq!(response.headers()["retry-after"], "1");
            problem(response, 409, "idempotency_in_progress").await;
        }
    }
    ids.dedup();
    assert_eq!(ids.len(), 1);
    let page = server.get_json("/v1/watermarks").await;
    assert_eq!(page["watermarks"].as_array().unwrap().len(), 1);
    // A refused request leaves its key free.
    let refused = file_form(b"nonsense").text("owner_id", "acme");
    let refused = send(&server, "free", refused).await;
    assert!(refused.status().is_client_error());
    marked(send(&server, "free", form()).await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_mark_is_not_handed_out_again() {
    for keep in ["true", "false"] {
        let server = Server::start().await;
        let form = || file_form(obj()).text("owner_id", "acme").text("keep_file", keep);
        let (id, _) = marked(send(&server, "k-1", form()).await).await;
        let before = server.service.blob_count().await.unwrap();
        let path = format!("/v1/watermarks/{id}");
        server.client.delete(server.url(&path)).send().await.unwrap();
        let revoked = server.get_json(&path).await;
        let body = problem(send(&server, "k-1", form()).await, 409, "idempotency_revoked").await;
        let detail = body["detail"].as_str().unwrap();
        for word in ["k-1", &id, "another Idempotency-Key"] {
            assert!(detail.contains(word), "{detail}");
        }
        // Registry and store are as they were.
        let page = server.get_json("/v1/watermarks").await;
        assert_eq!(page["watermarks"], serde_json::json!([revoked]), "keep_file={keep}");
        assert_eq!(server.service.blob_count().await.unwrap(), before);
        let other = form().text("label", "x");
        problem(send(&server, "k-1", other).await, 409, "idempotency_conflict").await;
        let (new, _) = marked(send(&server, "k-2", form()).await).await;
        assert_ne!(new, id);
    }
}
