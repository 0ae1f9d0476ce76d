//! A small piece of the surface.

use glam::DVec3;

use super::{AttackError, Target, compacted, share_of};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Keeps `share` of the triangles, at least one: those whose centroids are nearest to the centroid
/// of a triangle drawn at random. Their coordinates do not change.
///
/// # Errors
/// [`AttackError::NoSurface`].
pub fn fragment(target: &Target<'_>, share: f64, seed: u64) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let centroid =
        |t: &[u32; 3]| t.iter().map(|&v| surface.positions[v as usize]).sum::<DVec3>() / 3.0;
    let triangles = &surface.triangles;
    let from = centroid(&triangles[Random::new(seed).below(triangles.len())]);
    let mut order: Vec<(f64, usize)> = triangles
        .iter()
        .enumerate()
        .map(|(number, t)| (centroid(t).distance_squared(from), number))
        .collect();
    let nearer = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let kept = share_of(triangles.len(), share).clamp(1, triangles.len());
    order.select_nth_unstable_by(kept - 1, nearer);
    let mut numbers: Vec<usize> = order[..kept].iter().map(|&(_, number)| number).collect();
    // In the file's order, as cutting tools keep it.
    numbers.sort_unstable();
    compacted(&surface.positions, numbers.into_iter().map(|number| triangles[number]).collect())
}
