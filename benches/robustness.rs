//! What the blind reader still reads after noise and quantisation, as in the paper.
//!
//! ```text
//! cargo bench --bench robustness -- FILE...
//! ```
//!
//! Per mesh and attack, over ten keys and messages (`qsp-mean`, strength 0.1, 64 bits): the share
//! of wrong bits, the mean and the worst `log10` of the false-positive bound for one record, and
//! how many of the ten are a match (a bound below -9). Without files: a generated mesh.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use glam::DVec3;
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, EmbedParams, MarkKey, Message, Method, Modulation, Strength, Suspect,
    WatermarkError,
};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const RUNS: u8 = 10;
const THRESHOLD: f64 = -9.0;

/// Uniform in [-1, 1).
fn uniform(random: &mut ChaCha20Rng) -> f64 {
    f64::from(random.next_u32()) / f64::from(1_u32 << 31) - 1.0
}

fn moved(mesh: &Mesh, new: impl FnMut(&DVec3) -> DVec3) -> Mesh {
    Mesh::new(mesh.positions().iter().map(new).collect(), mesh.triangles().to_vec()).unwrap()
}

/// The paper's eq. 23: moves each vertex by `share` of the largest distance from the centre, in a
/// random direction.
fn noise(mesh: &Mesh, share: f64, random: &mut ChaCha20Rng) -> Mesh {
    let count = mesh.positions().len() as f64;
    let middle = mesh.positions().iter().sum::<DVec3>() / count;
    let size = mesh.positions().iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
    moved(mesh, |p| {
        let mut direction = DVec3::splat(2.0);
        while direction.length() > 1.0 {
            direction = DVec3::from_array(std::array::from_fn(|_| uniform(random)));
        }
        p + share * size * direction.normalize()
    })
}

/// Rounds coordinates to `2^bits` levels over the longest side of the bounding box.
fn quantised(mesh: &Mesh, bits: i32) -> Mesh {
    let low = mesh.positions().iter().copied().reduce(DVec3::min).unwrap();
    let high = mesh.positions().iter().copied().reduce(DVec3::max).unwrap();
    let step = (high - low).max_element() / (2_f64.powi(bits) - 1.0);
    moved(mesh, |&p| low + ((p - low) / step).round() * step)
}

type Attack = (&'static str, fn(&Mesh, &mut ChaCha20Rng) -> Mesh);

const ATTACKS: [Attack; 10] = [
    ("none", |mesh, _| mesh.clone()),
    ("noise 0.05 %", |mesh, random| noise(mesh, 5e-4, random)),
    ("noise 0.1 %", |mesh, random| noise(mesh, 1e-3, random)),
    ("noise 0.3 %", |mesh, random| noise(mesh, 3e-3, random)),
    ("noise 0.5 %", |mesh, random| noise(mesh, 5e-3, random)),
    ("quantised to 12 bits", |mesh, _| quantised(mesh, 12)),
    ("quantised to 11 bits", |mesh, _| quantised(mesh, 11)),
    ("quantised to 10 bits", |mesh, _| quantised(mesh, 10)),
    ("quantised to 9 bits", |mesh, _| quantised(mesh, 9)),
    ("quantised to 8 bits", |mesh, _| quantised(mesh, 8)),
];

/// Wrong bits, bits read, and the bound.
fn detect(suspect: &Mesh, codeword: &Codeword) -> Result<(usize, usize, f64), WatermarkError> {
    let bits = codeword.bit_count();
    let soft = Suspect::new(suspect)?.read(codeword.layout_class(), bits, Modulation::Mean);
    let score = soft.score(codeword);
    Ok((score.bits_read - score.bits_agreeing, score.bits_read, soft.log10_bound(score.t)))
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let mut hosts: Vec<(String, Vec<u8>)> =
        files.into_iter().map(|name| (name.clone(), std::fs::read(name).unwrap())).collect();
    if hosts.is_empty() {
        hosts.push(("a generated knot".into(), to_obj(&Sample::Knot.mesh(40_000).unwrap())));
    }
    let limits = Limits::default();
    for (name, host) in hosts {
        println!("{name}");
        let marked: Vec<(Mesh, Codeword)> = (0..RUNS)
            .map(|run| {
                let key = MarkKey::from_bytes([run; 32]);
                let message =
                    Message::from_bytes(&[run.wrapping_mul(151); 8], BitCount::default()).unwrap();
                let request = MarkRequest {
                    key: &key,
                    others: &[],
                    message: &message,
                    params: EmbedParams {
                        method: Method::QspMean,
                        strength: Strength::new(0.1).unwrap(),
                        ..EmbedParams::default()
                    },
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
        for (attack, apply) in ATTACKS {
            let mut random = ChaCha20Rng::from_seed([1; 32]);
            let (mut wrong, mut read, mut matches) = (0_usize, 0_usize, 0);
            let (mut sum, mut worst) = (0.0, -300.0);
            for (mesh, codeword) in &marked {
                let (w, r, bound) = detect(&apply(mesh, &mut random), codeword).unwrap();
                (wrong, read, sum) = (wrong + w, read + r, sum + bound);
                worst = f64::max(worst, bound);
                matches += u32::from(bound < THRESHOLD);
            }
            let share = 100.0 * wrong as f64 / read.max(1) as f64;
            println!(
                "  {attack:22} wrong {share:5.1} %  log10 bound mean {:6.1} worst {worst:6.1}  \
                 {matches} of {RUNS} match",
                sum / f64::from(RUNS),
            );
        }
    }
}
