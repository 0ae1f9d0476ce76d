//! The acceptance table of detection: marks are registered with a service, attacked, and searched
//! for.
//!
//! ```text
//! cargo bench --bench recognition -- [--record] [--keys 2] [--others 100000] [--depth standard]
//!     [--jobs 1] [--attacks none,crop-50+in-place,...] [--strength S] [--seed 1] [--minutes 0]
//!     [--wrong] [--strangers DIR] [--data DIR] FILE...
//! ```
//!
//! Every file is marked for `--keys` recipients with the default method, and hosts are kept. The
//! same registry holds `--others` other records. Hosts are prepared once. Each suspect is judged
//! under all keys, and every named record but its own is a wrong one. A trial is one recipient's
//! copy under one attack; a round is one trial on each mesh. Suspects are moved by a random
//! similarity at the end, unless the attack's name ends in `+in-place`. `--attacks help` lists the
//! names (`attacks::named`). There are three more:
//!
//! - `averaged-N`: N recipients' copies are averaged, and each recipient must be named. A large
//!   mesh takes part only if it has enough copies.
//! - `laundered`: a crop of 30 % and noise of 0.5 %, then registered anew by somebody else. The
//!   answer or a verification of the new copy must name the first record.
//! - `pipelines`: a hundred pipelines of three attacks, each on one mesh.
//!
//! **Trials stop early.** If a share is required, outcomes of all meshes go into Wald's sequential
//! test of that share (at most 0.99) against 0.15 less, with errors of 5 % (`lab::sequential`). A
//! required share of 1 is met after 18 trials without a failure, and missed after two failures in
//! the first trials. No attack has more rounds than keys. Attacks without a required share have
//! `--report` rounds (2). Each round goes over all attacks, so that `--minutes` ends the run with
//! all rows equally far.
//!
//! The table is Markdown: right / wrong / none per mesh, the sum, the decision, the mean log10 of
//! the bound where the record was reported, how many bits the paper's blind reader has right, and
//! the stages that decided. `--wrong` adds files without a mark, the hosts and generated meshes,
//! under all attacks. Each is judged under all keys at once, and no match is right. `--strangers`
//! adds all readable files below a folder: as they are, marked by somebody else, and the latter
//! under one attack each. A wrongly named record is reported at once.
//!
//! `--record` is the whole acceptance list with ten keys, two jobs and the wrong files, within 85
//! minutes. Attacks follow from the seed and the names. Marks are drawn anew, unless `--data` names
//! a directory of an earlier run. Attacked copies are verified as binary glTF; a file that was not
//! attacked is verified as it was handed out. Without files: a generated mesh.
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
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use acceptance::{Outcome, Row, print_head};
use cases::{Case, PIPELINES};
use quadmark::attacks::{Attack, Context, collude};
use quadmark::formats::{Asset, Limits};
use quadmark::lab::measures::detect;
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::service::{Depth, Match, Verdict, Verification};
use quadmark::watermark::{BitCount, EmbedParams, Method, Strength};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use service::{Bench, Kind, Mark};
use tokio::runtime::Runtime;

/// A match with a bound below this, as log10, names a record.
const MATCH: f64 = -9.0;
/// Copies beyond the keys are made only if all of them together have fewer vertices than this.
const MOST_VERTICES: usize = 2_000_000;

struct Options {
    keys: usize,
    report: usize,
    others: u64,
    depth: Depth,
    jobs: usize,
    wrong: bool,
    strangers: Option<PathBuf>,
    cases: Vec<Case>,
    strength: Option<Strength>,
    seed: u64,
    minutes: f64,
    data: Option<PathBuf>,
    files: Vec<PathBuf>,
}

fn named(names: &str) -> Vec<Case> {
    let of = |name: &str| {
        Case::named(name).unwrap_or_else(|error| {
            println!("{error}also: averaged-N, laundered, pipelines; +in-place at the end");
            std::process::exit(2)
        })
    };
    names.split(',').map(of).collect()
}

