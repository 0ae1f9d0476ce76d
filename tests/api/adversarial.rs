//! Files that were made, or found, to break readers. They are not part of the repository (see
//! `support::meshes`).

use std::collections::HashSet;

use quadmark::blobs::geometry;
use quadmark::formats::{Asset, Limits};

use crate::server::Server;
use crate::support::{files_below, meshes};

#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
async fn each_is_refused_without_a_trace_or_marked_whole() {
    let paths = files_below(&meshes("adversarial"));
    assert!(!paths.is_empty());
    let server = Server::start().await;
    let mut marked = 0;
    // Files of one geometry share one host.
    let mut hosts = HashSet::new();
    for path in &paths {
        let url = server.url("/v1/watermarks?owner_id=acme");
        let body = std::fs::read(path).unwrap();
        let host = Asset::read(&body, &Limits::default()).map(Asset::into_mesh);
        let response = server.client.post(url).body(body).send().await.unwrap();
        let (status, path) = (response.status(), path.display());
        if status == 201 {
            marked += 1;
            hosts.insert(geometry::key(&host.unwrap()));
        } else {
            assert!(status.is_client_error(), "{path}: {status}");
            assert_eq!(response.headers()["content-type"], "application/problem+json", "{path}");
        }
        assert_eq!(server.service.marks(), marked, "{path}");
    }
    assert_eq!(server.service.blob_count().await.unwrap(), marked + hosts.len());
    eprintln!("{} files, {marked} of them marked", paths.len());
}
