//! Stray vertices and spikes. They are hardly visible, but the radial range of a blind reader
//! depends on extremes.

use glam::DVec3;

use super::{AttackError, Target, with_carriers_at};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Adds `count` vertices that no triangle uses, up to one diagonal outside the bounding box. The
/// Stanford bunny has 1,113 such vertices; a reader that takes its range from them fails.
///
/// # Errors
/// None in practice: the result is a valid mesh.
pub fn stray_vertices(target: &Target<'_>, count: usize, seed: u64) -> Result<Mesh, AttackError> {
    let (mesh, surface) = (target.mesh(), target.welded()?);
    let (centre, reach) = (surface.centre(), 1.5 * surface.diagonal());
    let mut random = Random::new(seed);
    let mut positions = mesh.positions().to_vec();
    positions.extend((0..count).map(|_| {
        let away = reach * (0.2 + 0.8 * random.share());
        centre + away * random.direction()
    }));
    Ok(Mesh::new(positions, mesh.triangles().to_vec())?)
}

/// Moves `count` random points away from the centre by `height` of their distance. With the
/// farthest point moved out by 0.01, the blind reader of a Stanford bunny read 59 % of the bits
/// wrong (docs/method.md, section 7). The first spike is therefore always that point.
///
/// # Errors
/// [`AttackError::NoSurface`].
pub fn spikes(
    target: &Target<'_>,
    count: usize,
    height: f64,
    seed: u64,
) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let centre = surface.centre();
    let mut random = Random::new(seed);
    let mut positions = surface.positions.clone();
    let norm = |v: &DVec3| v.distance_squared(centre);
    let farthest = (0..positions.len())
        .max_by(|&a, &b| norm(&positions[a]).total_cmp(&norm(&positions[b])))
        .unwrap_or(0);
    for spike in 0..count {
        let vertex = if spike == 0 { farthest } else { random.below(positions.len()) };
        let base = surface.positions[vertex];
        positions[vertex] = base + height * (base - centre);
    }
    with_carriers_at(target, &positions)
}