fn options() -> Options {
    let mut options = Options {
        keys: 2,
        report: 2,
        others: 100_000,
        depth: Depth::Standard,
        jobs: 1,
        wrong: false,
        strangers: None,
        cases: Case::acceptance(),
        strength: None,
        seed: 1,
        minutes: 0.0,
        data: None,
        files: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--record" => {
                (options.keys, options.jobs, options.wrong) = (10, 2, true);
                options.minutes = 85.0;
            }
            "--keys" => options.keys = value().parse().unwrap(),
            "--report" => options.report = value().parse().unwrap(),
            "--others" => options.others = value().parse().unwrap(),
            "--depth" => options.depth = value().parse().unwrap(),
            "--jobs" => options.jobs = value().parse().unwrap(),
            "--wrong" => options.wrong = true,
            "--strangers" => options.strangers = Some(value().into()),
            "--attacks" => options.cases = named(&value()),
            "--strength" => {
                options.strength = Some(Strength::new(value().parse().unwrap()).unwrap());
            }
            "--seed" => options.seed = value().parse().unwrap(),
            "--minutes" => options.minutes = value().parse().unwrap(),
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

/// A registry with marks of all hosts.
struct Table<'a> {
    options: &'a Options,
    hosts: &'a [Host],
    /// The marks of each host, by number.
    marks: Vec<Vec<Mark>>,
    bench: Bench,
    runtime: &'a Runtime,
    start: Instant,
}

/// The records that a verification names.
fn named_by(verification: &Verification) -> impl Iterator<Item = &Match> {
    let found = verification.verdict == Verdict::Match;
    verification.matches.iter().filter(move |m| found && m.log10_fp < MATCH)
}

