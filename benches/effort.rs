//! The cost of verifications. Every file below a folder is registered if it can be marked. Then
//! every readable file is verified as it is, and every marked file as it was handed out and after a
//! move.
//!
//! ```text
//! cargo bench --bench effort -- [--only WORD] [--data DIR] FOLDER
//! ```
//!
//! Prints the slowest ten by CPU time of all threads of this process, which does nothing else,
//! beside the time that the law allows. Ends with an error if one takes longer. The law is `1 s +
//! SUSPECT * elements of the suspect + HOSTS * elements of all listed hosts`, where elements are
//! vertices and triangles together. With `--only`, only files whose path has the word are verified,
//! but all are registered.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/seeded.rs"]
mod seeded;
#[path = "support/service.rs"]
mod service;

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DQuat, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::sample::to_glb;
use quadmark::service::{Depth, Verification};
use quadmark::watermark::{BitCount, Method, Strength, Suspect};
use rustix::time::{ClockId, clock_gettime};
use service::{Bench, Kind};

/// The constants of the law: CPU seconds, fixed and per element.
const FIXED: f64 = 1.0;
const SUSPECT: f64 = 20e-6;
const HOSTS: f64 = 20e-6;

/// Number of verifications that are printed.
const SLOWEST: usize = 10;

/// CPU seconds of this process so far.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Every file below a folder, in order of their names.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
}

/// A file whose surface can be read.
struct Readable {
    name: String,
    bytes: Vec<u8>,
}

fn readable(path: &Path, folder: &Path) -> Option<Readable> {
    let bytes = std::fs::read(path).unwrap();
    let asset = Asset::read(&bytes, &Limits::default()).ok()?;
    Suspect::new(asset.mesh()).ok()?;
    let name = path.strip_prefix(folder).unwrap_or(path).display().to_string();
    Some(Readable { name, bytes })
}

/// The same surface, turned, scaled and moved.
fn moved(bytes: &[u8]) -> Vec<u8> {
    let mesh = Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
    let place = |&p: &DVec3| turn * (0.7 * p) + DVec3::new(3.0, -1.0, 0.5);
    let positions = mesh.positions().iter().map(place).collect();
    to_glb(&Mesh::new(positions, mesh.triangles().to_vec()).unwrap())
}

/// A verification and what it cost.
struct Cost {
    what: String,
    seconds: f64,
    allowed: f64,
    suspect: usize,
    hosts: u64,
    verdict: String,
}

struct Options {
    only: String,
    data: Option<PathBuf>,
    folder: PathBuf,
}

fn options() -> Options {
    let mut options =
        Options { only: String::new(), data: None, folder: PathBuf::from("../shared/meshes") };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--only" => options.only = value(),
            "--data" => options.data = Some(value().into()),
            _ => options.folder = word.into(),
        }
    }
    options
}

fn main() {
    let options = options();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let data = options.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    let bench = runtime.block_on(Bench::start(&data, 0));
    let hostile = |path: &PathBuf| path.components().any(|part| part.as_os_str() == "adversarial");
    let files = files_below(&options.folder).into_iter().filter(|path| !hostile(path));
    let files: Vec<Readable> = files.filter_map(|path| readable(&path, &options.folder)).collect();
    let kind = Kind {
        method: Method::QspMean,
        strength: Some(Strength::new(0.1).unwrap()),
        bits: BitCount::default(),
    };
    let start = Instant::now();
    let mut suspects: Vec<(String, Vec<u8>)> = Vec::new();
    for Readable { name, bytes } in files {
        if let Ok(mark) = runtime.block_on(bench.try_mark(&bytes, &name, kind)) {
            suspects.push((format!("{name}, marked and moved"), moved(&mark.bytes)));
            suspects.push((format!("{name}, marked"), mark.bytes));
        }
        suspects.push((name, bytes));
    }
    suspects.retain(|(name, _)| name.contains(&options.only));
    println!(
        "{} marks in {:.0} s, {} verifications",
        bench.service.marks(),
        start.elapsed().as_secs_f64(),
        suspects.len()
    );
    let mut costs: Vec<Cost> = Vec::new();
    for (what, bytes) in suspects {
        let before = cpu();
        let verification = runtime.block_on(bench.verify(&bytes, None, Depth::Standard));
        costs.push(cost(what, cpu() - before, &verification));
    }
    report(costs);
}

fn cost(what: String, seconds: f64, verification: &Verification) -> Cost {
    let suspect = verification.file.vertices + verification.file.triangles;
    let hosts = verification.compared_hosts.elements;
    let allowed = FIXED + SUSPECT * suspect as f64 + HOSTS * hosts as f64;
    let verdict = format!("{:?}", verification.verdict);
    Cost { what, seconds, allowed, suspect, hosts, verdict }
}

/// The value that a table is sorted by.
type Rank = fn(&Cost) -> f64;

fn report(mut costs: Vec<Cost>) {
    let total: f64 = costs.iter().map(|cost| cost.seconds).sum();
    let broken = costs.iter().filter(|cost| cost.seconds > cost.allowed).count();
    println!("{total:.0} s of CPU in all; the law was broken {broken} times");
    let tables: [(&str, Rank); 2] = [
        ("slowest", |cost| cost.seconds),
        ("nearest to the law", |cost| cost.seconds / cost.allowed),
    ];
    for (name, by) in tables {
        costs.sort_by(|a, b| by(b).total_cmp(&by(a)));
        println!("{name}\n   CPU s   law s   suspect      hosts  verdict       file");
        for Cost { what, seconds, allowed, suspect, hosts, verdict } in costs.iter().take(SLOWEST) {
            println!("{seconds:8.2}{allowed:8.2}{suspect:10}{hosts:11}  {verdict:12}  {what}");
        }
    }
    if broken > 0 {
        std::process::exit(1);
    }
}
