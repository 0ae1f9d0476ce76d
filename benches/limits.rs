//! How closely marks use the limit of `max_distortion`, and how often a codeword is refused at
//! first.
//!
//! ```text
//! cargo bench --bench limits -- --keys 10 --bits 32 --method exact-mean [--layers both] [--limits 1e-4]
//!     FILE...
//! ```
//!
//! Without files: five generated meshes. Prints one row per mesh and limit: how many codewords took
//! the fitted strength; how many strengths were refused, in all and of the mark with the most; the
//! mean strength; the mean and the largest MRMS as a share of the limit; seconds per mark; and how
//! many marks have the blind layer. The sums are at the end, with the cost of the refusals in
//! decades of a bound (the charge of the n-th of a series of tries).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a benchmark may stop")]
#![allow(clippy::pedantic)]

use std::path::Path;
use std::time::Instant;

use quadmark::formats::Limits;
use quadmark::marking::{Amplitude, Layers, MarkError, MarkRequest, MaxDistortion, mark_within};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, EmbedParams, MarkKey, Message, Method, Strength, WatermarkError,
};

struct Options {
    keys: u8,
    bits: u32,
    layers: Layers,
    method: Method,
    limits: Vec<f64>,
    hosts: Vec<(String, Vec<u8>)>,
}

fn options() -> Options {
    let mut options = Options {
        keys: 10,
        bits: 64,
        layers: Layers::Blind,
        method: Method::ExactMean,
        limits: vec![3e-5, 6e-5, 1.2e-4],
        hosts: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap_or_default();
        match word.as_str() {
            "--bench" => {}
            "--keys" => options.keys = value().parse().unwrap(),
            "--bits" => options.bits = value().parse().unwrap(),
            "--layers" => options.layers = value().parse().unwrap(),
            "--method" => options.method = value().parse().unwrap(),
            "--limits" => {
                options.limits = value().split(',').map(|x| x.parse().unwrap()).collect();
            }
            file => {
                let name = Path::new(file).file_name().unwrap().to_string_lossy().into_owned();
                options.hosts.push((name, std::fs::read(file).unwrap()));
            }
        }
    }
    if options.hosts.is_empty() {
        let samples = [
            (Sample::Blob, 3_000),
            (Sample::Blob, 9_000),
            (Sample::Gear, 12_000),
            (Sample::Knot, 3_000),
            (Sample::Knot, 9_000),
        ];
        for (sample, vertices) in samples {
            let host = to_obj(&sample.mesh(vertices).unwrap());
            options.hosts.push((format!("{sample} {vertices}"), host));
        }
    }
    options
}

/// Keys and messages that differ between runs of this loop but not between runs of the program.
fn key_and_message(number: u8, bits: BitCount) -> (MarkKey, Message) {
    let key =
        std::array::from_fn(|i| number.wrapping_mul(37).wrapping_add((i as u8).wrapping_mul(11)));
    let bit = |i: usize| (i * i + usize::from(number) * i) % 7 < 3;
    (MarkKey::from_bytes(key), Message::from_bits((0..bits.get()).map(bit).collect()).unwrap())
}

/// Decades that the n-th of a series of tries costs (`service::verify::charge`).
fn decades(refused: u32) -> f64 {
    let n = f64::from(refused) + 1.0;
    if n < 2.0 {
        (4.0_f64 / 3.0).log10()
    } else {
        (4.0 * n.log2() * (n + 1.0).log2() / (1.0 + 1.0 / n).log2()).log10()
    }
}

#[derive(Default)]
struct Sum {
    marks: u32,
    at_once: u32,
    refused: u32,
    most: u32,
    unable: u32,
    blind: u32,
    most_used: f64,
    strength: f64,
    used: f64,
    decades: f64,
    seconds: f64,
}

impl Sum {
    fn add(&mut self, other: &Self) {
        self.marks += other.marks;
        self.at_once += other.at_once;
        self.refused += other.refused;
        self.most = self.most.max(other.most);
        self.unable += other.unable;
        self.blind += other.blind;
        self.most_used = self.most_used.max(other.most_used);
        self.strength += other.strength;
        self.used += other.used;
        self.decades += other.decades;
        self.seconds += other.seconds;
    }

    fn print(&self, name: &str, limit: &str) {
        let mean = |sum: f64| sum / f64::from(self.marks.max(1));
        println!(
            "{name:24} {limit:>8} {:>5} {:>5} {:>7} {:>7} {:>4} {:>6} {:>8.4} {:>5.2} {:>5.2} {:>7.2} {:>6.2}",
            self.marks,
            self.blind,
            self.at_once,
            self.refused,
            self.most,
            self.unable,
            mean(self.strength),
            mean(self.used),
            self.most_used,
            mean(self.decades),
            mean(self.seconds),
        );
    }
}

fn measure(host: &[u8], limit: f64, options: &Options) -> Sum {
    let bits = BitCount::new(options.bits).unwrap();
    let mut sum = Sum::default();
    for number in 0..options.keys {
        let (key, message) = key_and_message(number, bits);
        let request = MarkRequest {
            key: &key,
            others: &[],
            message: &message,
            params: EmbedParams { method: options.method, bits, ..EmbedParams::default() },
            limits: Limits::default(),
            stop: &|| false,
            layers: options.layers,
            amplitude: Amplitude::default(),
            independent_check_max_bytes: 0,
        };
        let limit = MaxDistortion::new(limit).unwrap();
        let began = Instant::now();
        // As in the service when a relief is requested.
        let most =
            if options.layers.has_relief() { Strength::BESIDE_A_RELIEF } else { Strength::MAX };
        match mark_within(host, &request, limit, most) {
            Ok(marked) => {
                let report = marked.report;
                assert!(report.quality.mrms <= limit.get());
                sum.marks += 1;
                sum.at_once += u32::from(report.refused == 0);
                sum.refused += report.refused;
                sum.most = sum.most.max(report.refused);
                sum.blind += u32::from(report.layers.has_blind());
                sum.strength += report.strength.get();
                sum.most_used = sum.most_used.max(report.quality.mrms / limit.get());
                sum.used += report.quality.mrms / limit.get();
                sum.decades += decades(report.refused);
                sum.seconds += began.elapsed().as_secs_f64();
            }
            Err(
                MarkError::DistortionUnreachable { .. }
                | MarkError::Watermark(WatermarkError::InsufficientCapacity { .. }),
            ) => sum.unable += 1,
            Err(error) => panic!("{error}"),
        }
    }
    sum
}

fn main() {
    let options = options();
    println!(
        "{:24} {:>8} {:>5} {:>5} {:>7} {:>7} {:>4} {:>6} {:>8} {:>5} {:>5} {:>7} {:>6}",
        "mesh",
        "limit",
        "marks",
        "blind",
        "at once",
        "refused",
        "most",
        "unable",
        "strength",
        "used",
        "most",
        "decades",
        "s"
    );
    let mut all = Sum::default();
    for (name, host) in &options.hosts {
        for &limit in &options.limits {
            let sum = measure(host, limit, &options);
            sum.print(name, &format!("{limit:.1e}"));
            all.add(&sum);
        }
    }
    all.print("all", "");
}
