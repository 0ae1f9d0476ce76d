//! Whether a mark is still found when the blind frame is damaged: match rates per attack and mesh,
//! among 100,000 other records.
//!
//! ```text
//! cargo bench --bench blind -- [--runs 3] [--others 100000] [--methods exact-mean,qsp-mean] FILE...
//! ```
//!
//! The marks have the default strength and 64 bits. Per attack: how many of the runs, with other
//! keys and messages, match in the blind frame, after the small layout search (`near`), after the
//! full one, and after the wide one (with `--wide`); the worst bound of the full search; the
//! longest time of each search. A match is a bound below 1e-9, counted as the service counts.
//! Without files: a generated mesh.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

mod attacks;

use std::sync::Arc;
use std::time::Instant;

use attacks::ATTACKS;
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, CodewordIndex, EmbedParams, GroupKey, Hypothesis, LayoutEffort, MarkKey,
    Message, Method, ReportLimits, Search, Suspect, synchronise,
};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const THRESHOLD: f64 = -9.0;
const BLIND_SHARE: f64 = 0.0625;
const NEAR_SHARE: f64 = 0.25;
const FULL_SHARE: f64 = 0.0625;
const WIDE_SHARE: f64 = 0.007_812_5;

struct Options {
    runs: u8,
    others: u32,
    wide: bool,
    only: String,
    methods: Vec<Method>,
    files: Vec<String>,
}

fn options() -> Options {
    let mut options = Options {
        runs: 3,
        others: 100_000,
        wide: false,
        only: String::new(),
        methods: vec![Method::ExactMean, Method::QspMean],
        files: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--wide" => options.wide = true,
            "--runs" => options.runs = value().parse().unwrap(),
            "--others" => options.others = value().parse().unwrap(),
            "--only" => options.only = value(),
            "--methods" => {
                options.methods = value().split(',').map(|name| name.parse().unwrap()).collect();
            }
            _ => options.files.push(word),
        }
    }
    options
}

fn draw(random: &mut ChaCha20Rng) -> (MarkKey, Message) {
    let mut key = [0; 32];
    random.fill_bytes(&mut key);
    let mut message = [0; 8];
    random.fill_bytes(&mut message);
    (MarkKey::from_bytes(key), Message::from_bytes(&message, BitCount::default()).unwrap())
}

/// The bound of record 0 with its hypotheses counted, and its wrong bits; 0 and 64 if it is not
/// found.
fn bound(search: &Search, share: f64) -> (f64, usize) {
    let counted = (search.hypotheses as f64 / share).log10();
    let own = search.candidates.iter().find(|candidate| candidate.id == 0);
    own.map_or((0.0, 64), |c| (c.log10_bound + counted, c.score.bits_read - c.score.bits_agreeing))
}

#[derive(Default, Clone)]
struct Tally {
    matches: u32,
    worst: f64,
    wrong: usize,
    milliseconds: f64,
    foreign: u32,
    rank: usize,
}

impl Tally {
    fn add(&mut self, search: &Search, share: f64, start: Instant) {
        let (bound, wrong) = bound(search, share);
        self.matches += u32::from(bound < THRESHOLD);
        self.worst = if self.worst == 0.0 { bound } else { self.worst.max(bound) };
        self.wrong = self.wrong.max(wrong);
        self.milliseconds = self.milliseconds.max(1e3 * start.elapsed().as_secs_f64());
        let counted = (search.hypotheses as f64 / share).log10();
        let foreign = search.candidates.iter().filter(|c| c.id != 0);
        self.foreign +=
            u32::try_from(foreign.filter(|c| c.log10_bound + counted < THRESHOLD).count()).unwrap();
    }
}

