//! A large registry: the time of the start, the cost of a verification, and the memory it needs.
//!
//! ```text
//! cargo bench --bench scale -- [--records 1000000] [--data DIR] [--index 10000000] [FILE.obj]
//! ```
//!
//! Makes a data directory with `--records` records of random salts and messages; an existing
//! directory that `--data` names is kept and used again. It starts the service over HTTP in this
//! process, and measures: the start; `POST /v1/verifications` of an unmarked file at every depth,
//! so that all stages run, as a multiple of tobj's load of the file; marking the file, finding a
//! copy with a stray triangle, revoking the mark, not finding it; memory. `--index` instead fills
//! an index alone and prints what it needs. Without a file: `obj/paper/dragon.obj` of the test
//! meshes, else a generated mesh of its size.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/seeded.rs"]
mod seeded;

use std::path::{Path, PathBuf};
use std::time::Instant;

use quadmark::sample::{Sample, to_obj};
use quadmark::service::Service;
use quadmark::watermark::{BitCount, Codeword, CodewordIndex, MarkKey, Message, Modulation};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use reqwest::multipart::{Form, Part};
use seeded::{config, seed, tobj_seconds};
use serde_json::Value;
use tokio::net::TcpListener;

struct Options {
    records: u64,
    index: Option<u64>,
    data: Option<PathBuf>,
    file: Option<PathBuf>,
}

fn options() -> Options {
    let mut options = Options { records: 1_000_000, index: None, data: None, file: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--records" => options.records = value().parse().unwrap(),
            "--index" => options.index = Some(value().parse().unwrap()),
            "--data" => options.data = Some(value().into()),
            _ => options.file = Some(word.into()),
        }
    }
    options
}

/// Resident memory of this process, now and at most, in MiB.
fn memory() -> (u64, u64) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = |name: &str| -> u64 {
        let line = status.lines().find(|line| line.starts_with(name));
        line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok()).unwrap_or(0)
    };
    (field("VmRSS:") / 1024, field("VmHWM:") / 1024)
}

struct Client {
    http: reqwest::Client,
    base: String,
}

impl Client {
    fn form(bytes: &[u8]) -> Form {
        Form::new().part("file", Part::bytes(bytes.to_vec()).file_name("suspect.obj"))
    }

    async fn verify(&self, bytes: &[u8], depth: &'static str) -> (Value, f64) {
        let form = Self::form(bytes).text("depth", depth);
        let start = Instant::now();
        let sent = self.http.post(format!("{}/v1/verifications", self.base)).multipart(form).send();
        let answer: Value = sent.await.unwrap().error_for_status().unwrap().json().await.unwrap();
        (answer, start.elapsed().as_secs_f64())
    }
}

/// The file with a far triangle, so that the blind frame is useless.
fn damaged(marked: &[u8]) -> Vec<u8> {
    let mut bytes = marked.to_vec();
    bytes.extend_from_slice(b"\nv 90 90 90\nv 90.001 90 90\nv 90 90.001 90\nf -1 -2 -3\n");
    bytes
}

async fn run(options: Options, data: &Path) {
    // The first start makes the schema and the master key.
    Service::open(config(data)).await.unwrap().close().await;
    seed(data, options.records).await;
    let (before, _) = memory();
    let start = Instant::now();
    let service = Service::open(config(data)).await.unwrap();
    let (after, most) = memory();
    println!(
        "start: {:.2} s for {} marks; memory {before} MiB before, {after} MiB after, {most} at most",
        start.elapsed().as_secs_f64(),
        service.marks()
    );
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let base = format!("http://{}", listener.local_addr().unwrap());
    let served = service.clone();
    tokio::spawn(quadmark::http::serve_on(listener, served, std::future::pending()));
    let client = Client { http: reqwest::Client::new(), base };

    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes");
    let meshes = std::env::var_os("QUADMARK_MESHES").map_or_else(beside, PathBuf::from);
    let dragon = options.file.unwrap_or_else(|| meshes.join("obj/paper/dragon.obj"));
    let host =
        std::fs::read(dragon).unwrap_or_else(|_| to_obj(&Sample::Blob.mesh(400_000).unwrap()));
    let yardstick = tobj_seconds(&host, 5);
    println!("tobj loads the file in {:.0} ms", 1e3 * yardstick);
    for depth in ["fast", "standard", "exhaustive"] {
        let mut times = Vec::new();
        let mut answer = Value::Null;
        for _ in 0..5 {
            let (verdict, seconds) = client.verify(&host, depth).await;
            times.push(seconds);
            answer = verdict;
        }
        times.sort_by(f64::total_cmp);
        println!(
            "{depth}: {:.0} ms, {:.2} x tobj; {}, {} hypotheses, tried {}",
            1e3 * times[2],
            times[2] / yardstick,
            answer["verdict"],
            answer["hypotheses"],
            answer["stages"]
        );
    }
    let form = Client::form(&host).text("owner_id", "acme");
    let start = Instant::now();
    let marked = client.http.post(format!("{}/v1/watermarks", client.base)).multipart(form).send();
    let marked = marked.await.unwrap().error_for_status().unwrap();
    let id = marked.headers()["quadmark-watermark-id"].to_str().unwrap().to_owned();
    let marked = marked.bytes().await.unwrap();
    println!("marked in {:.0} ms", 1e3 * start.elapsed().as_secs_f64());
    let report = |what: &str, (answer, seconds): (Value, f64)| {
        let best = &answer["matches"][0];
        println!(
            "{what}: {} in {:.0} ms, {}, log10_fp {}, stage {}",
            answer["verdict"],
            1e3 * seconds,
            if best["watermark_id"] == id.as_str() { "the mark" } else { "nothing" },
            best["log10_fp"],
            best["evidence"]["stage"],
        );
    };
    report("plain copy", client.verify(&marked, "standard").await);
    report("with a stray triangle", client.verify(&damaged(&marked), "standard").await);
    let start = Instant::now();
    let revoked = client.http.delete(format!("{}/v1/watermarks/{id}", client.base)).send();
    revoked.await.unwrap().error_for_status().unwrap();
    println!("revoked in {:.1} ms", 1e3 * start.elapsed().as_secs_f64());
    report("after that", client.verify(&marked, "fast").await);
    let (after, most) = memory();
    println!("memory {after} MiB, {most} MiB at most");
}

/// Memory and time that an index alone needs.
fn fill(records: u64) {
    let mut random = ChaCha20Rng::from_seed([5; 32]);
    let message = Message::from_bytes(&[0; 8], BitCount::default()).unwrap();
    let mut index = CodewordIndex::default();
    let start = Instant::now();
    let mut next = 0;
    while next < records {
        let keys: Vec<(u64, [u8; 32])> = (next..records.min(next + 100_000))
            .map(|id| {
                let mut key = [0; 32];
                random.fill_bytes(&mut key);
                (id, key)
            })
            .collect();
        next += keys.len() as u64;
        let derived: Vec<_> = keys
            .into_par_iter()
            .map(|(id, key)| {
                let codeword = Codeword::new(&MarkKey::from_bytes(key), &message);
                (u128::from(id), Modulation::Mean, codeword)
            })
            .collect();
        index.extend(derived);
    }
    let (after, most) = memory();
    println!(
        "{} records in {:.1} s: {after} MiB, {most} MiB at most",
        index.len(),
        start.elapsed().as_secs_f64()
    );
}

fn main() {
    let options = options();
    if let Some(records) = options.index {
        fill(records);
        return;
    }
    let temporary = tempfile::tempdir().unwrap();
    let data = options.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(run(options, &data));
}
