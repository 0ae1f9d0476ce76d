//! Additive noise at every point, in the two forms of the literature.

use glam::DVec3;

use super::{AttackError, Target, with_carriers_at};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Moves every point by `share` of the largest distance from the centre, in a random direction:
/// `v + e |v_max| p` with `p` a random unit vector (Luo and Bors 2009, eq. 23; there e is 0.001 to
/// 0.01). The centre is the area-weighted one of the paper's eq. 3.
///
/// # Errors
/// [`AttackError::NoSurface`].
pub fn unit_vectors(target: &Target<'_>, share: f64, seed: u64) -> Result<Mesh, AttackError> {
    let mut random = Random::new(seed);
    moved(target, |norms| share * norms.fold(0.0, f64::max), |size| size * random.direction())
}

/// Moves every coordinate by `amplitude` times the mean distance from the centre times a number
/// uniform in [-1, 1) (Wang, Lavoué, Denis, Baskurt and He, *A benchmark for 3D mesh watermarking*,
/// SMI 2010; there the amplitude is 0.0005 to 0.005).
///
/// # Errors
/// [`AttackError::NoSurface`].
pub fn uniform_coordinates(
    target: &Target<'_>,
    amplitude: f64,
    seed: u64,
) -> Result<Mesh, AttackError> {
    let mut random = Random::new(seed);
    let mean = |norms: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = norms.fold((0.0, 0.0), |(sum, count), norm| (sum + norm, count + 1.0));
        amplitude * sum / count
    };
    moved(target, mean, |size| {
        size * DVec3::from_array(std::array::from_fn(|_| random.symmetric()))
    })
}

fn moved(
    target: &Target<'_>,
    size: impl FnOnce(&mut dyn Iterator<Item = f64>) -> f64,
    mut step: impl FnMut(f64) -> DVec3,
) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let centre = surface.centre();
    let size = size(&mut surface.positions.iter().map(|v| v.distance(centre)));
    let positions: Vec<DVec3> = surface.positions.iter().map(|&v| v + step(size)).collect();
    with_carriers_at(target, &positions)
}
