//! Smoothing with cotangent weights.

use glam::DVec3;
use rayon::prelude::*;

use super::{AttackError, Target, with_carriers_at};
use crate::mesh::Mesh;
use crate::mesh::surface::doubled_area;

/// Moves every point `lambda` of the way to the weighted mean of its neighbours, `iterations`
/// times. The weight of an edge is `cot a + cot b`, where a and b are the angles opposite the edge.
/// This is mean curvature flow in explicit steps: points move along the normal, whatever the shapes
/// of the triangles (Desbrun, Meyer, Schröder and Barr, *Implicit fairing of irregular meshes using
/// diffusion and curvature flow*, SIGGRAPH 1999, eq. 14, normalised as there). The weights are
/// those of the surface before each step.
///
/// Negative weights come from obtuse triangles and would push points away from each other. They
/// count as 0. Points on borders move as in [`super::smooth::laplacian`].
///
/// # Errors
/// [`AttackError::NoSurface`]; [`AttackError::Mesh`] when a `lambda` above 1 makes the steps
/// diverge.
pub fn cotangent(target: &Target<'_>, lambda: f64, iterations: usize) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let (triangles, around, edges) = (&surface.triangles, target.around()?, target.edges()?);
    let mut on_border = vec![false; surface.positions.len()];
    for vertex in edges.borders().flatten() {
        on_border[vertex as usize] = true;
    }
    let rings = target.rings()?;
    let mut now = surface.positions.clone();
    for _ in 0..iterations {
        target.go_on()?;
        let cotangents: Vec<f64> = (0..3 * triangles.len())
            .into_par_iter()
            .with_min_len(4096)
            .map(|side| cotangent_opposite(triangles, &now, side))
            .collect();
        let mut weights = vec![0.0; edges.ends.len()];
        for (&edge, cotangent) in edges.of_side.iter().zip(&cotangents) {
            weights[edge] += cotangent;
        }
        let moved = |vertex: usize| {
            let old = now[vertex];
            let mean = if on_border[vertex] {
                let ring = rings.of(vertex);
                ring.iter().map(|&v| now[v as usize] - old).sum::<DVec3>() / ring.len() as f64
            } else {
                let sides = around.around(vertex).iter().flat_map(|&t| [0, 1, 2].map(|k| (t, k)));
                let (mut sum, mut total) = (DVec3::ZERO, 0.0);
                for (t, k) in sides {
                    let corners = triangles[t as usize];
                    let ends = [corners[k], corners[(k + 1) % 3]].map(|v| v as usize);
                    let Some(at) = ends.iter().position(|&end| end == vertex) else { continue };
                    // Each edge is visited once in each of its triangles.
                    let weight = weights[edges.of_side[3 * t as usize + k]].max(0.0);
                    sum += weight * (now[ends[1 - at]] - old);
                    total += weight;
                }
                if total > 0.0 { sum / total } else { DVec3::ZERO }
            };
            old + lambda * mean
        };
        let next = (0..now.len()).into_par_iter().with_min_len(4096).map(moved).collect();
        now = next;
    }
    with_carriers_at(target, &now)
}

/// The cotangent of the angle opposite a side; 0 in a triangle without area.
fn cotangent_opposite(triangles: &[[u32; 3]], positions: &[DVec3], side: usize) -> f64 {
    let [a, b, c] = [0, 1, 2].map(|by| positions[triangles[side / 3][(side + by) % 3] as usize]);
    let doubled = doubled_area(a, b, c).length();
    if doubled > 0.0 { (a - c).dot(b - c) / doubled } else { 0.0 }
}
