//! The relief alone (method section 8): its cost, and what is read of it under attacks, in place.
//!
//! ```text
//! cargo bench --bench relief -- [--keys 10] [--amplitude 8.5e-5] [--attacks none,s90,...] FILE...
//! ```
//!
//! Per file and attack: the median and the worst, over the keys, of log10 of the bound for the
//! record's own key, one hypothesis, nothing counted; the largest score of other keys in standard
//! deviations; the median time of a reading as a multiple of the time for preparing the host's
//! surface. Without files: a generated mesh. Averages are of the reliefs of that many keys.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::time::Instant;

use quadmark::attacks::Attack::{self, Crop, Noise, Quantise, Remesh, Simplify, Smooth};
use quadmark::attacks::crop::Of::Vertices;
use quadmark::attacks::{Context, Target, collude};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::mesh::quality::quality_until;
use quadmark::mesh::surface::Surface;
use quadmark::relief::{Amplitude, ReliefHost, ReliefReading, Signs};
use quadmark::sample::Sample;
use quadmark::watermark::{EmbedParams, MarkKey};

/// Name, steps, and the number of copies that are averaged first.
type Case = (&'static str, &'static [Attack], u8);

const CASES: &[Case] = &[
    ("none", &[], 1),
    ("remeshed-100", &[Remesh(1.0)], 1),
    ("remeshed-50", &[Remesh(0.5)], 1),
    ("remeshed-25", &[Remesh(0.25)], 1),
    ("simplified-75", &[Simplify(0.75)], 1),
    ("simplified-90", &[Simplify(0.9)], 1),
    ("simplified-95", &[Simplify(0.95)], 1),
    ("part-5", &[Crop(0.95, Vertices)], 1),
    ("part-2", &[Crop(0.98, Vertices)], 1),
    ("part-5-simplified-75", &[Crop(0.95, Vertices), Simplify(0.75)], 1),
    ("smoothed-20", &[Smooth { lambda: 0.5, iterations: 20 }], 1),
    ("bits-12", &[Quantise(12)], 1),
    ("bits-10", &[Quantise(10)], 1),
    ("bits-8", &[Quantise(8)], 1),
    ("noise-0.05", &[Noise(0.0005)], 1),
    ("noise-0.1", &[Noise(0.001)], 1),
    ("noise-0.5", &[Noise(0.005)], 1),
    ("mean-10", &[], 10),
    ("mean-30", &[], 30),
];

struct Options {
    keys: u8,
    amplitude: f64,
    cases: Vec<Case>,
    files: Vec<String>,
}

fn options() -> Options {
    let amplitude = Amplitude::default().get();
    let mut options = Options { keys: 10, amplitude, cases: CASES.to_vec(), files: Vec::new() };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap();
        match word.as_str() {
            "--bench" => {}
            "--keys" => options.keys = value().parse().unwrap(),
            "--amplitude" => options.amplitude = value().parse().unwrap(),
            "--attacks" => {
                let named = |name: &str| *CASES.iter().find(|case| case.0 == name).unwrap();
                options.cases = value().split(',').map(named).collect();
            }
            _ => options.files.push(word),
        }
    }
    options
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let options = options();
    let generated = || ("knot".to_owned(), Sample::Knot.mesh(12_000).unwrap());
    let read = |path: &String| {
        let name = path.rsplit('/').next().unwrap().to_owned();
        (name, Asset::read(&std::fs::read(path).unwrap(), &Limits::default()).unwrap().into_mesh())
    };
    let meshes: Vec<(String, Mesh)> = if options.files.is_empty() {
        vec![generated()]
    } else {
        options.files.iter().map(read).collect()
    };
    for (name, mesh) in &meshes {
        one(name, mesh, &options);
    }
}

fn one(name: &str, mesh: &Mesh, options: &Options) {
    let start = Instant::now();
    let surface = Surface::new(mesh);
    let unit = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let host = ReliefHost::new(surface.clone()).unwrap();
    let prepared = start.elapsed().as_secs_f64() / unit;
    let field = host.field();
    let signs = |key: u8| Signs::new(&MarkKey::from_bytes([key; 32]), field.signs());
    let mark = |key: u8| {
        let moved = field.marked(&surface, &signs(key), options.amplitude, &[]);
        Mesh::new(moved, surface.triangles.clone()).unwrap()
    };
    let quality = quality_until(&surface, mark(1).positions(), &|| false).unwrap();
    println!(
        "\n{name}: {} vertices, {} cells, MRMS {:.4} %, Hausdorff {:.4} %, normals {:.2} degrees, {} \
         turned; preparing takes {prepared:.1} times as long as the surface\n",
        surface.positions.len(),
        field.signs(),
        100.0 * quality.mrms,
        100.0 * quality.hausdorff,
        quality.normal_deviation_degrees,
        quality.flipped,
    );
    let reading = ReliefReading::new(&host, &surface, &surface.positions, false, 1e-4, &|| false);
    if let Some(reading) = reading {
        let start = Instant::now();
        let of = |id: u32| {
            let mut key = [0x51; 32];
            key[..4].copy_from_slice(&id.to_le_bytes());
            reading.score(&Signs::new(&MarkKey::from_bytes(key), field.signs()))
        };
        let best = (0..10_000).map(of).fold(f64::NEG_INFINITY, f64::max);
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "10,000 keys in {seconds:.2} s, at most {:.1} deviations\n",
            reading.deviations(best)
        );
    }
    println!("| attack | median | worst | others, deviations | time |\n|---|---|---|---|---|");
    let params = EmbedParams::default();
    let plain = Mesh::new(surface.positions.clone(), surface.triangles.clone()).unwrap();
    let context = Context { host: &plain, params: &params, amplitude: None };
    for &(case, steps, copies) in &options.cases {
        let (mut bounds, mut times, mut others) = (Vec::new(), Vec::new(), 0.0_f64);
        for key in 1..=options.keys {
            let all: Vec<Mesh> = (0..copies).map(|k| mark(key.wrapping_add(k))).collect();
            let start = collude::average(&all.iter().collect::<Vec<_>>()).unwrap();
            let step = |(now, seed): (Mesh, u64), attack: &Attack| {
                (attack.apply(&Target::new(&now), &context, seed).unwrap(), seed + 1)
            };
            let suspect = Surface::new(&steps.iter().fold((start, u64::from(key)), step).0);
            let (at, amplitude) = (&suspect.positions, options.amplitude);
            let start = Instant::now();
            let reading = ReliefReading::new(&host, &suspect, at, false, amplitude, &|| false);
            times.push(start.elapsed().as_secs_f64() / unit);
            let Some(reading) = reading else {
                bounds.push(0.0);
                continue;
            };
            bounds.push(reading.log10_bound(reading.score(&signs(key))));
            for other in 200..=255 {
                others = others.max(reading.deviations(reading.score(&signs(other))));
            }
        }
        let worst = bounds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (median_bound, time) = (median(&mut bounds), median(&mut times));
        println!("| {case} | {median_bound:.0} | {worst:.0} | {others:.1} | {time:.1} |");
    }
}
