//! Similarity transformations.

use super::{AttackError, Target};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Largest factor of the random scaling. The smallest factor is its inverse.
const MOST_SCALED: f64 = 10.0;

/// Turns by a random rotation, scales evenly by a factor of 0.1 to 10 (uniform in its logarithm)
/// and moves by up to three diagonals along each axis. Every method must read all bits afterwards
/// (Luo and Bors 2009, section 5; Wang et al. 2010).
///
/// # Errors
/// [`AttackError::Mesh`] when coordinates overflow.
pub fn similarity(target: &Target<'_>, seed: u64) -> Result<Mesh, AttackError> {
    let (mesh, surface) = (target.mesh(), target.welded()?);
    let mut random = Random::new(seed);
    let rotation = random.rotation();
    let scale = libm::pow(MOST_SCALED, random.symmetric());
    let reach = 3.0 * surface.diagonal() * scale;
    let shift = glam::DVec3::from_array(std::array::from_fn(|_| reach * random.symmetric()));
    let positions = mesh.positions().iter().map(|&p| rotation * (scale * p) + shift).collect();
    Ok(Mesh::new(positions, mesh.triangles().to_vec())?)
}
