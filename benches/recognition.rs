//! The acceptance table of detection: marks registered with a service, attacked, and looked for.
//!
//! ```text
//! cargo bench --bench recognition -- [--keys 2] [--others 100000] [--depth standard] [--wrong]
//!     [--strangers DIR] [--attacks none,crop-50,...] [--strength 0.1] [--seed 1] [--data DIR]
//!     FILE...
//! ```
//!
//! All files are first marked, by so many owners each (the default method, hosts kept), in
//! one registry that holds so many other records. Per attack (`support/cases.rs`): how many of the
//! attacked copies are a `match` (bound below 1e-9) with the right record; the mean of `log10_fp` where
//! that record was named at all; the time of a verification, as a multiple of tobj's load of the
//! same surface as OBJ; which share of the bits the paper's blind detector reads right; the stages
//! that decided. With `--wrong` the suspects are the hosts themselves, which carry nothing, under the same
//! attacks, and generated meshes: right is no match. With `--strangers` they are all files below a
//! folder that can be read, each as it is and marked by somebody else. A record that is named wrongly
//! is reported at once.
//!
//! Attacks follow from the seed and the names. Marks are drawn anew, unless `--data` names a
//! directory of an earlier run. Attacked copies are verified as binary glTF, what was not attacked as it
//! was handed out. Without files: a generated mesh.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/acceptance.rs"]
mod acceptance;
#[path = "support/cases.rs"]
mod cases;
#[path = "support/marks.rs"]
mod marks;
#[path = "support/seeded.rs"]
mod seeded;
#[path = "support/service.rs"]
mod service;

use std::path::{Path, PathBuf};
use std::time::Instant;

use acceptance::{Outcome, Row, print_head};
use cases::{CASES, Case, attacked};
use quadmark::formats::{Asset, Limits};
use quadmark::lab::attacks::Context;
use quadmark::lab::measures::detect;
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::service::{Depth, Verdict};
use quadmark::watermark::{BitCount, EmbedParams, Method, Strength};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use seeded::tobj_seconds;
use service::{Bench, Kind, Mark};

struct Options {
    keys: u64,
    others: u64,
    depth: Depth,
    wrong: bool,
    strangers: Option<PathBuf>,
    cases: Vec<Case>,
    strength: Strength,
    seed: u64,
    data: Option<PathBuf>,
    files: Vec<PathBuf>,
}

fn options() -> Options {
    let mut options = Options {
        keys: 2,
        others: 100_000,
        depth: Depth::Standard,
        wrong: false,
        strangers: None,
        cases: CASES.to_vec(),
        strength: Strength::new(0.1).unwrap(),
        seed: 1,
        data: None,
        files: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--keys" => options.keys = value().parse().unwrap(),
            "--others" => options.others = value().parse().unwrap(),
            "--depth" => options.depth = value().parse().unwrap(),
            "--wrong" => options.wrong = true,
            "--strangers" => options.strangers = Some(value().into()),
            "--attacks" => {
                let named = |name: &str| *CASES.iter().find(|case| case.0 == name).unwrap();
                options.cases = value().split(',').map(named).collect();
            }
            "--strength" => {
                options.strength = Strength::new(value().parse().unwrap()).unwrap();
            }
            "--seed" => options.seed = value().parse().unwrap(),
            "--data" => options.data = Some(value().into()),
            _ => options.files.push(word.into()),
        }
    }
    options
}

/// A file and its name.
struct Host {
    name: String,
    bytes: Vec<u8>,
    mesh: Mesh,
}

impl Host {
    fn new(name: String, bytes: Vec<u8>) -> Self {
        Self { name, mesh: parsed(&bytes), bytes }
    }

    fn generated(sample: Sample) -> Self {
        Self::new(sample.to_string(), to_obj(&sample.mesh(40_000).unwrap()))
    }

    fn all(files: &[PathBuf]) -> Vec<Self> {
        if files.is_empty() {
            return vec![Self::generated(Sample::Knot)];
        }
        let stem = |path: &Path| path.file_stem().unwrap().to_string_lossy().into_owned();
        files.iter().map(|path| Self::new(stem(path), std::fs::read(path).unwrap())).collect()
    }
}

fn parsed(bytes: &[u8]) -> Mesh {
    Asset::read(bytes, &Limits::default()).unwrap().into_mesh()
}

/// A file to be verified, and what it is.
struct Suspect<'a> {
    of: &'a Host,
    mark: &'a Mark,
    bytes: &'a [u8],
    /// Whether it carries the mark.
    marked: bool,
    trial: u64,
}

struct Table {
    options: Options,
    bench: Bench,
}

