//! Work that nobody waits for any more, and work that is much larger than its file suggests.

use std::time::{Duration, Instant};

use quadmark::config::Settings;
use quadmark::sample::{Sample, to_glb};

use super::server::{Server, file_form, obj, other_obj, problem};

/// A limit for what should take no time, on a machine that also does other things.
const LIVENESS: Duration = Duration::from_mins(1);

/// A grid of 100 x 100 cells as GLB, with this number of primitives that share one index accessor.
fn repeated(primitives: usize) -> Vec<u8> {
    let mut bin: Vec<u8> = Vec::new();
    for k in 0..101_u16 * 101 {
        for x in [f32::from(k % 101), f32::from(k / 101), 0.0] {
            bin.extend(x.to_le_bytes());
        }
    }
    let indices_at = bin.len();
    for k in 0..100_u16 * 100 {
        for corner in [0, 1, 101, 101, 1, 102] {
            bin.extend((k / 100 * 101 + k % 100 + corner).to_le_bytes());
        }
    }
    let piece = r#"{"attributes":{"POSITION":0},"indices":1}"#;
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{}}}],"bufferViews":[
        {{"buffer":0,"byteLength":{indices_at}}},
        {{"buffer":0,"byteOffset":{indices_at},"byteLength":120000}}],"accessors":[
        {{"bufferView":0,"componentType":5126,"count":10201,"type":"VEC3"}},
        {{"bufferView":1,"componentType":5123,"count":60000,"type":"SCALAR"}}],
        "meshes":[{{"primitives":[{}]}}]}}"#,
        bin.len(),
        vec![piece; primitives].join(",")
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF\x02\0\0\0".to_vec();
    let total = 12 + 8 + json.len() + 8 + bin.len();
    file.extend(u32::try_from(total).unwrap().to_le_bytes());
    for (kind, chunk) in [(0x4E4F_534A_u32, &json), (0x004E_4942, &bin)] {
        file.extend(u32::try_from(chunk.len()).unwrap().to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(chunk);
    }
    file
}

async fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < LIVENESS, "{what}");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_small_file_of_millions_of_triangles_is_refused_everywhere() {
    let server = Server::start().await;
    let file = repeated(200);
    assert!(file.len() < 300_000);
    for path in ["/v1/inspections", "/v1/verifications", "/v1/watermarks"] {
        let mut form = file_form(&file);
        if path == "/v1/watermarks" {
            form = form.text("owner_id", "acme");
        }
        let refused = problem(server.post(path, form).await, 413, "too_large").await;
        assert!(refused["detail"].as_str().unwrap().contains("repeat"), "{refused}");
    }
    server.assert_empty("millions of triangles").await;
    // Two materials over one surface are fine.
    assert_eq!(server.post("/v1/inspections", file_form(&repeated(2))).await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_needs_more_memory_than_there_is_is_refused() {
    // Ten thousand vertices need a few MiB.
    let settings = Settings { memory_budget_bytes: Some(4 << 20), ..Settings::default() };
    let server = Server::with(settings).await;
    for path in ["/v1/inspections", "/v1/verifications", "/v1/watermarks"] {
        let mut form = file_form(obj());
        if path == "/v1/watermarks" {
            form = form.text("owner_id", "acme");
        }
        let refused = problem(server.post(path, form).await, 413, "too_large").await;
        assert!(refused["detail"].as_str().unwrap().contains("memory"), "{refused}");
    }
    server.assert_empty("a mesh larger than the memory").await;
    assert_eq!(server.service.pool().running(), 0);
}

/// A mesh that takes minutes to rehearse and to mark, with a deadline of a second.
#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_frees_the_pool_and_a_shutdown_after_it_is_quick() {
    let settings = Settings {
        request_timeout: Some(1),
        workers: Some(1),
        queue: Some(0),
        ..Settings::default()
    };
    let server = Server::with(settings).await;
    let large = to_glb(&Sample::Knot.mesh(400_000).unwrap());
    for path in ["/v1/inspections", "/v1/watermarks"] {
        let mut form = file_form(&large);
        if path == "/v1/watermarks" {
            // A limit that no strength meets: several embeddings, each far longer than a deadline
            // that leaves time for the upload.
            form = form.text("owner_id", "acme").text("max_distortion", "0.000001");
        }
        let answer = server.post(path, form).await;
        if path == "/v1/watermarks" {
            problem(answer, 503, "deadline_exceeded").await;
        }
        until("the worker is free again", || server.service.pool().running() == 0).await;
        until("the place is free again", || server.service.pool().free_slots() == 1).await;
    }
    server.assert_empty("a deadline").await;
    let server = server.restart().await;
    server.assert_empty("a restart").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_hangs_up_ends_its_verification_and_its_inspection() {
    let settings = Settings { workers: Some(1), queue: Some(0), ..Settings::default() };
    let server = Server::with(settings).await;
    let (_, marked) = server.mark(other_obj(), "acme").await;
    let large = to_glb(&Sample::Blob.mesh(190_000).unwrap());
    for path in ["/v1/inspections", "/v1/verifications"] {
        let form = file_form(&large).text("bits", "64");
        let form = if path == "/v1/verifications" {
            file_form(&large).text("depth", "exhaustive")
        } else {
            form
        };
        let (client, url) = (server.client.clone(), server.url(path));
        let request = tokio::spawn(async move { client.post(url).multipart(form).send().await });
        let pool = server.service.pool();
        until("the job runs", || pool.running() == 1 || request.is_finished()).await;
        request.abort();
        until("the job ends", || pool.running() == 0 && pool.free_slots() == 1).await;
    }
    // The pool is as good as new.
    let verdict = server.verify(file_form(&marked)).await;
    assert_eq!(verdict["verdict"], "match");
}

/// The service is told to stop while the first job of a verification runs. The second job still
/// runs.
#[tokio::test(flavor = "multi_thread")]
async fn a_verification_that_began_ends_before_the_service_goes_down() {
    let settings = Settings { workers: Some(1), queue: Some(0), ..Settings::default() };
    let server = Server::with(settings).await;
    let (id, marked) = server.mark(obj(), "acme").await;
    // Half of it, which is found only with its host, in the second job.
    let lines: Vec<&str> = std::str::from_utf8(&marked).unwrap().lines().collect();
    let faces = lines.iter().filter(|line| line.starts_with("f ")).count();
    let mut seen = 0;
    let kept = lines.iter().filter(|line| {
        seen += usize::from(line.starts_with("f "));
        !line.starts_with("f ") || seen * 2 < faces
    });
    let half = kept.copied().collect::<Vec<_>>().join("\n");
    let (client, url) = (server.client.clone(), server.url("/v1/verifications"));
    let request = client.post(url).multipart(file_form(half.as_bytes()));
    let verifying = tokio::spawn(async move { request.send().await.unwrap() });
    let pool = server.service.pool().clone();
    until("the first job runs", || pool.running() == 1 || verifying.is_finished()).await;
    assert!(!verifying.is_finished());
    let server = server.restart().await;
    let answer = verifying.await.unwrap();
    let status = answer.status();
    let verdict: serde_json::Value = answer.json().await.unwrap();
    assert_eq!(status, 200, "{verdict}");
    assert_eq!(verdict["verdict"], "match", "{verdict}");
    assert_eq!(verdict["matches"][0]["watermark_id"], id.as_str());
    // The verdict was stored, too.
    let path = format!("/v1/verifications/{}", verdict["id"].as_str().unwrap());
    assert_eq!(server.get_json(&path).await, verdict);
}
