//! Collusion: recipients average their copies. Who is still named?
//!
//! ```text
//! cargo bench --bench collusion -- [--methods exact-mean,qsp-mean] [--bits 64] [--seed 1] FILE...
//! ```
//!
//! Ten copies per mesh, each with a key and message of its own (strength 0.15), averaged in
//! groups of 2, 3, 5 and 10. Per detector: how many of the colluders are named (a bound below 1e-9
//! against 100,000 records), and the median and the worst of log10 of their bounds. Without files:
//! generated meshes of 40,000 vertices.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/marks.rs"]
mod marks;

use glam::DVec3;
use marks::{Copy, THRESHOLD, bounds, hosts, marked, params, parsed};
use quadmark::mesh::Mesh;
use quadmark::watermark::{BitCount, Method};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;

const COPIES: usize = 10;
const GROUPS: [usize; 5] = [1, 2, 3, 5, 10];
const DETECTORS: [&str; 3] = ["blind", "known frame", "matched filter"];

/// Each vertex in the middle of where the copies have it.
fn average(copies: &[Copy]) -> Mesh {
    let count = copies.len() as f64;
    let first = &copies[0].mesh;
    let at = |v: usize| copies.iter().map(|c| c.mesh.positions()[v]).sum::<DVec3>() / count;
    let positions = (0..first.positions().len()).map(at).collect();
    Mesh::new(positions, first.triangles().to_vec()).unwrap()
}

fn main() {
    let mut methods = vec![Method::ExactMean, Method::QspMean];
    let (mut files, mut seed) = (Vec::new(), 1);
    let mut bits = BitCount::default();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--bench" => {}
            "--bits" => bits = marks::bits(&words.next().unwrap()),
            "--methods" => {
                let names = words.next().unwrap();
                methods = names.split(',').map(|name| name.parse().unwrap()).collect();
            }
            "--seed" => seed = words.next().unwrap().parse().unwrap(),
            _ => files.push(word),
        }
    }
    let mut random = ChaCha20Rng::from_seed([seed; 32]);
    for (name, file) in hosts(files) {
        let host = parsed(&file);
        for &method in &methods {
            println!("{name} {method}, {} bits", bits.get());
            let copies = (0..COPIES).map(|_| marked(&file, params(method, bits), &mut random));
            let copies = match copies.collect::<Result<Vec<Copy>, _>>() {
                Ok(copies) => copies,
                Err(refusal) => {
                    println!("  refused: {refusal}");
                    continue;
                }
            };
            for size in GROUPS {
                let mut found: [Vec<f64>; 3] = Default::default();
                for group in copies.chunks_exact(size) {
                    let suspect = average(group);
                    for copy in group {
                        let bounds = bounds(&suspect, copy, &host);
                        found.iter_mut().zip(bounds).for_each(|(all, bound)| all.push(bound));
                    }
                }
                print!("  {size:2} copies");
                for (detector, mut all) in DETECTORS.iter().zip(found) {
                    all.sort_unstable_by(f64::total_cmp);
                    let named = all.iter().filter(|bound| **bound < THRESHOLD).count();
                    let (median, worst) = (all[all.len() / 2], all[all.len() - 1]);
                    let of = all.len();
                    print!("   {detector} {named:2}/{of:2} ({median:6.1}, {worst:6.1})");
                }
                println!();
            }
        }
    }
}
