//! Collusion: recipients average their copies. Which of them are still named?
//!
//! ```text
//! cargo bench --bench collusion -- [--methods exact-mean] [--bits 64] [--strength 0.1]
//!     [--recipients 30] [--others 100000] FILE...
//! ```
//!
//! Each host is marked for `--recipients` recipients and kept, in a registry with `--others` other
//! records. Groups of 1, 2, 3, 5 and 10 recipients average their copies; each recipient is in one
//! group of each size. Per size, of a verification at standard depth: how many of the colluders are
//! named by a match, how many others are named (there must be none), the median and the worst
//! `log10_fp` of colluders, and how many a blind reader would have named. Without files: generated
//! meshes of 40,000 vertices.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/marks.rs"]
mod marks;
#[path = "support/seeded.rs"]
mod seeded;
#[path = "support/service.rs"]
mod service;

use glam::DVec3;
use marks::{hosts, parsed};
use quadmark::mesh::Mesh;
use quadmark::sample::to_glb;
use quadmark::service::Depth;
use quadmark::watermark::{BitCount, Method, Strength, Suspect};
use service::{Bench, Kind, Mark};

const GROUPS: [usize; 5] = [1, 2, 3, 5, 10];

/// log10 of the bound below which a verdict is a match.
const MATCH: f64 = -9.0;

/// log10 of the factor on the blind stage's bounds: all records, and a sixteenth of the error
/// probability.
fn counted(records: usize) -> f64 {
    (records as f64).log10() + 1.204_12
}

/// The mean of the copies, vertex by vertex.
fn average(copies: &[(&Mark, Mesh)]) -> Mesh {
    let count = copies.len() as f64;
    let first = &copies[0].1;
    let at = |v: usize| copies.iter().map(|(_, mesh)| mesh.positions()[v]).sum::<DVec3>() / count;
    let positions = (0..first.positions().len()).map(at).collect();
    Mesh::new(positions, first.triangles().to_vec()).unwrap()
}

struct Options {
    methods: Vec<Method>,
    bits: BitCount,
    strength: Strength,
    recipients: u64,
    others: u64,
    files: Vec<String>,
}

fn options() -> Options {
    let mut options = Options {
        methods: vec![Method::default()],
        bits: BitCount::default(),
        strength: Strength::new(0.1).unwrap(),
        recipients: 30,
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
            "--recipients" => options.recipients = value().parse().unwrap(),
            "--others" => options.others = value().parse().unwrap(),
            "--methods" => {
                options.methods = value().split(',').map(|name| name.parse().unwrap()).collect();
            }
            _ => options.files.push(word),
        }
    }
    options
}

#[derive(Default)]
struct Row {
    colluders: usize,
    named: usize,
    innocent: usize,
    blind: usize,
    bounds: Vec<f64>,
}

async fn collude(bench: &Bench, copies: &[(&Mark, Mesh)], row: &mut Row) {
    let mesh = average(copies);
    let verification = bench.verify(&to_glb(&mesh), None, Depth::Standard).await;
    let suspect = Suspect::new(&mesh).unwrap();
    let bound_of = |id| {
        let found = verification.matches.iter().find(|found| found.watermark_id == id);
        found.map_or(0.0, |found| found.log10_fp)
    };
    let named = verification.matches.iter().filter(|found| found.log10_fp < MATCH).count();
    let mut guilty = 0;
    for (Mark { record, codeword, .. }, _) in copies {
        row.colluders += 1;
        row.bounds.push(bound_of(record.id));
        guilty += usize::from(bound_of(record.id) < MATCH);
        let (class, bits) = (codeword.layout_class(), codeword.bit_count());
        let soft = suspect.read(class, bits, record.method.modulation());
        let blind = soft.log10_bound(soft.score(codeword).t) + counted(bench.service.marks());
        row.blind += usize::from(blind < MATCH);
    }
    row.named += guilty;
    row.innocent += named - guilty;
}

async fn run(options: Options, data: &std::path::Path) {
    let bench = Bench::start(data, options.others).await;
    for (name, file) in hosts(options.files) {
        for &method in &options.methods {
            let kind = Kind { method, strength: Some(options.strength), bits: options.bits };
            println!("{name}, {method} {}, {} bits", options.strength.get(), kind.bits.get());
            let mut marked = Vec::new();
            for recipient in 0..options.recipients {
                marked.push(bench.mark(&file, &format!("{name} {recipient}"), kind).await);
            }
            let copies: Vec<(&Mark, Mesh)> =
                marked.iter().map(|mark| (mark, parsed(&mark.bytes))).collect();
            for size in GROUPS {
                let mut row = Row::default();
                for group in copies.chunks_exact(size) {
                    collude(&bench, group, &mut row).await;
                }
                let Row { colluders, named, innocent, blind, mut bounds } = row;
                bounds.sort_unstable_by(f64::total_cmp);
                let (Some(worst), Some(median)) = (bounds.last(), bounds.get(bounds.len() / 2))
                else {
                    continue;
                };
                println!(
                    "  {size:2} copies   named {named:3} of {colluders:3}   others {innocent}   \
                     log10_fp {median:6.1}, worst {worst:6.1}   blind {blind:3}"
                );
            }
        }
    }
}

fn main() {
    let temporary = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(run(options(), &temporary.path().join("data")));
}