fn main() {
    let options = options();
    let mut random = ChaCha20Rng::from_seed([3; 32]);
    let mut others = CodewordIndex::default();
    others.extend((1..=options.others).map(|id| {
        let (key, message) = draw(&mut random);
        (u128::from(id), Method::QspMean.modulation(), Codeword::new(&key, &message))
    }));
    let mut hosts: Vec<(String, Vec<u8>)> =
        options.files.iter().map(|name| (name.clone(), std::fs::read(name).unwrap())).collect();
    if hosts.is_empty() {
        hosts.push(("a generated knot".into(), to_obj(&Sample::Knot.mesh(40_000).unwrap())));
    }
    let limits = Limits::default();
    let efforts = [
        ("near", NEAR_SHARE, LayoutEffort { radius: 0.002, candidates: 3, centres: 2, layouts: 3 }),
        ("full", FULL_SHARE, LayoutEffort { radius: 0.018, candidates: 4, centres: 2, layouts: 4 }),
        ("wide", WIDE_SHARE, LayoutEffort { radius: 0.04, candidates: 8, centres: 6, layouts: 8 }),
    ];
    let efforts = &efforts[..if options.wide { 3 } else { 2 }];
    for (name, host) in hosts {
        for &method in &options.methods {
            println!("{name} {method}");
            let marked: Vec<(Mesh, Codeword)> = (0..options.runs)
                .map(|_| {
                    let (key, message) = draw(&mut random);
                    let request = MarkRequest {
                        key: &key,
                        others: &[],
                        message: &message,
                        params: EmbedParams { method, ..EmbedParams::default() },
                        limits,
                        stop: &|| false,
                        layers: Layers::Blind,
                        amplitude: Amplitude::default(),
                        independent_check_max_bytes: 0,
                    };
                    let bytes = mark(&host, &request).unwrap().bytes;
                    let mesh = Asset::read(&bytes, &limits).unwrap().into_mesh();
                    (mesh, Codeword::new(&key, &message))
                })
                .collect();
            for (attack, apply) in ATTACKS.iter().filter(|(name, _)| name.contains(&options.only)) {
                let mut tallies = vec![Tally::default(); 1 + efforts.len()];
                for (mesh, codeword) in &marked {
                    let suspect = Suspect::new(&apply(mesh)).unwrap();
                    let mut index = others.clone();
                    index.insert(0, method.modulation(), codeword);
                    let worth = ReportLimits { log10_bound: -4.0, most: 20 };
                    let start = Instant::now();
                    let read = |key: GroupKey| {
                        let soft = suspect.read(key.class, key.bits, key.modulation);
                        vec![Hypothesis { frame: suspect.frame(), soft: Arc::new(soft) }]
                    };
                    let search = index.search(&read, worth);
                    tallies[0].add(&search, BLIND_SHARE, start);
                    for (tally, (_, share, effort)) in tallies.iter_mut().skip(1).zip(efforts) {
                        let start = Instant::now();
                        let found = synchronise(
                            &suspect,
                            codeword.bit_count(),
                            method.modulation(),
                            effort,
                        );
                        let search = index.search(&|key| found.of_class(key.class), worth);
                        tally.add(&search, *share, start);
                        if let Some(own) = search.candidates.iter().find(|c| c.id == 0) {
                            let all = found.of_class(codeword.layout_class());
                            let rank = all.iter().position(|h| h.frame == own.hypothesis.frame);
                            tally.rank = tally.rank.max(rank.unwrap_or(99));
                        }
                    }
                }
                print!("  {attack:26}");
                let names = ["blind"].into_iter().chain(efforts.iter().map(|(name, ..)| *name));
                for (name, tally) in names.zip(&tallies) {
                    print!(
                        "  {name} {}/{} {:6.1} ({:2} wrong, {:5.0} ms, rank {:2})",
                        tally.matches,
                        options.runs,
                        tally.worst,
                        tally.wrong,
                        tally.milliseconds,
                        tally.rank
                    );
                    if tally.foreign > 0 {
                        print!(" {} FOREIGN", tally.foreign);
                    }
                }
                println!();
            }
        }
    }
}
