//! One mark over the other: a marked file is marked again. Are all its marks still found?
//!
//! ```text
//! cargo bench --bench overmark -- [--methods exact-mean,qsp-mean] [--bits 64] [--over METHOD] [--runs 6] [--deep 3] FILE...
//! ```
//!
//! Per mesh, each run marks a file `deep` times over (strength 0.15, each time another key
//! and message, those after the first by the method `over`) and reads every mark from the last file. Per mark, oldest first, and detector: how
//! many of the runs find it (a bound below 1e-9 against 100,000 records), and the median and the
//! worst of log10 of the bounds. The matched filter has the first host for every mark. Without
//! files: generated meshes of 40,000 vertices.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "support/marks.rs"]
mod marks;

use marks::{Copy, THRESHOLD, bounds, hosts, marked, params, parsed};
use quadmark::marking::MarkError;
use quadmark::watermark::{BitCount, EmbedParams, Method};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;

const DETECTORS: [&str; 3] = ["blind", "known frame", "matched filter"];

/// The file marked by each of these in turn, each over the one before.
fn layers(
    file: &[u8],
    all: &[EmbedParams],
    random: &mut ChaCha20Rng,
) -> Result<Vec<Copy>, MarkError> {
    let mut copies: Vec<Copy> = Vec::new();
    for params in all {
        let under = copies.last().map_or(file, |copy| &copy.bytes);
        let over = marked(under, *params, random)?;
        copies.push(over);
    }
    Ok(copies)
}

fn main() {
    let mut methods = vec![Method::ExactMean, Method::QspMean];
    let (mut files, mut runs, mut deep) = (Vec::new(), 6, 2);
    let mut over: Option<Method> = None;
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
            "--over" => over = Some(words.next().unwrap().parse().unwrap()),
            "--runs" => runs = words.next().unwrap().parse().unwrap(),
            "--deep" => deep = words.next().unwrap().parse().unwrap(),
            _ => files.push(word),
        }
    }
    let mut random = ChaCha20Rng::from_seed([2; 32]);
    for (name, file) in hosts(files) {
        let host = parsed(&file);
        for &method in &methods {
            println!("{name} {method}, {} bits", bits.get());
            let methods_of = |first| {
                let rest = std::iter::repeat_n(over.unwrap_or(first), deep - 1);
                let all = std::iter::once(first).chain(rest);
                all.map(|method| params(method, bits)).collect::<Vec<EmbedParams>>()
            };
            let mut found = vec![<[Vec<f64>; 3]>::default(); deep];
            for _ in 0..runs {
                let copies = layers(&file, &methods_of(method), &mut random);
                let copies: Vec<Copy> = match copies {
                    Ok(copies) => copies,
                    Err(refusal) => {
                        println!("  refused: {refusal}");
                        continue;
                    }
                };
                let suspect = &copies[deep - 1].mesh;
                for (copy, found) in copies.iter().zip(&mut found) {
                    let bounds = bounds(suspect, copy, &host);
                    found.iter_mut().zip(bounds).for_each(|(all, bound)| all.push(bound));
                }
            }
            for (mark, found) in (1..).zip(found) {
                print!("  mark {mark} of {deep}");
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
