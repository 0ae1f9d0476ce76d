//! Downloads of marked files: whole, in part, under conditions, slowly, and from a damaged store.

use std::time::Duration;

use proptest::prelude::*;
use quadmark::sample::{Sample, to_obj};
use reqwest::{Method, Response};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::process::Process;
use crate::server::{Server, file_form, marked, obj, problem};

async fn fetch(
    server: &Server,
    method: Method,
    path: &str,
    headers: &[(&'static str, &str)],
) -> Response {
    let mut request = server.client.request(method, server.url(path));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.send().await.unwrap()
}

fn header<'a>(response: &'a Response, name: &str) -> &'a str {
    response.headers()[name].to_str().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_range_equals_the_slice() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let path = format!("/v1/watermarks/{id}/file");
    let whole = server.get(&path).await;
    assert_eq!(header(&whole, "accept-ranges"), "bytes");
    assert_eq!(header(&whole, "content-length"), file.len().to_string());
    assert!(whole.bytes().await.unwrap() == file);
    let length = file.len();
    // More than one frame, so that ranges cross the boundaries of frames.
    assert!(length > 2 * (256 << 10), "{length}");
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(60));
    let near = |seam: usize| (0..8_usize).prop_map(move |n| seam.saturating_sub(4) + n);
    let place = || prop_oneof![0..length, near(0), near(256 << 10), near(512 << 10), near(length)];
    let ranges = (place(), place());
    let handle = tokio::runtime::Handle::current();
    let (server, path, file) = (&server, &path, &file);
    let ran = tokio::task::block_in_place(|| {
        runner.run(&ranges, |(a, b)| {
            let (first, last) = (a.min(b), a.max(b));
            let (status, found, part) = handle.block_on(async {
                let range = format!("bytes={first}-{last}");
                let part = fetch(server, Method::GET, path, &[("range", &range)]).await;
                let found = part.headers().get("content-range").cloned();
                (part.status(), found, part.bytes().await.unwrap())
            });
            let found = found.unwrap();
            if first >= length {
                prop_assert_eq!(status, 416);
                prop_assert_eq!(found.to_str().unwrap(), format!("bytes */{length}"));
                return Ok(());
            }
            let end = (last + 1).min(length);
            prop_assert_eq!(status, 206);
            prop_assert_eq!(found.to_str().unwrap(), format!("bytes {first}-{}/{length}", end - 1));
            prop_assert!(part == file[first..end]);
            Ok(())
        })
    });
    ran.unwrap();
    for (range, expected) in [("bytes=-100", length - 100), ("bytes=100-", 100)] {
        let part = fetch(server, Method::GET, path, &[("range", range)]).await;
        assert_eq!(part.status(), 206);
        assert!(part.bytes().await.unwrap() == file[expected..]);
    }
    for ignored in ["bytes=0-1,5-6", "bytes=9-2", "lines=0-1"] {
        let whole = fetch(server, Method::GET, path, &[("range", ignored)]).await;
        assert_eq!(whole.status(), 200, "{ignored}");
        assert!(whole.bytes().await.unwrap() == *file);
    }
    let refused = fetch(server, Method::GET, path, &[("range", &format!("bytes={length}-"))]).await;
    problem(refused, 416, "range_not_satisfiable").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn conditions_and_heads() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let path = format!("/v1/watermarks/{id}/file");
    let head = fetch(&server, Method::HEAD, &path, &[("range", "bytes=0-9")]).await;
    assert_eq!(head.status(), 200);
    assert_eq!(header(&head, "content-length"), file.len().to_string());
    assert_eq!(header(&head, "accept-ranges"), "bytes");
    assert_eq!(header(&head, "content-type"), "model/obj");
    let tag = header(&head, "etag").to_owned();
    assert!(head.bytes().await.unwrap().is_empty());
    let weak = format!("W/{tag}");
    let list = format!("\"a,b\", {weak}");
    for method in [Method::GET, Method::HEAD] {
        for known in ["*", &tag, &weak, &list] {
            let same = fetch(&server, method.clone(), &path, &[("if-none-match", known)]).await;
            assert_eq!(same.status(), 304, "{known}");
            assert_eq!(header(&same, "etag"), tag);
        }
        let lines = [("if-none-match", "\"x\""), ("if-none-match", tag.as_str())];
        assert_eq!(fetch(&server, method.clone(), &path, &lines).await.status(), 304);
        let other = fetch(&server, method.clone(), &path, &[("if-none-match", "\"x\"")]).await;
        assert_eq!(other.status(), 200);
        for refused in ["\"x\"", &weak] {
            let failed = fetch(&server, method.clone(), &path, &[("if-match", refused)]).await;
            assert_eq!(failed.status(), 412, "{refused}");
        }
        let both = [("if-match", "\"x\""), ("if-none-match", tag.as_str())];
        assert_eq!(fetch(&server, method.clone(), &path, &both).await.status(), 412);
    }
    let failed = fetch(&server, Method::GET, &path, &[("if-match", "\"x\"")]).await;
    problem(failed, 412, "precondition_failed").await;
    for (validator, status) in [(tag.as_str(), 206), (&weak, 200), ("\"x\"", 200)] {
        let headers = [("range", "bytes=0-9"), ("if-range", validator)];
        assert_eq!(fetch(&server, Method::GET, &path, &headers).await.status(), status);
    }
    // An outdated range that cannot be satisfied is not an error either.
    let headers = [("range", "bytes=999999999-"), ("if-range", "\"x\"")];
    assert_eq!(fetch(&server, Method::GET, &path, &headers).await.status(), 200);
    // A condition does not hide that there is no such file.
    let unknown = "/v1/watermarks/0198f000-0000-7000-8000-000000000000/file";
    let unknown = fetch(&server, Method::GET, unknown, &[("if-none-match", "*")]).await;
    problem(unknown, 404, "unknown_watermark").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_or_damaged_file_is_an_error_and_never_a_shorter_file() {
    let server = Server::start().await;
    let post = || {
        let form = file_form(obj()).text("owner_id", "acme");
        let request = server.client.post(server.url("/v1/watermarks"));
        request.header("idempotency-key", "k").multipart(form).send()
    };
    let (id, file) = marked(post().await.unwrap()).await;
    let path = format!("/v1/watermarks/{id}/file");
    let stored = server.data().join("blobs/files").join(&id);
    let whole = std::fs::read(&stored).unwrap();
    assert!(whole.len() < file.len(), "compressed at rest");
    let at = |place: usize| {
        let mut damaged = whole.clone();
        damaged[place] ^= 1;
        damaged
    };
    let other = {
        let (id, _) = server.mark(obj(), "other").await;
        std::fs::read(server.data().join("blobs/files").join(id)).unwrap()
    };
    for (what, bytes) in [
        ("cut off", whole[..whole.len() - 1].to_vec()),
        ("empty", Vec::new()),
        ("another one", other),
        ("a changed header", at(60)),
        // After 56 bytes, 8 of checksum and 12 for each of a few frames.
        ("a changed first frame", at(400)),
    ] {
        std::fs::write(&stored, bytes).unwrap();
        let body = problem(server.get(&path).await, 500, "file_lost").await;
        assert!(body["detail"].as_str().unwrap().contains(&id), "{what}: {body}");
    }
    // With damage further in, the connection breaks.
    std::fs::write(&stored, at(whole.len() - 10)).unwrap();
    let begun = server.get(&path).await;
    assert_eq!(begun.status(), 200);
    assert!(begun.bytes().await.is_err(), "a shorter file that looks whole");
    std::fs::remove_file(&stored).unwrap();
    for method in [Method::GET, Method::HEAD] {
        for headers in [&[][..], &[("if-none-match", "*")][..]] {
            assert_eq!(fetch(&server, method.clone(), &path, headers).await.status(), 500);
        }
    }
    // A retry with the host makes the file again, and it is stored again.
    let (again, bytes) = marked(post().await.unwrap()).await;
    assert!(again == id && bytes == file);
    assert!(server.get(&path).await.bytes().await.unwrap() == file);
}

