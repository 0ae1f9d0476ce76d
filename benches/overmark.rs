//! Overmarks: a marked file is marked again. Is the older mark still found?
//!
//! ```text
//! cargo bench --bench overmark -- [--methods exact-mean] [--over METHOD] [--bits 64]
//!     [--strength 0.1] [--runs 6] [--others 100000] FILE...
//! ```
//!
//! Per mesh and run, a file is marked and registered. Then it is marked again, once by another
//! owner of the same registry and once by a stranger whose mark is not in the registry. The
//! overmark has the same method, unless `--over` names another. Per case: how many of the older
//! marks are a match, by the stage that decided, and the median and the worst `log10_fp`. Over the
//! registry's own mark, one verification asks about everybody, where the later record names the
//! older one, and one asks about the older owner alone. Over the stranger's mark, one asks about
//! everybody. Without files: generated meshes of 40,000 vertices.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/marks.rs"]
mod marks;
#[path = "support/seeded.rs"]
mod seeded;
#[path = "support/service.rs"]
mod service;

use std::collections::BTreeMap;

use marks::{hosts, marked};
use quadmark::service::{Depth, Verification};
use quadmark::watermark::{BitCount, EmbedParams, Method, Strength};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use service::{Bench, Kind, Mark};

/// log10 of the bound below which a verdict is a match.
const MATCH: f64 = -9.0;

#[derive(Default)]
struct Row {
    trials: usize,
    found: usize,
    both: usize,
    bounds: Vec<f64>,
    stages: BTreeMap<&'static str, usize>,
}

impl Row {
    fn add(&mut self, older: &Mark, verification: &Verification) {
        let matches = || verification.matches.iter().filter(|found| found.log10_fp < MATCH);
        let theirs = matches().find(|found| found.watermark_id == older.record.id);
        self.trials += 1;
        self.found += usize::from(theirs.is_some());
        self.both += usize::from(matches().count() > 1);
        self.bounds.push(theirs.map_or(0.0, |found| found.log10_fp));
        if let Some(found) = theirs {
            let stage = if found.overmarked_by.is_some() {
                "later record"
            } else {
                found.evidence.as_ref().map_or("-", |evidence| evidence.stage.name())
            };
            *self.stages.entry(stage).or_default() += 1;
        }
    }

    fn print(mut self, name: &str) {
        self.bounds.sort_unstable_by(f64::total_cmp);
        let (Some(worst), Some(median)) =
            (self.bounds.last(), self.bounds.get(self.bounds.len() / 2))
        else {
            return;
        };
        let Self { found, trials, both, stages, .. } = &self;
        println!(
            "  {name:32} {found} of {trials}, both {both}   log10_fp {median:6.1}, worst \
             {worst:6.1}   {stages:?}"
        );
    }
}

struct Options {
    methods: Vec<Method>,
    over: Option<Method>,
    bits: BitCount,
    strength: Strength,
    runs: u64,
    others: u64,
    files: Vec<String>,
}

fn options() -> Options {
    let mut options = Options {
        methods: vec![Method::default()],
        over: None,
        bits: BitCount::default(),
        strength: Strength::new(0.1).unwrap(),
        runs: 6,
        others: 100_000,
        files: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--bits" => options.bits = marks::bits(&value()),
            "--strength" => options.strength = Strength::new(value().parse().unwrap()).unwrap(),
            "--runs" => options.runs = value().parse().unwrap(),
            "--others" => options.others = value().parse().unwrap(),
            "--over" => options.over = Some(value().parse().unwrap()),
            "--methods" => {
                options.methods = value().split(',').map(|name| name.parse().unwrap()).collect();
            }
            _ => options.files.push(word),
        }
    }
    options
}

async fn run(options: Options, data: &std::path::Path) {
    let bench = Bench::start(data, options.others).await;
    let mut random = ChaCha20Rng::from_seed([2; 32]);
    for (name, file) in hosts(options.files) {
        for &method in &options.methods {
            let kind = Kind { method, strength: Some(options.strength), bits: options.bits };
            let later = Kind { method: options.over.unwrap_or(method), ..kind };
            println!("{name}, {} over {method}, {} bits", later.method, kind.bits.get());
            let [mut everybody, mut alone, mut stranger] = [(); 3].map(|()| Row::default());
            for trial in 0..options.runs {
                let (older_owner, owner) =
                    (format!("{name} {trial}"), format!("later {name} {trial}"));
                let older = bench.mark(&file, &older_owner, kind).await;
                let over = bench.mark(&older.bytes, &owner, later).await;
                let standard = Depth::Standard;
                everybody.add(&older, &bench.verify(&over.bytes, None, standard).await);
                let only = Some(older_owner.as_str());
                alone.add(&older, &bench.verify(&over.bytes, only, standard).await);
                let params = EmbedParams {
                    method: later.method,
                    strength: options.strength,
                    bits: later.bits,
                    ..EmbedParams::default()
                };
                let theirs = marked(&older.bytes, params, &mut random).unwrap();
                stranger.add(&older, &bench.verify(&theirs, None, standard).await);
            }
            everybody.print("over the registry's own mark");
            alone.print("the same, older owner alone");
            stranger.print("over a stranger's mark");
        }
    }
}

fn main() {
    let temporary = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(run(options(), &temporary.path().join("data")));
}
