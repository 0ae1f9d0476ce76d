//! Refusals: a problem with the right code, and nothing stored.

use quadmark::config::Settings;
use reqwest::multipart::Form;

use crate::server::{Server, file_form, file_part, glb, obj, problem};

fn owned(file: &[u8]) -> Form {
    file_form(file).text("owner_id", "acme")
}

/// A tetrahedron whose first line is replaced.
fn tetrahedron(first: &str, face: &str) -> Vec<u8> {
    format!("{first}\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\n{face}\n").into_bytes()
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_no_meshes() {
    let server = Server::start().await;
    let ok = "v 0 0 0";
    let cases: [(&str, Vec<u8>, u16, &str); 10] = [
        ("an empty file", Vec::new(), 422, "empty_file"),
        ("text", b"Dear Sir or Madam,\nno mesh here.\n".to_vec(), 415, "unknown_format"),
        ("not a number", tetrahedron("v nan 0 0", "f 2 3 4"), 422, "non_finite_vertex"),
        ("infinity", tetrahedron("v 0 inf 0", "f 2 3 4"), 422, "non_finite_vertex"),
        ("too large a number", tetrahedron("v 0 0 1e999", "f 2 3 4"), 422, "non_finite_vertex"),
        ("an index out of range", tetrahedron(ok, "f 2 3 5"), 422, "malformed_obj"),
        ("an index of zero", tetrahedron(ok, "f 0 3 4"), 422, "malformed_obj"),
        ("points only", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_vec(), 422, "no_triangles"),
        ("a tetrahedron", tetrahedron(ok, "f 2 3 4"), 422, "insufficient_capacity"),
        ("half a GLB", glb()[..glb().len() / 2].to_vec(), 422, "malformed_gltf"),
    ];
    for (what, file, status, code) in cases {
        problem(server.post("/v1/watermarks", owned(&file)).await, status, code).await;
        if code != "insufficient_capacity" {
            let verdict = server.post("/v1/verifications", file_form(&file)).await;
            problem(verdict, status, code).await;
            let found = server.post("/v1/inspections", file_form(&file)).await;
            problem(found, status, code).await;
        }
        server.assert_empty(what).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn glb_cut_off_anywhere() {
    let server = Server::start().await;
    let mesh = quadmark::sample::Sample::Gear.mesh(300).unwrap();
    let small = quadmark::sample::to_glb(&mesh);
    for length in (0..small.len()).step_by(small.len() / 60) {
        let response = server.post("/v1/watermarks", owned(&small[..length])).await;
        assert!(response.status().is_client_error(), "{length}");
        assert_eq!(response.headers()["content-type"], "application/problem+json");
    }
    server.assert_empty("truncated GLB files").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn parameters_that_cannot_be() {
    let server = Server::start().await;
    let long = "a".repeat(10_000);
    let huge = "a".repeat(100_000);
    let cases: [(&str, Form, &str); 21] = [
        ("no owner", file_form(obj()), "missing_parameter"),
        ("no file", Form::new().text("owner_id", "acme"), "missing_parameter"),
        ("a long owner", file_form(obj()).text("owner_id", long), "invalid_parameter"),
        ("a huge owner", file_form(obj()).text("owner_id", huge), "invalid_parameter"),
        ("an empty owner", file_form(obj()).text("owner_id", ""), "invalid_parameter"),
        ("a broken owner", file_form(obj()).text("owner_id", "a\r\nb"), "invalid_parameter"),
        ("a method", owned(obj()).text("method", "magic"), "invalid_parameter"),
        ("strength 7", owned(obj()).text("strength", "7"), "invalid_parameter"),
        ("strength nan", owned(obj()).text("strength", "nan"), "invalid_parameter"),
        ("no distortion", owned(obj()).text("max_distortion", "0"), "invalid_parameter"),
        ("tiny distortion", owned(obj()).text("max_distortion", "9e-7"), "invalid_parameter"),
        ("large distortion", owned(obj()).text("max_distortion", "0.2"), "invalid_parameter"),
        ("distortion nan", owned(obj()).text("max_distortion", "nan"), "invalid_parameter"),
        ("8 bits", owned(obj()).text("bits", "8"), "invalid_parameter"),
        ("-1 bits", owned(obj()).text("bits", "-1"), "invalid_parameter"),
        ("a payload of 72 bits", owned(obj()).text("payload", "0f".repeat(9)), "invalid_parameter"),
        ("a payload", owned(obj()).text("payload", "xyz"), "invalid_parameter"),
        ("a flag", owned(obj()).text("keep_file", "perhaps"), "invalid_parameter"),
        ("an unknown field", owned(obj()).text("ownerid", "acme"), "unknown_parameter"),
        ("two owners", owned(obj()).text("owner_id", "acme"), "duplicate_parameter"),
        ("two files", owned(obj()).part("file", file_part(obj())), "duplicate_parameter"),
    ];
    for (what, form, code) in cases {
        problem(server.post("/v1/watermarks", form).await, 400, code).await;
        server.assert_empty(what).await;
    }
    let mut many = owned(obj());
    for _ in 0..40 {
        many = many.text("label", "x");
    }
    let response = server.post("/v1/watermarks", many).await;
    assert_eq!(response.status(), 400);
    let suspect = file_form(obj()).text("watermark_id", "7");
    let response = server.post("/v1/verifications", suspect).await;
    problem(response, 400, "invalid_parameter").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn content_types_that_are_no_upload() {
    let server = Server::start().await;
    let url = || server.url("/v1/watermarks?owner_id=acme");
    for kind in ["application/json", "application/x-www-form-urlencoded", "image/png", ";;;"] {
        let request = server.client.post(url()).header("content-type", kind).body("{}");
        problem(request.send().await.unwrap(), 415, "unsupported_media_type").await;
    }
    for (kind, body) in [
        ("multipart/form-data", "x"),
        ("multipart/form-data; boundary=b", "no boundary in here"),
        ("multipart/form-data; boundary=b", "--b\r\nContent-Disposition: form-data; name=\"fi"),
        (
            "multipart/form-data; boundary=b",
            "--b\r\nContent-Disposition: form-data; name=\"file\"; filename=\"x\"\r\n\r\nv 0 0",
        ),
    ] {
        let request = server.client.post(url()).header("content-type", kind).body(body);
        problem(request.send().await.unwrap(), 400, "malformed_multipart").await;
    }
    server.assert_empty("wrong content types").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_line_without_an_end_is_not_gathered() {
    let server = Server::start().await;
    let head = "--b\r\nContent-Disposition: form-data; name=\"file\"; x=\"".to_owned();
    let body = head + &"a".repeat(8 << 20);
    let request = server.client.post(server.url("/v1/watermarks"));
    let request = request.header("content-type", "multipart/form-data; boundary=b").body(body);
    problem(request.send().await.unwrap(), 400, "malformed_multipart").await;
    server.assert_empty("an endless header line").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_over_the_limit() {
    let limit = 100_000;
    let server =
        Server::with(Settings { max_body_bytes: Some(limit), ..Settings::default() }).await;
    let big = vec![b'#'; 1_000_000];
    problem(server.post("/v1/watermarks", owned(&big)).await, 413, "too_large").await;
    let url = server.url("/v1/watermarks?owner_id=acme");
    let raw = server.client.post(&url).body(big.clone()).send().await.unwrap();
    problem(raw, 413, "too_large").await;
    // Chunked: no length is declared.
    let chunks = big.chunks(10_000).map(|chunk| Ok::<_, std::io::Error>(chunk.to_vec()));
    let chunks: Vec<_> = chunks.collect();
    let body = reqwest::Body::wrap_stream(futures::stream::iter(chunks));
    let chunked = server.client.post(&url).body(body).send().await.unwrap();
    problem(chunked, 413, "too_large").await;
    server.assert_empty("bodies over the limit").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_busy_service_refuses_at_once() {
    let settings = Settings { workers: Some(1), queue: Some(1), ..Settings::default() };
    let server = Server::with(settings).await;
    let soon = std::time::Instant::now() + std::time::Duration::from_mins(1);
    let held = [(); 2].map(|()| server.service.pool().admit(soon).unwrap());
    for path in ["/v1/watermarks", "/v1/verifications", "/v1/inspections"] {
        let response = server.post(path, owned(obj())).await;
        assert!(response.headers().contains_key("retry-after"));
        problem(response, 503, "busy").await;
    }
    assert_eq!(server.get("/readyz").await.status(), 200, "busy is not broken");
    server.assert_empty("a full queue").await;
    drop(held);
    server.mark(obj(), "acme").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_of_the_mesh() {
    let server = Server::with(Settings { max_vertices: Some(100), ..Settings::default() }).await;
    problem(server.post("/v1/watermarks", owned(obj())).await, 413, "too_large").await;
    server.assert_empty("too many vertices").await;
}
