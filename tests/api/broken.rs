//! The machine fails midway: whole records or none.

use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::server::{Server, file_form, obj, problem};

async fn run(server: &Server, sql: &'static str) {
    let options = SqliteConnectOptions::new().filename(server.data().join("registry.sqlite"));
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    sqlx::query(sql).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_registry_that_fails_leaves_no_files() {
    let server = Server::start().await;
    for table in [
        "CREATE TRIGGER fail BEFORE INSERT ON watermarks BEGIN SELECT RAISE(ABORT, 'secret'); END",
        "CREATE TRIGGER fail BEFORE INSERT ON idempotency BEGIN SELECT RAISE(ABORT, 'secret'); END",
    ] {
        run(&server, table).await;
        let form = file_form(obj()).text("owner_id", "acme");
        let request = server.client.post(server.url("/v1/watermarks"));
        let request = request.header("idempotency-key", "k").multipart(form);
        let body = problem(request.send().await.unwrap(), 500, "internal").await;
        assert!(!body.to_string().contains("secret"), "{body}");
        server.assert_empty(table).await;
        run(&server, "DROP TRIGGER fail").await;
    }
    server.mark(obj(), "acme").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_registration_leaves_the_host_of_another_record() {
    let server = Server::start().await;
    let fail = "CREATE TRIGGER fail BEFORE INSERT ON watermarks
                WHEN NEW.recipient = 'fails' BEGIN SELECT RAISE(ABORT, 'no'); END";
    run(&server, fail).await;
    let hosts = || std::fs::read_dir(server.data().join("blobs/hosts")).unwrap().count();
    let form = || file_form(obj()).text("owner_id", "acme").text("recipient", "fails");
    problem(server.post("/v1/watermarks", form()).await, 500, "internal").await;
    assert_eq!(hosts(), 0);
    server.mark(obj(), "acme").await;
    problem(server.post("/v1/watermarks", form()).await, 500, "internal").await;
    assert_eq!(hosts(), 1);
    assert_eq!(server.service.blob_count().await.unwrap(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_blob_store_that_fails_leaves_no_record() {
    let server = Server::start().await;
    let hosts = server.data().join("blobs/hosts");
    // The file is written first; there is no directory for the geometry.
    std::fs::remove_dir(&hosts).unwrap();
    std::fs::write(&hosts, "in the way").unwrap();
    let form = file_form(obj()).text("owner_id", "acme");
    problem(server.post("/v1/watermarks", form).await, 500, "internal").await;
    std::fs::remove_file(&hosts).unwrap();
    server.assert_empty("a blob that could not be written").await;
    server.mark(obj(), "acme").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_without_a_record_are_swept_at_the_start() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let orphan = server.data().join("blobs/files/0198f000-0000-7000-8000-000000000000");
    std::fs::write(&orphan, "left by a crash").unwrap();
    let server = server.restart().await;
    assert!(!orphan.exists());
    let kept = server.get(&format!("/v1/watermarks/{id}/file")).await;
    assert!(kept.bytes().await.unwrap() == file);
}
