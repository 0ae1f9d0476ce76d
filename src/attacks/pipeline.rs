//! Sequences of attacks, drawn at random.

use super::crop::Of;
use super::{Attack, AttackError, Context, Target};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Number of attacks in a pipeline.
pub const STEPS: usize = 3;

/// The attacks that pipelines are drawn from. Each family is equally likely, and within a family
/// each strength. All of them need nothing but the mesh.
const FAMILIES: [&[Attack]; 11] = [
    &[Attack::Noise(0.001), Attack::Noise(0.003), Attack::Noise(0.005)],
    &[Attack::Quantise(10), Attack::Quantise(8)],
    &[
        Attack::Smooth { lambda: 0.5, iterations: 5 },
        Attack::Smooth { lambda: 0.5, iterations: 20 },
    ],
    &[Attack::Taubin(50)],
    &[Attack::Cotangent { lambda: 0.5, iterations: 10 }],
    &[Attack::Simplify(0.75), Attack::Simplify(0.9), Attack::Simplify(0.95)],
    &[Attack::Remesh(1.0), Attack::Remesh(0.5), Attack::Remesh(0.25)],
    &[Attack::Voxel(0.005), Attack::Voxel(0.01)],
    &[Attack::Scan(0.0005)],
    &[Attack::Crop(0.3, Of::Vertices), Attack::Crop(0.5, Of::Vertices)],
    &[Attack::Fragment(0.1), Attack::Fragment(0.05), Attack::Fragment(0.02)],
];

/// The attacks of pipeline `number`, in order. They are of three different families.
#[must_use]
pub fn steps(number: u32) -> [Attack; STEPS] {
    let mut random = Random::derived(u64::from(number), [u64::from_le_bytes(*b"pipeline"), 0, 0]);
    let mut families = FAMILIES;
    random.shuffle(&mut families);
    std::array::from_fn(|k| families[k][random.below(families[k].len())])
}

/// Applies the [`steps`] of pipeline `number`.
///
/// # Errors
/// Those of the steps.
pub fn pipeline(
    target: &Target<'_>,
    context: &Context<'_>,
    number: u32,
    seed: u64,
) -> Result<Mesh, AttackError> {
    in_a_row(&steps(number), target, context, seed)
}

/// Applies attacks one after the other.
///
/// # Errors
/// Those of the attacks.
pub fn in_a_row(
    steps: &[Attack],
    target: &Target<'_>,
    context: &Context<'_>,
    seed: u64,
) -> Result<Mesh, AttackError> {
    let mut random = Random::new(seed);
    let Some((first, rest)) = steps.split_first() else { return Ok(target.mesh().clone()) };
    let mut now = first.apply(target, context, random.word())?;
    for step in rest {
        target.go_on()?;
        now = step.apply(&target.same_stop(&now), context, random.word())?;
    }
    Ok(now)
}
