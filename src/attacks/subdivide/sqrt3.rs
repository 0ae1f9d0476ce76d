//! Kobbelt's sqrt(3) scheme.

use std::f64::consts::TAU;

use glam::DVec3;

use super::super::{AttackError, Target, index};
use super::{Ring, rings};
use crate::mesh::Mesh;

/// Inserts a vertex in the middle of each triangle, flips the old edges and smooths the old
/// vertices. There are three times as many triangles, and no old edge remains (L. Kobbelt,
/// *sqrt(3)-subdivision*, SIGGRAPH 2000). Borders stay as they are, as in the first of Kobbelt's
/// double steps.
///
/// # Errors
/// As [`midpoint`](super::midpoint).
pub fn sqrt3(target: &Target<'_>) -> Result<Mesh, AttackError> {
    let (surface, edges) = (target.surface()?, target.edges()?);
    let smoothed = |(&v, [inner, border]): (&DVec3, &[Ring; 2])| {
        if border.count > 0 {
            return v;
        }
        let n = f64::from(inner.count);
        let alpha = (4.0 - 2.0 * libm::cos(TAU / n)) / 9.0;
        (1.0 - alpha) * v + alpha * inner.sum / n
    };
    let mut positions: Vec<DVec3> =
        surface.positions.iter().zip(&rings(surface, edges)).map(smoothed).collect();
    let first = positions.len();
    let at = |v: u32| surface.positions[v as usize];
    positions.extend(surface.triangles.iter().map(|&[a, b, c]| (at(a) + at(b) + at(c)) / 3.0));

    let middle_of = |side: usize| index(first + side / 3);
    let mut triangles = Vec::with_capacity(3 * surface.triangles.len());
    for side in 0..3 * surface.triangles.len() {
        let [t, k] = [side / 3, side % 3];
        let (a, b) = (surface.triangles[t][k], surface.triangles[t][(k + 1) % 3]);
        match edges.inner_sides(edges.of_side[side], &surface.triangles) {
            // Both sides of a flipped edge give one triangle each.
            Some([x, y]) => {
                let beyond = if x == side { y } else { x };
                triangles.push([a, middle_of(beyond), middle_of(side)]);
            }
            None => triangles.push([a, b, middle_of(side)]),
        }
    }
    Ok(Mesh::new(positions, triangles)?)
}