#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(target_os = "linux"), ignore = "needs Linux, which tells a process's memory")]
async fn slow_readers_do_not_hold_the_file_in_memory() {
    const READERS: usize = 30;
    let directory = tempfile::tempdir().unwrap();
    let host = to_obj(&Sample::Blob.mesh(120_000).unwrap());
    let process = Process::start(directory.path(), &[]);
    let client = reqwest::Client::new();
    let form = file_form(&host).text("owner_id", "acme");
    let post = client.post(process.url("/v1/watermarks")).multipart(form);
    let (id, file) = marked(post.send().await.unwrap()).await;
    drop(process);
    // A new process, so that memory that marking needed cannot be used again.
    let process = Process::start(directory.path(), &[]);
    let path = format!("/v1/watermarks/{id}/file");
    assert_eq!(client.get(process.url("/livez")).send().await.unwrap().status(), 200);
    let before = process.resident();
    let mut readers = Vec::new();
    for _ in 0..READERS {
        let mut stream = TcpStream::connect(&process.address).await.unwrap();
        let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", process.address);
        stream.write_all(head.as_bytes()).await.unwrap();
        let mut first = [0; 15];
        stream.read_exact(&mut first).await.unwrap();
        assert_eq!(&first, b"HTTP/1.1 200 OK");
        readers.push(stream);
    }
    let mut most = 0;
    for _ in 0..20 {
        tokio::time::sleep(Duration::from_millis(100)).await;
        most = most.max(process.resident());
    }
    let grown = most.saturating_sub(before);
    let length = file.len() as u64;
    println!(
        "{READERS} readers of {length} bytes: {grown} bytes more, {:.2} times the file",
        grown as f64 / length as f64
    );
    // Whole files would take thirty times the size; two frames and buffers per reader take less
    // than twice.
    let allowed = READERS as u64 * (1 << 20);
    assert!(allowed < READERS as u64 * length / 5, "the file is too small to tell");
    assert!(grown < allowed, "{grown} bytes");
    // A reader that continues gets all of it.
    let mut rest = vec![0; 0];
    let mut reader = readers.pop().unwrap();
    while !rest.ends_with(&file[file.len() - 100..]) {
        assert!(reader.read_buf(&mut rest).await.unwrap() > 0);
    }
    assert!(rest.ends_with(&file));
}
