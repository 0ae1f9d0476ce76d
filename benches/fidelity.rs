//! The cost of a mark: distortion of every method on given meshes, closed loop, averaged over keys.
//!
//! ```text
//! cargo bench --bench fidelity -- --keys 10 --strength 0.1 FILE...
//! ```
//!
//! Prints one row per mesh and method (MRMS and Hausdorff distance as Metro samples them, in
//! percent of the bounding-box diagonal; triangles turned by more than 90 degrees; smallest
//! margin; rounds) and, at the end, the ratios of the `exact` methods to their `qsp` twins.

#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "a benchmark may stop")]
#![allow(clippy::pedantic)]

use std::path::Path;

use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::mesh::distortion::distortion;
use quadmark::mesh::surface::Surface;
use quadmark::mesh::turning::flipped_triangles;
use quadmark::sample::Sample;
use quadmark::watermark::{Codeword, EmbedParams, Host, MarkKey, Message, Method, Strength, embed};

#[derive(Clone, Copy, Default)]
struct Row {
    mrms: f64,
    hausdorff: f64,
    flipped: f64,
    margin: f64,
    rounds: f64,
    usable: f64,
    refused: u32,
}

struct Options {
    keys: u8,
    strength: f64,
    samples: usize,
    methods: Vec<Method>,
    files: Vec<String>,
}

fn options() -> Options {
    let mut options = Options {
        keys: 3,
        strength: 0.1,
        samples: 300_000,
        methods: Method::ALL.to_vec(),
        files: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap_or_default();
        match word.as_str() {
            "--bench" => {}
            "--keys" => options.keys = value().parse().unwrap(),
            "--strength" => options.strength = value().parse().unwrap(),
            "--samples" => options.samples = value().parse().unwrap(),
            "--methods" => {
                options.methods = value().split(',').map(|name| name.parse().unwrap()).collect();
            }
            file => options.files.push(file.to_owned()),
        }
    }
    options
}

/// Keys and messages that differ between runs of this loop but not between runs of the program.
fn key_and_message(number: u8) -> (MarkKey, Message) {
    let key = std::array::from_fn(|i| number.wrapping_mul(37).wrapping_add(i as u8 * 11));
    let seed = u64::from(number).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d;
    let message = Message::from_bytes(&seed.to_be_bytes(), Default::default()).unwrap();
    (MarkKey::from_bytes(key), message)
}

#[allow(clippy::cast_possible_truncation)]
fn measure(mesh: &Mesh, method: Method, options: &Options) -> Row {
    let surface = Surface::new(mesh);
    let to_single = |positions: &mut [glam::DVec3]| {
        for p in positions {
            *p = glam::DVec3::from_array(p.to_array().map(|x| f64::from(x as f32)));
        }
    };
    let host = Host { mesh, surface: &surface, pinned: &[], round: &to_single, original: None };
    let strength = Strength::new(options.strength).unwrap();
    let params = EmbedParams { method, strength, ..EmbedParams::default() };
    let mut row = Row::default();
    let mut done = 0.0;
    for number in 0..options.keys {
        let (key, message) = key_and_message(number);
        let result = embed(host, &Codeword::new(&key, &message), &params, &|| false);
        let Ok(marked) = result else {
            row.refused += 1;
            continue;
        };
        let carriers: Vec<_> =
            surface.first_vertex.iter().map(|&v| marked.positions[v as usize]).collect();
        row.flipped += flipped_triangles(&surface, &carriers).len() as f64;
        let moved = Surface { positions: carriers, ..surface.clone() };
        let measured = distortion(&surface, &moved, options.samples).unwrap();
        row.mrms += 100.0 * measured.mrms / measured.diagonal;
        row.hausdorff += 100.0 * measured.hausdorff / measured.diagonal;
        row.margin += marked.smallest_margin;
        row.rounds += marked.rounds as f64;
        row.usable += marked.usable_bins as f64;
        done += 1.0;
    }
    for sum in [
        &mut row.mrms,
        &mut row.hausdorff,
        &mut row.flipped,
        &mut row.margin,
        &mut row.rounds,
        &mut row.usable,
    ] {
        *sum /= done;
    }
    row
}

fn meshes(files: &[String]) -> Vec<(String, Mesh)> {
    if files.is_empty() {
        let generated = Sample::ALL.map(|s| (s.to_string(), s.mesh(30_000).unwrap()));
        return generated.into();
    }
    let read = |file: &String| {
        let asset = Asset::read(&std::fs::read(file).unwrap(), &Limits::default()).unwrap();
        let name = Path::new(file).file_stem().unwrap().to_string_lossy().into_owned();
        (name, asset.into_mesh())
    };
    files.iter().map(read).collect()
}

fn main() {
    let options = options();
    let mut ratios: Vec<(String, Method, f64, f64)> = Vec::new();
    println!(
        "mesh                     method      mrms %   hausd %  flipped  margin rounds bins refused"
    );
    for (name, mesh) in meshes(&options.files) {
        let mut rows = Vec::new();
        for &method in &options.methods {
            let row = measure(&mesh, method, &options);
            println!(
                "{name:24} {method:10} {:8.5} {:8.4} {:8.1} {:8.4} {:5.1} {:5.1} {}",
                row.mrms,
                row.hausdorff,
                row.flipped,
                row.margin,
                row.rounds,
                row.usable,
                row.refused
            );
            rows.push((method, row));
        }
        let of = |method| rows.iter().find(|(m, _)| *m == method).map(|(_, row)| *row);
        for (exact, qsp) in
            [(Method::ExactMean, Method::QspMean), (Method::ExactVar, Method::QspVar)]
        {
            if let (Some(a), Some(b)) = (of(exact), of(qsp)) {
                ratios.push((name.clone(), exact, a.mrms / b.mrms, a.hausdorff / b.hausdorff));
            }
        }
    }
    for method in [Method::ExactMean, Method::ExactVar] {
        let of = || ratios.iter().filter(|(_, m, ..)| *m == method);
        let count = of().count() as f64;
        if count == 0.0 {
            continue;
        }
        for (name, _, mrms, hausdorff) in of() {
            println!("{name:24} {method:10} mrms x {mrms:.3}  hausdorff x {hausdorff:.3}");
        }
        let mean =
            |pick: fn(&(String, Method, f64, f64)) -> f64| of().map(pick).sum::<f64>() / count;
        println!(
            "{method} over its qsp twin, mean of {count} meshes: mrms x {:.3}, hausdorff x {:.3}",
            mean(|r| r.2),
            mean(|r| r.3)
        );
    }
}
