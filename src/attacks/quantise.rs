//! Quantisation of coordinates.

use glam::DVec3;

use super::AttackError;
use crate::mesh::Mesh;

/// Rounds coordinates to `2^bits` levels per axis, with the same spacing on all axes. The levels
/// span the longest side of the bounding box, as in mesh coders. Luo and Bors 2009, fig. 8, and
/// Wang et al. 2010 give bits from 11 down to 7 and do not specify the grid.
///
/// # Errors
/// [`AttackError::Mesh`] when coordinates are so large that the grid is not finite.
pub fn quantise(mesh: &Mesh, bits: u32) -> Result<Mesh, AttackError> {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let extremes = |(low, high): (DVec3, DVec3), p: &DVec3| (low.min(*p), high.max(*p));
    let (low, high) = mesh.positions().iter().fold(start, extremes);
    let levels = f64::from(1_u32.checked_shl(bits).unwrap_or(u32::MAX).max(2));
    let step = (high - low).max_element() / (levels - 1.0);
    // A mesh without extent stays as it is.
    let snapped = |&p: &DVec3| {
        if step > 0.0 { low + ((p - low) / step).round() * step } else { p }
    };
    let positions = mesh.positions().iter().map(snapped).collect();
    Ok(Mesh::new(positions, mesh.triangles().to_vec())?)
}
