//! Cutting a part away by a plane.

use glam::DVec3;

use super::{AttackError, Target, compacted, share_of};
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::surface::{Surface, doubled_area};

/// The quantity of which a share is cut away.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    /// The vertices (Wang et al. 2010: 0.1, 0.3, 0.5).
    Vertices,
    /// The area.
    Area,
}

/// Cuts away `share` of the vertices or of the area, beyond a plane perpendicular to a random
/// direction. Triangles are not cut: [`Of::Vertices`] removes triangles with a vertex beyond the
/// plane, [`Of::Area`] those with their centroid beyond it. The remaining coordinates do not
/// change.
///
/// # Errors
/// [`AttackError::NoSurface`]; [`AttackError::Mesh`] when no triangle is left.
pub fn crop(target: &Target<'_>, share: f64, of: Of, seed: u64) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let normal = Random::new(seed).direction();
    let triangles = match of {
        Of::Vertices => within_vertices(surface, share, normal),
        Of::Area => within_area(surface, share, normal),
    };
    compacted(&surface.positions, triangles)
}

fn within_vertices(surface: &Surface, share: f64, normal: DVec3) -> Vec<[u32; 3]> {
    let heights: Vec<f64> = surface.positions.iter().map(|v| v.dot(normal)).collect();
    let mut sorted = heights.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let kept = sorted.len() - share_of(sorted.len(), share);
    let Some(&highest) = sorted.get(kept.wrapping_sub(1)) else { return Vec::new() };
    let inside = |t: &&[u32; 3]| t.iter().all(|&v| heights[v as usize] <= highest);
    surface.triangles.iter().filter(inside).copied().collect()
}

fn within_area(surface: &Surface, share: f64, normal: DVec3) -> Vec<[u32; 3]> {
    let corners = |t: &[u32; 3]| t.map(|v| surface.positions[v as usize]);
    let mut order: Vec<(f64, [u32; 3])> = surface
        .triangles
        .iter()
        .map(|t| (corners(t).iter().sum::<DVec3>().dot(normal), *t))
        .collect();
    // A stable sort: triangles at the same height keep their order.
    order.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let area = |t: &[u32; 3]| {
        let [a, b, c] = corners(t);
        doubled_area(a, b, c).length()
    };
    let total: f64 = order.iter().map(|(_, t)| area(t)).sum();
    let mut passed = 0.0;
    let below = |(_, t): &(f64, [u32; 3])| {
        passed += area(t);
        (passed <= (1.0 - share) * total * (1.0 + 1e-12)).then_some(*t)
    };
    order.iter().map_while(below).collect()
}
