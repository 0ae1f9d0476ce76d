//! What happens to suspects in the acceptance table of detection: the lab's attacks by name, alone
//! or one after the other.

use quadmark::lab::attacks::Attack::{
    self, Crop, Loop, Midpoint, Noise, Quantise, Remesh, Reorder, RoundTrip, Similarity, Simplify,
    Smooth, Spikes, StrayVertices,
};
use quadmark::lab::attacks::crop::Of::Vertices;
use quadmark::lab::attacks::{AttackError, Context, Target};
use quadmark::lab::random::Random;
use quadmark::mesh::Mesh;

/// Name and steps.
pub type Case = (&'static str, &'static [Attack]);

const fn smoothed(iterations: u32) -> Attack {
    Smooth { lambda: 0.5, iterations }
}

/// All of them. Where nothing is said of a move, the suspect keeps its place; noise, quantisation and
/// smoothing keep the order of the vertices, too.
pub const CASES: &[Case] = &[
    ("none", &[]),
    ("moved", &[Similarity]),
    ("reordered", &[Reorder]),
    ("obj-glb", &[RoundTrip]),
    ("noise-0.1", &[Noise(0.001)]),
    ("noise-0.3", &[Noise(0.003)]),
    ("noise-0.5", &[Noise(0.005)]),
    ("noise-2", &[Noise(0.02)]),
    ("noise-0.5-moved-reordered", &[Noise(0.005), Similarity, Reorder]),
    ("bits-10", &[Quantise(10)]),
    ("bits-8", &[Quantise(8)]),
    ("bits-7", &[Quantise(7)]),
    ("bits-6", &[Quantise(6)]),
    ("bits-5", &[Quantise(5)]),
    ("bits-4", &[Quantise(4)]),
    ("bits-7-moved", &[Quantise(7), Similarity]),
    ("midpoint", &[Midpoint]),
    ("loop", &[Loop]),
    ("simplified-50", &[Simplify(0.5)]),
    ("simplified-75", &[Simplify(0.75)]),
    ("simplified-90", &[Simplify(0.9)]),
    ("simplified-50-moved", &[Simplify(0.5), Similarity]),
    ("smoothed-1", &[smoothed(1)]),
    ("smoothed-10", &[smoothed(10)]),
    ("smoothed-20", &[smoothed(20)]),
    ("smoothed-1-moved", &[smoothed(1), Similarity]),
    ("smoothed-10-moved", &[smoothed(10), Similarity]),
    ("smoothed-20-moved", &[smoothed(20), Similarity]),
    ("spike", &[Spikes { count: 1, height: 0.01 }]),
    ("stray-10", &[StrayVertices(10)]),
    ("crop-10", &[Crop(0.1, Vertices)]),
    ("crop-30", &[Crop(0.3, Vertices)]),
    ("crop-50", &[Crop(0.5, Vertices)]),
    ("crop-80", &[Crop(0.8, Vertices)]),
    ("crop-10-moved", &[Crop(0.1, Vertices), Similarity]),
    ("crop-30-moved", &[Crop(0.3, Vertices), Similarity]),
    ("crop-50-moved", &[Crop(0.5, Vertices), Similarity]),
    ("crop-80-moved", &[Crop(0.8, Vertices), Similarity]),
    ("fragment-5-moved", &[Crop(0.95, Vertices), Similarity]),
    ("crop-50-noise-0.5", &[Crop(0.5, Vertices), Noise(0.005)]),
    ("crop-50-noise-0.5-moved", &[Crop(0.5, Vertices), Noise(0.005), Similarity]),
    ("remeshed", &[Remesh(1.0)]),
    ("remeshed-moved", &[Remesh(1.0), Similarity]),
];

/// What is left of a mesh; the same names, trial and seed give the same.
pub fn attacked(
    mesh: &Mesh,
    context: &Context<'_>,
    (name, steps): Case,
    place: (&str, u64),
    seed: u64,
) -> Result<Mesh, AttackError> {
    let (of, trial) = place;
    let mut random = Random::derived(seed, [hash(of), trial, hash(name)]);
    steps
        .iter()
        .try_fold(mesh.clone(), |now, step| step.apply(&Target::new(&now), context, random.word()))
}

/// FNV-1a.
fn hash(name: &str) -> u64 {
    let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    name.bytes().fold(0xcbf2_9ce4_8422_2325, step)
}
