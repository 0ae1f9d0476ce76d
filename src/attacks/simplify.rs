//! Quadric simplification.

use super::{AttackError, Target, compacted, share_of};
use crate::mesh::Mesh;
use glam::DVec3;

/// Removes `share` of the triangles by edge collapses in the order of their quadric error, with
/// optimal positions for the vertices that stay (Garland and Heckbert, *Surface simplification
/// using quadric error metrics*, SIGGRAPH 1997, the paper's reference 17; here by the meshoptimizer
/// library). Luo and Bors 2009, fig. 7: 0.05 to 0.95; Wang et al. 2010: 0.1 to 0.975.
///
/// The library works in single precision on the mesh scaled to a diagonal of 1. It keeps the
/// topology, and stops short of the share where the topology allows no more.
///
/// # Errors
/// [`AttackError::NoSurface`]; [`AttackError::Mesh`] when nothing is left.
pub fn simplify(target: &Target<'_>, share: f64) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let (centre, scale) = (surface.centre(), surface.diagonal());
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is meant")]
    let single = |p: &DVec3| ((p - centre) / scale).to_array().map(|x| x as f32);
    let mut positions: Vec<[f32; 3]> = surface.positions.iter().map(single).collect();
    let mut indices: Vec<u32> = surface.triangles.iter().flatten().copied().collect();
    let goal = 3 * share_of(surface.triangles.len(), 1.0 - share);
    let kept = meshopt::simplify_with_update(
        &mut indices,
        &mut positions,
        &mut [],
        &[],
        0,
        None,
        goal,
        f32::MAX,
        meshopt::SimplifyOptions::None,
        None,
    );
    indices.truncate(kept);
    let (triangles, _) = indices.as_chunks::<3>();
    let double = |p: &[f32; 3]| centre + scale * DVec3::from_array(p.map(f64::from));
    let positions: Vec<DVec3> = positions.iter().map(double).collect();
    compacted(&positions, triangles.to_vec())
}
