//! Lists, pages, revoking.

use crate::server::{Server, file_form, obj, other_obj, problem};

#[tokio::test(flavor = "multi_thread")]
async fn pages_are_newest_first() {
    let server = Server::start().await;
    let mut ids = Vec::new();
    for owner_id in ["acme", "other", "acme"] {
        ids.push(server.mark(obj(), owner_id).await.0);
    }
    ids.reverse();
    let (mut seen, mut path) = (Vec::new(), "/v1/watermarks?limit=2".to_owned());
    loop {
        let page = server.get_json(&path).await;
        for record in page["watermarks"].as_array().unwrap() {
            seen.push(record["id"].as_str().unwrap().to_owned());
        }
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        path = format!("/v1/watermarks?limit=2&cursor={cursor}");
    }
    assert_eq!(seen, ids);
    let page = server.get_json("/v1/watermarks?owner_id=other").await;
    assert_eq!(page["watermarks"].as_array().unwrap().len(), 1);
    for query in ["limit=0", "limit=201", "limit=x", "cursor=nonsense", "owner=acme", "owner_id="] {
        let refused = server.get(&format!("/v1/watermarks?{query}")).await;
        problem(refused, 400, "invalid_parameter").await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_mark_is_kept_but_not_found() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let (other_id, other_file) = server.mark(other_obj(), "acme").await;
    let path = format!("/v1/watermarks/{id}");
    for _ in 0..2 {
        let revoked = server.client.delete(server.url(&path)).send().await.unwrap();
        assert_eq!(revoked.status(), 200);
    }
    assert!(server.get_json(&path).await["revoked_at"].is_string());
    for server in [server.restart().await] {
        for form in [
            file_form(&file),
            file_form(&file).text("owner_id", "acme"),
            file_form(&file).text("watermark_id", id.clone()),
        ] {
            assert_eq!(server.verify(form).await["verdict"], "no_match");
        }
        let verdict = server.verify(file_form(&other_file)).await;
        assert_eq!(verdict["matches"][0]["watermark_id"], other_id.as_str());
        let file = server.get(&format!("{path}/file")).await;
        assert_eq!(file.status(), 200);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_there() {
    let server = Server::start().await;
    let nobody = "0198f000-0000-7000-8000-000000000000";
    for (path, code) in [
        (format!("/v1/watermarks/{nobody}"), "unknown_watermark"),
        (format!("/v1/watermarks/{nobody}/file"), "unknown_watermark"),
        (format!("/v1/verifications/{nobody}"), "unknown_verification"),
        ("/v1/watermarks/nonsense".to_owned(), "not_found"),
        ("/v2/watermarks".to_owned(), "not_found"),
        ("/".to_owned(), "not_found"),
    ] {
        problem(server.get(&path).await, 404, code).await;
    }
    let path = format!("/v1/watermarks/{nobody}");
    let gone = server.client.delete(server.url(&path)).send().await.unwrap();
    problem(gone, 404, "unknown_watermark").await;
    let form = file_form(obj()).text("watermark_id", nobody);
    problem(server.post("/v1/verifications", form).await, 404, "unknown_watermark").await;
}
