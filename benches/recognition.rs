//! The acceptance table of detection: marks registered with a service, attacked, and looked for.
//!
//! ```text
//! cargo bench --bench recognition -- [--keys 2] [--others 100000] [--depth standard] [--jobs 1]
//!     [--wrong] [--strangers DIR] [--attacks none,crop-50,...] [--strength 0.1] [--seed 1] [--data DIR]
//!     FILE...
//! ```
//!
//! Per key all files are first marked (the default method, hosts kept) in a registry that holds so
//! many other records. Per attack (`support/cases.rs`): how many of the
//! attacked copies are a `match` (bound below 1e-9) with the right record; the mean of `log10_fp` where
//! that record was named at all; the time of a verification, as a multiple of tobj's load of the
//! same surface as OBJ (of the first key, and where one verification runs at a time); which share of the bits the paper's blind detector reads right; the stages
//! that decided. With `--wrong` the suspects are the hosts themselves, which carry nothing, under the same
//! attacks, and generated meshes: right is no match. With `--strangers` they are all files below a
//! folder that can be read, each as it is and marked by somebody else. A record that is named wrongly
//! is reported at once.
//!
//! Attacks follow from the seed and the names. The table is printed after each key. Marks are drawn
//! anew, unless `--data` names a directory of an earlier run. Attacked copies are verified as binary glTF, what was not attacked as it
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

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
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
use tokio::runtime::Runtime;

struct Options {
    keys: u64,
    others: u64,
    depth: Depth,
    jobs: usize,
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
        jobs: 1,
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
            "--jobs" => options.jobs = value().parse().unwrap(),
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

/// A registry with the marks of one key.
struct Table<'a> {
    options: &'a Options,
    bench: Bench,
    runtime: &'a Runtime,
}

impl Table<'_> {
    /// One cell of the table; `None` when the attack leaves nothing.
    fn outcome(&self, suspect: &Suspect<'_>, case: Case) -> Option<Outcome> {
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
        let verify = self.bench.verify(&file, None, self.options.depth);
        let verification = self.runtime.block_on(verify);
        let seconds = start.elapsed().as_secs_f64();
        let modulation = record.method.modulation();
        // (Beside others a time says nothing.)
        let timed = self.options.jobs == 1 && suspect.trial == 0;
        Some(Outcome {
            verification,
            ratio: timed.then(|| seconds / tobj_seconds(&to_obj(&mesh), 3)),
            paper: detect(&mesh, codeword, modulation, &record.frame).ok(),
            expected: suspect.marked.then_some(record.id),
        })
    }

    /// The outcomes of all suspects, so many at a time, in their order.
    fn outcomes(&self, suspects: &[Suspect<'_>], case: Case) -> Vec<Option<Outcome>> {
        let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
        std::thread::scope(|scope| {
            for _ in 0..self.options.jobs {
                scope.spawn(|| {
                    loop {
                        let at = next.fetch_add(1, Ordering::Relaxed);
                        let Some(suspect) = suspects.get(at) else { break };
                        let outcome = self.outcome(suspect, case);
                        outcomes.lock().unwrap().insert(at, outcome);
                    }
                });
            }
        });
        outcomes.into_inner().unwrap().into_values().collect()
    }

    /// Adds suspects under all attacks to rows.
    fn fill(&self, suspects: &[Suspect<'_>], rows: &mut [Row]) {
        for (&case, row) in self.options.cases.iter().zip(rows) {
            for (suspect, outcome) in suspects.iter().zip(self.outcomes(suspects, case)) {
                let Some(outcome) = outcome else {
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
        }
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

impl Table<'_> {
    /// Files that carry none of the marks: themselves, and marked by somebody else.
    fn strangers(&self, folder: &Path) {
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
                let verify = self.bench.verify(&suspect, None, self.options.depth);
                let verification = self.runtime.block_on(verify);
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

/// Marks all hosts with one more key, in a registry of its own, and fills the rows.
fn run(options: &Options, hosts: &[Host], trial: u64, data: &Path, rows: &mut [Row]) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let bench = runtime.block_on(Bench::start(&data.join(trial.to_string()), options.others));
    let kind =
        Kind { method: Method::default(), strength: options.strength, bits: BitCount::default() };
    let mark = |host: &Host| {
        runtime.block_on(bench.mark(&host.bytes, &format!("{} {trial}", host.name), kind))
    };
    let marks: Vec<Mark> = hosts.iter().map(mark).collect();
    let table = Table { options, bench, runtime: &runtime };
    if let Some(folder) = &options.strangers {
        return table.strangers(folder);
    }
    let pairs = || hosts.iter().zip(&marks);
    if options.wrong {
        let strangers = Sample::ALL.map(Host::generated);
        let wrong = |of, mark| Suspect { of, mark, bytes: &of.bytes, marked: false, trial };
        let suspects = pairs().map(|(of, mark)| wrong(of, mark));
        let strangers = strangers.iter().map(|of| wrong(of, &marks[0]));
        let suspects: Vec<Suspect> = suspects.chain(strangers).collect();
        table.fill(&suspects, rows);
    } else {
        let suspects: Vec<Suspect> = pairs()
            .map(|(of, mark)| Suspect { of, mark, bytes: &mark.bytes, marked: true, trial })
            .collect();
        table.fill(&suspects, rows);
    }
}

fn main() {
    let options = options();
    let temporary = tempfile::tempdir().unwrap();
    let data = options.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    let hosts = Host::all(&options.files);
    let mut rows: Vec<Row> = options.cases.iter().map(|_| Row::default()).collect();
    let keys = if options.strangers.is_some() { 1 } else { options.keys };
    for trial in 0..keys {
        run(&options, &hosts, trial, &data, &mut rows);
        if options.strangers.is_some() {
            return;
        }
        let (meshes, done, depth) = (hosts.len(), trial + 1, options.depth);
        println!(
            "{meshes} meshes, {done} keys, {depth}, strength {}, {} other records",
            options.strength.get(),
            options.others
        );
        print_head();
        for (case, row) in options.cases.iter().zip(&rows) {
            row.print(case.0);
        }
        println!("records named wrongly: {}", rows.iter().map(Row::wrong).sum::<u32>());
    }
}
