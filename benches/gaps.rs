//! Why some of our results differ from those of Luo and Bors 2009: what subdivision, strong
//! simplification, coarse grids and noise leave of a mark, by how it was made and by the frame in
//! which it is read.
//!
//! ```sh
//! cargo bench --bench gaps -- FILE... [--keys N]
//! ```
//!
//! Per line: the share of bits read right in the suspect's own frame (blind), about its own centre
//! with the host's range of norms, about the host's centre with its own range, and in the host's
//! frame. Then, in bins: how far the centre moved and how much the range of norms shrank.

#![expect(clippy::expect_used, reason = "a benchmark may stop")]

use quadmark::attacks::random::Random;
use quadmark::attacks::re_mark::{key_and_message, mark};
use quadmark::attacks::{Attack, Context, Target};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::watermark::{Codeword, EmbedParams, Frame, Method, Strength, Suspect};

fn main() {
    let mut keys = 4;
    let mut files = Vec::new();
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--keys" => keys = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(keys),
            _ => files.push(argument),
        }
    }
    for file in files {
        let bytes = std::fs::read(&file).expect("a file that can be read");
        let limits = Limits { max_bytes: usize::MAX, ..Limits::default() };
        let host = Asset::read(&bytes, &limits).expect("a mesh").into_mesh();
        println!("{file}");
        for method in [Method::QspMean, Method::QspVar, Method::ChoMean, Method::ChoVar] {
            for closed_loop in [true, false] {
                let strength = Strength::new(0.1).expect("the paper's strength");
                let params =
                    EmbedParams { method, strength, closed_loop, ..EmbedParams::default() };
                measure(&host, &params, keys);
            }
        }
    }
}

/// An attack, how often it is applied, and its name.
const ATTACKS: [(Attack, usize, &str); 9] = [
    (Attack::None, 1, "nothing"),
    (Attack::Midpoint, 1, "midpoint"),
    (Attack::Butterfly, 1, "butterfly"),
    (Attack::Quantise(8), 1, "8 bits"),
    (Attack::Noise(0.004), 1, "noise 0.4 %"),
    (Attack::Loop, 1, "Loop"),
    (Attack::Loop, 2, "Loop twice"),
    (Attack::Smooth { lambda: 0.5, iterations: 3 }, 1, "smoothed thrice"),
    (Attack::Simplify(0.9), 1, "simplified by 90 %"),
];

fn measure(host: &Mesh, params: &EmbedParams, keys: u64) {
    let frame = Suspect::new(host).expect("a surface").frame();
    let mut sums = [[0.0; 6]; ATTACKS.len()];
    for seed in 1..=keys {
        let (key, message) = key_and_message(params, &mut Random::new(seed)).expect("a message");
        let codeword = Codeword::new(&key, &message);
        let made = mark(host, &codeword, params).expect("a mesh that can be marked");
        let marked = Mesh::new(made.positions, host.triangles().to_vec()).expect("a mesh");
        let context = Context { host, params, amplitude: None };
        for ((attack, times, _), sums) in ATTACKS.iter().zip(&mut sums) {
            let mut mesh = marked.clone();
            for _ in 0..*times {
                mesh = attack.apply(&Target::new(&mesh), &context, seed).expect("a mesh");
            }
            for (sum, value) in sums.iter_mut().zip(seen(&mesh, &codeword, params, frame)) {
                *sum += value;
            }
        }
    }
    let how = if params.closed_loop { "closed loop" } else { "single pass" };
    for ((_, _, name), sums) in ATTACKS.iter().zip(sums) {
        let [blind, range, centre, host, moved, shrunk] = sums.map(|sum| sum / keys as f64);
        println!(
            "{:9} {how:11} {name:18} blind {blind:.3}, host's range {range:.3}, host's centre \
             {centre:.3}, host's frame {host:.3}; centre {moved:+.2} bins, range {shrunk:+.2} bins",
            params.method.name()
        );
    }
}

fn seen(mesh: &Mesh, codeword: &Codeword, params: &EmbedParams, host: Frame) -> [f64; 6] {
    let suspect = Suspect::new(mesh).expect("a surface");
    let own = suspect.frame();
    let about_own = Frame { centre: own.centre, ..host };
    // The range of its norms about the host's centre.
    let norms: Vec<f64> =
        suspect.surface().positions.iter().map(|p| p.distance(host.centre)).collect();
    let about_host = Frame::spanning(host.centre, &norms);
    let ratio = |frame: &Frame| {
        let modulation = params.method.modulation();
        let read = suspect.read_in(frame, codeword.layout_class(), params.bits, modulation);
        read.score(codeword).bits_agreeing as f64 / params.bits.get() as f64
    };
    let bin = (host.rho_max - host.rho_min) / params.bits.get() as f64;
    [
        ratio(&own),
        ratio(&about_own),
        ratio(&about_host),
        ratio(&host),
        own.centre.distance(host.centre) / bin,
        ((host.rho_max - host.rho_min) - (own.rho_max - own.rho_min)) / bin,
    ]
}
