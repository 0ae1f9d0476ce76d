//! The acceptance table of detection: marks registered with a service, attacked, and looked for.
//!
//! ```text
//! cargo bench --bench recognition -- [--keys 2] [--others 100000] [--depth standard] [--wrong]
//!     [--attacks none,crop-50,...] [--seed 1] [--data DIR] FILE...
//! ```
//!
//! All files are first marked, by so many owners each (`exact-mean`, strength 0.1, hosts kept), in
//! one registry that holds so many other records. Per attack (`support/cases.rs`): how many of the
//! attacked copies are a `match` (bound below 1e-9) with the right record; the mean of `log10_fp` where
//! that record was named at all; the time of a verification, as a multiple of tobj's load of the
//! same surface as OBJ; which share of the bits the paper's blind detector reads right; the stages
//! that decided. With `--wrong` the suspects are the hosts themselves, which carry nothing, under the same
//! attacks, and generated meshes: right is no match. A record that is named wrongly is reported at once.
//!
//! Attacks follow from the seed and the names. Marks are drawn anew, unless `--data` names a
//! directory of an earlier run. Attacked copies are verified as binary glTF, what was not attacked as it
//! was handed out. Without files: a generated mesh.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/acceptance.rs"]
mod acceptance;
#[path = "support/cases.rs"]
mod cases;
#[path = "support/seeded.rs"]
mod seeded;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use acceptance::{Outcome, Row, print_head};
use cases::{CASES, Case, attacked};
use quadmark::formats::{Asset, Limits};
use quadmark::keys::KeyRing;
use quadmark::lab::attacks::Context;
use quadmark::lab::measures::detect;
use quadmark::mesh::Mesh;
use quadmark::registry::Record;
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::service::{
    Depth, EmbedRequest, OnExisting, Service, Spooled, Text, Verification, VerifyRequest,
};
use quadmark::watermark::{BitCount, Codeword, EmbedParams, MarkKey, Message, Method, Strength};
use seeded::{config, seed, tobj_seconds};

struct Options {
    keys: u64,
    others: u64,
    depth: Depth,
    wrong: bool,
    cases: Vec<Case>,
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
        cases: CASES.to_vec(),
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
            "--attacks" => {
                let named = |name: &str| *CASES.iter().find(|case| case.0 == name).unwrap();
                options.cases = value().split(',').map(named).collect();
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

/// A registered mark and its file.
struct Mark {
    record: Record,
    bytes: Vec<u8>,
    codeword: Codeword,
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

struct Bench {
    options: Options,
    service: Arc<Service>,
    keys: KeyRing,
}

impl Bench {
    async fn start(options: Options, data: &Path) -> Self {
        // The first start makes the schema and the master key.
        Service::open(config(data)).await.unwrap().close().await;
        seed(data, options.others).await;
        let service = Service::open(config(data)).await.unwrap();
        let keys = KeyRing::open(&data.join("master.keys")).unwrap();
        Self { options, service, keys }
    }

    async fn upload(&self, bytes: &[u8]) -> Spooled {
        let spool = self.service.spool().unwrap().write(bytes).await.unwrap();
        spool.end(None).await.unwrap()
    }

    async fn mark(&self, host: &Host, trial: u64) -> Mark {
        let owner = format!("{} {trial}", host.name);
        let request = EmbedRequest {
            file: self.upload(&host.bytes).await,
            owner_id: Text::parse("owner_id", &owner).unwrap(),
            recipient: None,
            label: None,
            method: Method::default(),
            strength: Some(Strength::default()),
            max_distortion: None,
            bits: BitCount::default(),
            payload: None,
            keep_file: true,
            keep_host: true,
            on_existing: OnExisting::Allow,
            // A later run over the same directory gets the same mark.
            idempotency_key: Some("acceptance".to_owned()),
        };
        let embedded = self.service.embed(request).await.unwrap();
        let record = embedded.record;
        let key = self.keys.mark_key(&record.key_id, &record.salt, &record.owner_id).unwrap();
        let message = Message::from_bytes(&record.message, record.bits).unwrap();
        let codeword = Codeword::new(&MarkKey::from_bytes(*key), &message);
        Mark { record, bytes: embedded.bytes.to_vec(), codeword }
    }

    async fn verify(&self, bytes: &[u8]) -> (Verification, f64) {
        let start = Instant::now();
        let file = self.upload(bytes).await;
        let depth = self.options.depth;
        let request = VerifyRequest { file, owner_id: None, watermark_id: None, depth };
        let verification = self.service.verify(request).await.unwrap();
        (verification, start.elapsed().as_secs_f64())
    }

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
        let (verification, seconds) = self.verify(&file).await;
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

async fn run(options: Options, data: &Path) {
    let hosts = Host::all(&options.files);
    let bench = Bench::start(options, data).await;
    let mut marks = Vec::new();
    for host in &hosts {
        for trial in 0..bench.options.keys {
            marks.push((host, trial, bench.mark(host, trial).await));
        }
    }
    println!("{} marks, {}", bench.service.marks(), bench.options.depth);
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
