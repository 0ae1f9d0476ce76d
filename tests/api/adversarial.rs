//! Files that were made, or found, to break readers. They are not part of the repository (see
//! `support::meshes`).

use crate::server::Server;
use crate::support::{files_below, meshes};

#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
async fn each_is_refused_without_a_trace_or_marked_whole() {
    let paths = files_below(&meshes("adversarial"));
    assert!(!paths.is_empty());
    let server = Server::start().await;
    let mut marked = 0;
    for path in &paths {
        let url = server.url("/v1/watermarks?owner_id=acme");
        let body = std::fs::read(path).unwrap();
        let response = server.client.post(url).body(body).send().await.unwrap();
        let (status, path) = (response.status(), path.display());
        if status == 201 {
            marked += 1;
        } else {
            assert!(status.is_client_error(), "{path}: {status}");
            assert_eq!(response.headers()["content-type"], "application/problem+json", "{path}");
        }
        assert_eq!(server.service.marks(), marked, "{path}");
    }
    assert_eq!(server.service.blob_count().await.unwrap(), 2 * marked);
    eprintln!("{} files, {marked} of them marked", paths.len());
}