/// Calls `of` for the numbers below `count` in `jobs` threads; the results in order.
fn all<T: Send>(jobs: usize, count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    if at >= count {
                        break;
                    }
                    let result = of(at);
                    done.lock().unwrap().push((at, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap();
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

impl Table<'_> {
    fn kind(&self) -> Kind {
        Kind {
            method: Method::default(),
            strength: self.options.strength,
            bits: BitCount::default(),
        }
    }

    /// Marks hosts until each has `copies` copies. Large hosts get at most one per key.
    fn mark(&mut self, copies: usize) {
        let wanted = |host: &Host| {
            let few = copies * host.mesh.positions().len() <= MOST_VERTICES;
            if few { copies } else { copies.min(self.options.keys) }
        };
        let made = all(self.options.jobs, self.hosts.len(), |at| {
            let host = &self.hosts[at];
            let mark = |number: usize| {
                let owner = format!("{} {number}", host.name);
                self.runtime.block_on(self.bench.mark(&host.bytes, &owner, self.kind()))
            };
            (self.marks[at].len()..wanted(host)).map(mark).collect::<Vec<Mark>>()
        });
        for (marks, made) in self.marks.iter_mut().zip(made) {
            marks.extend(made);
        }
    }

    fn time_is_up(&self) -> bool {
        let minutes = self.start.elapsed().as_secs_f64() / 60.0;
        self.options.minutes > 0.0 && minutes > self.options.minutes
    }

    fn verify(&self, file: &[u8]) -> Verification {
        self.runtime.block_on(self.bench.verify(file, None, self.options.depth))
    }

    fn file(case: &Case, original: &[u8], mesh: &Mesh) -> Vec<u8> {
        if case.is_nothing() { original.to_vec() } else { to_glb(mesh) }
    }

    /// Judges a verification for each of the records that must be named.
    fn judged(
        what: &str,
        verification: &Verification,
        expected: &[&Mark],
        mesh: Option<&Mesh>,
    ) -> Vec<Outcome> {
        let mut wrong = 0;
        for found in named_by(verification) {
            if expected.iter().all(|mark| mark.record.id != found.watermark_id) {
                wrong += 1;
                println!("!!! WRONG RECORD: {what}: {found:#?}");
            }
        }
        let judge = |(number, mark): (usize, &&Mark)| {
            let Mark { record, codeword, .. } = *mark;
            let own = |found: &&Match| found.watermark_id == record.id;
            let told = verification.matches.iter().find(own);
            let named = named_by(verification).find(own);
            if named.is_none() {
                let best = told.map_or(0.0, |found| found.log10_fp);
                println!("not found: {what} {number}, log10_fp {best:.1}");
            }
            let read = |mesh| {
                let modulation = record.method.modulation();
                let read = detect(mesh, codeword, modulation, &record.frame).ok()?;
                Some(read.right as f64 / (read.right + read.wrong + read.erased) as f64)
            };
            let how = named.and_then(|found| found.evidence.as_ref());
            Outcome {
                right: named.is_some(),
                wrong: if number == 0 { wrong } else { 0 },
                log10_fp: told.map(|found| found.log10_fp),
                stage: how.map_or("-", |how| how.stage.name()),
                blind: mesh.and_then(read),
            }
        };
        expected.iter().enumerate().map(judge).collect()
    }

    /// One trial; `None` if the attack leaves no mesh.
    fn trial(&self, case: &Case, at: usize, round: usize) -> Option<Vec<Outcome>> {
        let (host, mark) = (&self.hosts[at], &self.marks[at][round]);
        let params = EmbedParams { method: mark.record.method, ..EmbedParams::default() };
        let context = Context { host: &host.mesh, params: &params, amplitude: None };
        let place = (host.name.as_str(), round as u64);
        let what = format!("{} {round}, {}", host.name, case.name);
        let attacked = |mesh: &Mesh| case.apply(mesh, &context, place, self.options.seed).ok();
        match case.kind {
            cases::Kind::Averaged(copies) => {
                let marks: Vec<&Mark> = self.marks[at].iter().take(copies as usize).collect();
                let meshes: Vec<Mesh> = marks.iter().map(|mark| parsed(&mark.bytes)).collect();
                let mean = collude::average(&meshes.iter().collect::<Vec<_>>()).ok()?;
                let mesh = attacked(&mean)?;
                let verification = self.verify(&to_glb(&mesh));
                Some(Self::judged(&what, &verification, &marks, Some(&mesh)))
            }
            cases::Kind::Laundered => {
                let mesh = attacked(&parsed(&mark.bytes))?;
                let owner = format!("launderer of {} {round}", host.name);
                let file = to_glb(&mesh);
                let marking = self.bench.try_mark(&file, &owner, self.kind());
                let anew = self.runtime.block_on(marking).ok()?;
                let verification = self.verify(&anew.bytes);
                let mut outcome =
                    Self::judged(&what, &verification, &[mark, &anew], Some(&mesh)).remove(0);
                let told = anew.record.existing_marks.iter().flatten();
                if told.clone().any(|existing| existing.watermark_id == mark.record.id) {
                    outcome = Outcome { right: true, stage: "when registered", ..outcome };
                }
                Some(vec![outcome])
            }
            _ => {
                let mesh = attacked(&parsed(&mark.bytes))?;
                let verification = self.verify(&Self::file(case, &mark.bytes, &mesh));
                Some(Self::judged(&what, &verification, &[mark], Some(&mesh)))
            }
        }
    }

    /// The trials of one round, on all meshes that have the copies.
    fn round(&self, case: &Case, round: usize, row: &mut Row) {
        let least = match case.kind {
            cases::Kind::Averaged(copies) => copies as usize,
            _ => round + 1,
        };
        let fit: Vec<usize> =
            (0..self.hosts.len()).filter(|&at| self.marks[at].len() >= least).collect();
        let outcomes = all(self.options.jobs, fit.len(), |k| self.trial(case, fit[k], round));
        for (at, outcomes) in fit.into_iter().zip(outcomes) {
            match outcomes {
                Some(outcomes) => outcomes.iter().for_each(|outcome| row.add(at, outcome)),
                None => row.fail(),
            }
        }
    }

    /// All pipelines, each on one mesh.
    fn pipelines(&self, row: &mut Row) {
        let outcomes = all(self.options.jobs, PIPELINES as usize, |number| {
            let case = Case::pipeline(u32::try_from(number).unwrap());
            let at = number % self.hosts.len();
            let round = number / self.hosts.len() % self.marks[at].len();
            (at, (!self.time_is_up()).then(|| self.trial(&case, at, round)))
        });
        for (number, (at, outcomes)) in (0..).zip(outcomes) {
            let Some(outcomes) = outcomes else { continue };
            let right = outcomes.as_ref().is_some_and(|all| all.iter().all(|one| one.right));
            let verdict = if right { "recognised" } else { "not" };
            println!("{}: {}, {verdict}", self.hosts[at].name, Attack::Pipeline(number));
            match outcomes {
                Some(outcomes) => outcomes.iter().for_each(|outcome| row.add(at, outcome)),
                None => row.fail(),
            }
        }
    }

    /// Fills the rows, round by round, without rows that are decided.
    fn fill(&mut self, rows: &mut [Row]) {
        self.mark(self.options.keys);
        let cases = &self.options.cases;
        for round in 0..self.options.keys {
            for (case, row) in cases.iter().zip(rows.iter_mut()) {
                let rounds = if case.wanted.is_some() { usize::MAX } else { self.options.report };
                let usual = case.kind == cases::Kind::Copy;
                if usual && round < rounds && !row.is_plain() && !self.time_is_up() {
                    self.round(case, round, row);
                }
            }
            println!("round {round} after {:.0} s", self.start.elapsed().as_secs_f64());
        }
        // Then cases with one round, and cases that register more marks.
        for (case, row) in cases.iter().zip(rows.iter_mut()) {
            match case.kind {
                cases::Kind::Averaged(copies) if !self.time_is_up() => {
                    self.mark(copies as usize);
                    self.round(case, 0, row);
                }
                cases::Kind::Pipelines => self.pipelines(row),
                cases::Kind::Laundered => {
                    for round in 0..self.options.keys {
                        if !row.is_plain() && !self.time_is_up() {
                            self.round(case, round, row);
                        }
                    }
                }
                _ => {}
            }
        }
    }

    /// Files without a mark, under all attacks, judged under all keys at once.
    fn wrong_files(&self) {
        let generated = Sample::ALL.map(Host::generated);
        let mut files: Vec<&Host> = self.hosts.iter().chain(&generated).collect();
        files.sort_by_key(|host| host.mesh.positions().len());
        let cases: Vec<&Case> =
            self.options.cases.iter().filter(|case| case.kind == cases::Kind::Copy).collect();
        let params = EmbedParams::default();
        let outcomes = all(self.options.jobs, files.len() * cases.len(), |number| {
            let (host, case) = (files[number / cases.len()], cases[number % cases.len()]);
            if self.time_is_up() {
                return None;
            }
            let context = Context { host: &host.mesh, params: &params, amplitude: None };
            let place = (host.name.as_str(), u64::MAX);
            let mesh = case.apply(&host.mesh, &context, place, self.options.seed).ok()?;
            let verification = self.verify(&Self::file(case, &host.bytes, &mesh));
            let what = format!("{}, which carries nothing, {}", host.name, case.name);
            Self::judged(&what, &verification, &[], None);
            Some(verification.verdict)
        });
        let count = |verdict| outcomes.iter().flatten().filter(|v| **v == verdict).count();
        println!(
            "\nwrong files: {} of {} no match, {} inconclusive, {} MATCHED",
            count(Verdict::NoMatch),
            outcomes.iter().flatten().count(),
            count(Verdict::Inconclusive),
            count(Verdict::Match),
        );
    }

    /// Files without a registered mark: as they are, marked by somebody else, and the latter
    /// attacked.
    fn strangers(&self, folder: &Path) {
        let mut random = ChaCha20Rng::from_seed([9; 32]);
        let strength = self.options.strength.unwrap_or_default();
        let kind = EmbedParams { strength, ..EmbedParams::default() };
        let known: Vec<&[u8]> = self.hosts.iter().map(|host| host.bytes.as_slice()).collect();
        let cases: Vec<&Case> =
            self.options.cases.iter().filter(|case| case.kind == cases::Kind::Copy).collect();
        let (mut best, mut wrong) = (0.0_f64, 0);
        let [mut plain, mut marked, mut attacks] = [0; 3];
        for path in files_below(folder) {
            let bytes = std::fs::read(&path).unwrap();
            let readable = Asset::read(&bytes, &Limits::default())
                .is_ok_and(|asset| quadmark::watermark::Suspect::new(&asset.into_mesh()).is_ok());
            if !readable {
                continue;
            }
            let other = marks::marked(&bytes, kind, &mut random).ok();
            marked += u32::from(other.is_some());
            let mesh = parsed(other.as_ref().unwrap_or(&bytes));
            let context = Context { host: &mesh, params: &kind, amplitude: None };
            let attacked = (!cases.is_empty()).then(|| cases[plain as usize % cases.len()]);
            let attacked = attacked.and_then(|case| {
                case.apply(&mesh, &context, ("stranger", u64::from(plain)), self.options.seed).ok()
            });
            plain += 1;
            attacks += u32::from(attacked.is_some());
            // A host as it is was tried under all attacks.
            let own = (!known.contains(&bytes.as_slice())).then_some(bytes);
            for suspect in own.into_iter().chain(other).chain(attacked.map(|mesh| to_glb(&mesh))) {
                let verification = self.verify(&suspect);
                let Some(found) = verification.matches.first() else { continue };
                best = best.min(found.log10_fp);
                if verification.verdict == Verdict::Match {
                    wrong += 1;
                    println!("!!! WRONG RECORD: {}: {found:#?}", path.display());
                }
            }
        }
        println!(
            "{plain} files, {marked} of them also marked by somebody else, {attacks} also attacked: \
             {wrong} wrong matches, least log10_fp {best:.2}"
        );
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

fn main() {
    let start = Instant::now();
    let options = options();
    let temporary = tempfile::tempdir().unwrap();
    let data = options.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    let mut hosts = Host::all(&options.files);
    // The large ones first, so that the others fill the time beside them.
    hosts.sort_by_key(|host| std::cmp::Reverse(host.mesh.positions().len()));
    let mut rows: Vec<Row> = options.cases.iter().map(|case| Row::new(case.wanted)).collect();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let bench = runtime.block_on(Bench::start(&data, options.others));
    let marks = hosts.iter().map(|_| Vec::new()).collect();
    let mut table =
        Table { options: &options, hosts: &hosts, marks, bench, runtime: &runtime, start };
    table.fill(&mut rows);
    println!(
        "\n{} meshes, up to {} keys, {}, strength {}, {} other records, seed {}",
        hosts.len(),
        options.keys,
        options.depth,
        options.strength.map_or("as usual".to_owned(), |strength| strength.get().to_string()),
        options.others,
        options.seed
    );
    let names: Vec<&str> = hosts.iter().map(|host| host.name.as_str()).collect();
    print_head(&names);
    for (case, row) in options.cases.iter().zip(&rows) {
        row.print(&case.name, hosts.len());
    }
    println!("\nrecords named wrongly: {}", rows.iter().map(Row::wrong).sum::<u32>());
    if options.wrong {
        table.wrong_files();
    }
    if let Some(folder) = &options.strangers {
        table.strangers(folder);
    }
    let up = if table.time_is_up() { ", time was up" } else { "" };
    println!("{:.0} minutes{up}", start.elapsed().as_secs_f64() / 60.0);
}
