//! Files that were made, or found, to break readers. They are not part of the repository:
//! `QUADMARK_TEST_MESHES` names their folder if it is not `../shared/meshes`.

use std::path::{Path, PathBuf};

use crate::server::Server;

fn files_below(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            files_below(&path, found);
        } else {
            found.push(path);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_is_refused_without_a_trace_or_marked_whole() {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes");
    let meshes = std::env::var_os("QUADMARK_TEST_MESHES").map_or_else(beside, PathBuf::from);
    let mut paths = Vec::new();
    files_below(&meshes.join("adversarial"), &mut paths);
    if paths.is_empty() {
        eprintln!("skipped: no adversarial files in {}", meshes.display());
        return;
    }
    paths.sort();
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
