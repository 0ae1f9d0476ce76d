//! Uploads are admitted before they are sent. An upload that stalls or does not fit leaves nothing.

#[cfg(unix)]
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::process::Command;
use std::time::Duration;

use quadmark::config::Settings;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

#[cfg(unix)]
use crate::server::glb;
use crate::server::{Server, file_form, obj, problem};

const LIVENESS: Duration = Duration::from_mins(1);

/// An upload that declares `length` bytes and sends 1,000.
async fn begun(server: &Server, length: usize) -> TcpStream {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head = format!(
        "POST /v1/watermarks?owner_id=acme HTTP/1.1\r\nHost: localhost\r\n\
         Content-Length: {length}\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.write_all(&obj()[..1000]).await.unwrap();
    stream
}

/// A small request that is refused for its content once it is admitted.
async fn try_out(server: &Server) -> reqwest::Response {
    let url = server.url("/v1/inspections");
    server.client.post(url).body("not a mesh").send().await.unwrap()
}

/// Waits until small uploads are admitted, or are not.
async fn until(server: &Server, taken: bool) {
    let tries = async {
        while (try_out(server).await.status() == 415) != taken {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(LIVENESS, tries).await.expect("uploads come and go");
}

async fn answer(mut stream: TcpStream) -> String {
    let mut text = vec![0; 4096];
    let read = tokio::time::timeout(LIVENESS, stream.read(&mut text)).await.unwrap().unwrap();
    String::from_utf8_lossy(&text[..read]).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_half_uploads_hold_neither_places_nor_budget_for_ever() {
    let settings = Settings {
        max_uploads: Some(3),
        idle_timeout: Some(2),
        max_body_bytes: Some(1 << 20),
        ..Settings::default()
    };
    let server = Server::with(settings).await;
    let mut idle = Vec::new();
    for _ in 0..3 {
        idle.push(begun(&server, 900_000).await);
    }
    until(&server, false).await;
    let refused = try_out(&server).await;
    assert!(refused.headers().contains_key("retry-after"));
    problem(refused, 503, "uploads_full").await;
    // Refused before the body: a client that waits for leave to send is answered at once.
    let mut waiting = TcpStream::connect(server.address).await.unwrap();
    let head = "POST /v1/inspections HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n\
                Content-Length: 10\r\n\r\n";
    waiting.write_all(head.as_bytes()).await.unwrap();
    assert!(answer(waiting).await.starts_with("HTTP/1.1 503 "));
    assert_eq!(server.get("/readyz").await.status(), 200, "busy is not broken");
    until(&server, true).await;
    for stream in idle {
        let text = answer(stream).await;
        assert!(text.starts_with("HTTP/1.1 408 ") && text.contains("upload_timeout"), "{text}");
    }
    server.assert_empty("idle uploads").await;
    server.mark(obj(), "acme").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn all_uploads_together_have_a_budget() {
    let settings = Settings {
        upload_budget_bytes: Some(2 << 20),
        max_body_bytes: Some(2 << 20),
        ..Settings::default()
    };
    let server = Server::with(settings).await;
    let held = begun(&server, (2 << 20) - 100).await;
    until(&server, true).await;
    // Until the first upload has its space, more would fit.
    let tries = async {
        loop {
            let declared = server.post("/v1/inspections", file_form(obj())).await;
            if declared.status() == 503 {
                return declared;
            }
        }
    };
    let declared = tokio::time::timeout(LIVENESS, tries).await.unwrap();
    problem(declared, 503, "uploads_full").await;
    // An upload without a declared length is stopped when it no longer fits.
    let parts: Vec<_> =
        obj().chunks(10_000).map(|part| Ok::<_, std::io::Error>(part.to_vec())).collect();
    let body = reqwest::Body::wrap_stream(futures::stream::iter(parts));
    let chunked = server.client.post(server.url("/v1/inspections")).body(body).send().await;
    problem(chunked.unwrap(), 503, "uploads_full").await;
    drop(held);
    let tries = async {
        while server.post("/v1/inspections", file_form(obj())).await.status() != 200 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(LIVENESS, tries).await.expect("the budget is free again");
    server.assert_empty("uploads beyond the budget").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_is_nearly_full_takes_no_upload() {
    let settings = Settings { min_free_bytes: Some(1 << 60), ..Settings::default() };
    let server = Server::with(settings).await;
    for path in ["/v1/watermarks", "/v1/verifications", "/v1/inspections"] {
        let form = file_form(obj()).text("owner_id", "acme");
        let refused = server.post(path, form).await;
        assert!(refused.headers().contains_key("retry-after"));
        problem(refused, 507, "insufficient_storage").await;
    }
    problem(server.get("/readyz").await, 507, "insufficient_storage").await;
    assert_eq!(server.get("/livez").await.status(), 200);
    server.assert_empty("a full disk").await;
}

/// A small file system in memory, unmounted on drop.
#[cfg(unix)]
struct SmallDisk {
    path: PathBuf,
    _directory: tempfile::TempDir,
}

#[cfg(unix)]
impl SmallDisk {
    fn mount(megabytes: u32) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("disk");
        std::fs::create_dir(&path).unwrap();
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &format!("size={megabytes}m"), "tmpfs"]).arg(&path);
        let mounted = mount.output().unwrap();
        assert!(mounted.status.success(), "{mounted:?}");
        Self { path, _directory: directory }
    }
}

#[cfg(unix)]
impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.path).output();
    }
}

/// Leaves `bytes` free by a file that takes the rest.
#[cfg(unix)]
fn leave_free(disk: &Path, bytes: u64) {
    use std::io::Write as _;
    let filler = disk.join("filler");
    let _ = std::fs::remove_file(&filler);
    let found = rustix::fs::statvfs(disk).unwrap();
    let free = found.f_bavail * found.f_frsize;
    let length = usize::try_from(free.saturating_sub(bytes)).unwrap();
    std::fs::File::create(filler).unwrap().write_all(&vec![1; length]).unwrap();
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(can_mount), ignore = "needs leave to mount a small disk")]
async fn a_disk_that_runs_full_is_never_a_500_and_leaves_nothing() {
    let disk = SmallDisk::mount(16);
    let settings = Settings { min_free_bytes: Some(0), ..Settings::default() };
    let directory = tempfile::tempdir_in(&disk.path).unwrap();
    let server = Server::on(directory, settings).await;
    // From no room for the upload, through room for it but not for the stored files, to enough.
    let step = 24 << 10;
    let mut refused = 0;
    let marked = loop {
        leave_free(&disk.path, refused * step);
        let response = server.post("/v1/watermarks", file_form(glb()).text("owner_id", "acme"));
        let response = response.await;
        if response.status() == 201 {
            break response.bytes().await.unwrap();
        }
        problem(response, 507, "insufficient_storage").await;
        server.assert_empty("a mark that did not fit").await;
        refused += 1;
    };
    println!("{refused} of {} steps refused, {} bytes", refused + 1, refused * step);
    assert!(refused * step > glb().len() as u64, "room for the upload alone was not enough");
    // A verdict that cannot be stored.
    let mut refused = 0;
    let verdict = loop {
        leave_free(&disk.path, refused * step);
        let response = server.post("/v1/verifications", file_form(&marked)).await;
        if response.status() == 200 {
            break response;
        }
        problem(response, 507, "insufficient_storage").await;
        refused += 1;
    };
    let verdict: serde_json::Value = verdict.json().await.unwrap();
    assert!(refused > 0 && verdict["verdict"] == "match", "{verdict}");
}