impl Table {
    /// One cell of the table; `None` when the attack leaves nothing.
    async fn outcome(&self, suspect: &Suspect<'_>, case: Case) -> Option<Outcome> {
        let Mark { record, codeword, .. } = suspect.mark;
        let params = EmbedParams { method: record.method, ..EmbedParams::default() };
        let context = Context { host: &suspect.of.mesh, params: &params };
        let place = (suspect.of.name.as_str(), suspect.trial);
        let mesh =
            attacked(&parsed(suspect.bytes), &context, case, place, self.options.seed).ok()?;
        let as_obj = case.0 == "obj-glb";
        let file = match case.1 {
            [] => suspect.bytes.to_vec(),
            _ if as_obj => to_obj(&mesh),
            _ => to_glb(&mesh),
        };
        let start = Instant::now();
        let verification = self.bench.verify(&file, None, self.options.depth).await;
        let seconds = start.elapsed().as_secs_f64();
        let modulation = record.method.modulation();
        Some(Outcome {
            verification,
            ratio: seconds / tobj_seconds(&to_obj(&mesh), 3),
            paper: detect(&mesh, codeword, modulation, &record.frame).ok(),
            expected: suspect.marked.then_some(record.id),
        })
    }

    /// Suspects under all attacks, as rows.
    async fn table(&self, suspects: &[Suspect<'_>]) -> Vec<Row> {
        let mut rows = Vec::new();
        for &case in &self.options.cases {
            let mut row = Row::default();
            for suspect in suspects {
                let Some(outcome) = self.outcome(suspect, case).await else {
                    row.fail();
                    continue;
                };
                let (name, trial) = (&suspect.of.name, suspect.trial);
                if outcome.is_wrong() {
                    println!(
                        "!!! WRONG RECORD: {name} {trial}, {}: {:#?}",
                        case.0, outcome.verification.matches
                    );
                } else if !outcome.is_right() {
                    let best = outcome.verification.matches.first();
                    let best = best.map_or(0.0, |best| best.log10_fp);
                    println!("not found: {name} {trial}, {}, best log10_fp {best:.1}", case.0);
                }
                row.add(&outcome);
            }
            row.print(case.0);
            rows.push(row);
        }
        rows
    }
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

impl Table {
    /// Files that carry none of the marks: themselves, and marked by somebody else.
    async fn strangers(&self, folder: &Path) {
        let mut random = ChaCha20Rng::from_seed([9; 32]);
        let kind = EmbedParams { strength: self.options.strength, ..EmbedParams::default() };
        let known: Vec<Vec<u8>> =
            self.options.files.iter().map(|file| std::fs::read(file).unwrap()).collect();
        let (mut best, mut wrong) = (0.0_f64, 0);
        let [mut plain, mut marked] = [0; 2];
        for path in files_below(folder) {
            let bytes = std::fs::read(&path).unwrap();
            let readable = Asset::read(&bytes, &Limits::default())
                .is_ok_and(|asset| quadmark::watermark::Suspect::new(&asset.into_mesh()).is_ok());
            if !readable {
                continue;
            }
            let other = marks::marked(&bytes, kind, &mut random).ok();
            marked += u32::from(other.is_some());
            plain += 1;
            // (A host as it is has been tried under all attacks.)
            let plain = (!known.contains(&bytes)).then_some(bytes);
            for suspect in plain.into_iter().chain(other) {
                let verification = self.bench.verify(&suspect, None, self.options.depth).await;
                let Some(found) = verification.matches.first() else { continue };
                best = best.min(found.log10_fp);
                if verification.verdict == Verdict::Match {
                    wrong += 1;
                    println!("!!! WRONG RECORD: {}: {found:#?}", path.display());
                }
            }
        }
        println!(
            "{plain} files, {marked} of them also marked by somebody else: {wrong} wrong matches, \
             least log10_fp {best:.2}"
        );
    }
}

async fn run(options: Options, data: &Path) {
    let hosts = Host::all(&options.files);
    let bench = Bench::start(data, options.others).await;
    let kind =
        Kind { method: Method::default(), strength: options.strength, bits: BitCount::default() };
    let mut marks = Vec::new();
    for host in &hosts {
        for trial in 0..options.keys {
            let owner = format!("{} {trial}", host.name);
            marks.push((host, trial, bench.mark(&host.bytes, &owner, kind).await));
        }
    }
    println!(
        "{} marks, {}, strength {}",
        bench.service.marks(),
        options.depth,
        options.strength.get()
    );
    let bench = Table { options, bench };
    if let Some(folder) = &bench.options.strangers {
        return bench.strangers(folder).await;
    }
    print_head();
    let strangers = Sample::ALL.map(Host::generated);
    let wrong = |of, mark| Suspect { of, mark, bytes: &of.bytes, marked: false, trial: 0 };
    let suspects: Vec<Suspect> = if bench.options.wrong {
        let first = marks.iter().filter(|(_, trial, _)| *trial == 0);
        let hosts = first.map(|(host, _, mark)| wrong(*host, mark));
        hosts.chain(strangers.iter().map(|of| wrong(of, &marks[0].2))).collect()
    } else {
        let marked = marks.iter().map(|(of, trial, mark)| Suspect {
            of,
            mark,
            bytes: &mark.bytes,
            marked: true,
            trial: *trial,
        });
        marked.collect()
    };
    let rows = bench.table(&suspects).await;
    let wrong: u32 = rows.iter().map(Row::wrong).sum();
    println!("records named wrongly: {wrong}");
}

fn main() {
    let options = options();
    let temporary = tempfile::tempdir().unwrap();
    let data = options.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(run(options, &data));
}
