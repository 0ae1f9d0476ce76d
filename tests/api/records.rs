//! Lists, pages, revoking.

use std::time::Duration;

use quadmark::config::Settings;
use quadmark::sample::{Sample, to_obj};

use crate::server::{Server, file_form, obj, other_obj, problem};

fn ids_of(page: &serde_json::Value) -> Vec<String> {
    let records = page["watermarks"].as_array().unwrap();
    records.iter().map(|record| record["id"].as_str().unwrap().to_owned()).collect()
}

/// The records registered after a cursor, in order, and the cursor to continue from.
async fn poll(server: &Server, from: Option<String>) -> (Vec<String>, Option<String>) {
    let (mut seen, mut resume) = (Vec::new(), from);
    loop {
        let from = resume.as_ref().map(|cursor| format!("&cursor={cursor}")).unwrap_or_default();
        let page = server.get_json(&format!("/v1/watermarks?order=oldest&limit=2{from}")).await;
        seen.extend(ids_of(&page));
        resume = page["resume_cursor"].as_str().map(str::to_owned);
        if page["next_cursor"].is_null() {
            return (seen, resume);
        }
    }
}

/// The slow mark draws its id first and is registered last.
#[tokio::test(flavor = "multi_thread")]
async fn a_poller_sees_a_slow_mark_that_has_an_older_id() {
    let settings = Settings { workers: Some(2), ..Settings::default() };
    let server = Server::with(settings).await;
    let large = to_obj(&Sample::Blob.mesh(150_000).unwrap());
    let slow = server.mark(&large, "acme");
    let fast = async {
        // The slow mark has its id when its job runs.
        while server.service.pool().running() == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        server.mark(obj(), "acme").await
    };
    let poller = async {
        let (mut seen, mut resume) = (Vec::new(), None);
        while seen.len() < 2 {
            let (new, cursor) = poll(&server, resume).await;
            seen.extend(new);
            resume = cursor;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        seen
    };
    let within = tokio::time::timeout(Duration::from_mins(2), poller);
    let ((slow, _), (fast, _), seen) = futures::join!(slow, fast, within);
    assert!(slow < fast, "the slow one drew its id first");
    assert_eq!(seen.expect("the poller missed one"), [fast, slow]);
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_are_in_the_order_of_registration() {
    let server = Server::start().await;
    let mut ids = Vec::new();
    for owner_id in ["acme", "other", "acme"] {
        ids.push(server.mark(obj(), owner_id).await.0);
    }
    let resume = poll(&server, None).await;
    assert_eq!(resume.0, ids);
    assert_eq!(poll(&server, resume.1.clone()).await, (Vec::new(), resume.1));
    ids.reverse();
    let (mut seen, mut path) = (Vec::new(), "/v1/watermarks?limit=2".to_owned());
    loop {
        let page = server.get_json(&path).await;
        seen.extend(ids_of(&page));
        assert!(page["resume_cursor"].is_null(), "the newest have nothing behind them");
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        path = format!("/v1/watermarks?limit=2&cursor={cursor}");
    }
    assert_eq!(seen, ids);
    let page = server.get_json("/v1/watermarks?owner_id=other").await;
    assert_eq!(page["watermarks"].as_array().unwrap().len(), 1);
    for query in [
        "limit=0",
        "limit=201",
        "limit=x",
        "cursor=nonsense",
        "owner=acme",
        "owner_id=",
        "order=random",
        "cursor=AAAAAAAAAAAAAAAAAAAAAA",
    ] {
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
        for form in [file_form(&file), file_form(&file).text("owner_id", "acme")] {
            assert_eq!(server.verify(form).await["verdict"], "no_match");
        }
        let form = file_form(&file).text("watermark_id", id.clone());
        problem(server.post("/v1/verifications", form).await, 422, "nothing_to_compare").await;
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
