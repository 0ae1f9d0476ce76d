//! Subdivision schemes, one step each: more triangles over the same or a smoother surface.
//!
//! D. Zorin and P. Schröder, *Subdivision for modeling and animation*, SIGGRAPH course notes 2000
//! (the paper's reference 23), describe all but sqrt(3).

mod butterfly;
mod sqrt3;

use std::f64::consts::TAU;

use glam::DVec3;

use super::edges::{Edges, opposite};
use super::{AttackError, Target, index};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;

pub use butterfly::butterfly;
pub use sqrt3::sqrt3;

/// Cuts each triangle into four, with new vertices at the midpoints of the edges. The surface does
/// not change.
///
/// # Errors
/// [`AttackError::NoSurface`], or [`AttackError::Mesh`] when the result is too large.
pub fn midpoint(target: &Target<'_>) -> Result<Mesh, AttackError> {
    let (surface, edges) = (target.surface()?, target.edges()?);
    let old = surface.positions.clone();
    let new = edges.ends.iter().map(|ends| middle(surface, *ends)).collect();
    in_four(surface, edges, old, new)
}

/// Loop's scheme (C. Loop, *Smooth subdivision surfaces based on triangles*, 1987). Triangles are
/// cut as in [`midpoint`]. New vertices have weights of 3/8 for the ends of their edge and 1/8 for
/// the opposite corners. Old vertices move towards their neighbours by Loop's beta. Borders follow
/// the cubic spline.
///
/// # Errors
/// As [`midpoint`].
pub fn loop_scheme(target: &Target<'_>) -> Result<Mesh, AttackError> {
    let (surface, edges) = (target.surface()?, target.edges()?);
    let at = |v: u32| surface.positions[v as usize];
    let new_vertex = |edge: usize| {
        let ends = edges.ends[edge];
        match edges.inner_sides(edge, &surface.triangles) {
            Some(sides) => {
                let [c, d] = sides.map(|side| at(opposite(&surface.triangles, side)));
                0.75 * middle(surface, ends) + 0.125 * (c + d)
            }
            None => middle(surface, ends),
        }
    };
    let new = (0..edges.ends.len()).map(new_vertex).collect();
    let old = loop_vertices(surface, edges);
    in_four(surface, edges, old, new)
}

/// Sum and number of a vertex's neighbours.
#[derive(Clone, Copy, Default)]
struct Ring {
    sum: DVec3,
    count: u32,
}

impl Ring {
    fn add(&mut self, neighbour: DVec3) {
        self.sum += neighbour;
        self.count += 1;
    }
}

/// For each vertex, its neighbours over edges of two triangles, and those over other edges
/// (borders).
fn rings(surface: &Surface, edges: &Edges) -> Vec<[Ring; 2]> {
    let mut rings = vec![[Ring::default(); 2]; surface.positions.len()];
    for (&[a, b], &count) in edges.ends.iter().zip(&edges.count) {
        let kind = usize::from(count != 2);
        let [p, q] = [a, b].map(|v| surface.positions[v as usize]);
        rings[a as usize][kind].add(q);
        rings[b as usize][kind].add(p);
    }
    rings
}

fn loop_vertices(surface: &Surface, edges: &Edges) -> Vec<DVec3> {
    let place = |(&v, [inner, border]): (&DVec3, &[Ring; 2])| match border.count {
        0 => {
            let n = f64::from(inner.count);
            let c = 0.375 + 0.25 * libm::cos(TAU / n);
            let beta = (0.625 - c * c) / n;
            (1.0 - n * beta) * v + beta * inner.sum
        }
        2 => 0.75 * v + 0.125 * border.sum,
        // A corner of several borders, or a vertex on an edge with more than two triangles.
        _ => v,
    };
    surface.positions.iter().zip(&rings(surface, edges)).map(place).collect()
}

fn middle(surface: &Surface, ends: [u32; 2]) -> DVec3 {
    let [a, b] = ends.map(|v| surface.positions[v as usize]);
    a.midpoint(b)
}

/// Cuts each triangle into four. The vertices are `old`, then `new`, one per edge.
fn in_four(
    surface: &Surface,
    edges: &Edges,
    old: Vec<DVec3>,
    new: Vec<DVec3>,
) -> Result<Mesh, AttackError> {
    let first = old.len();
    let mut positions = old;
    positions.extend(new);
    let mut triangles = Vec::with_capacity(4 * surface.triangles.len());
    for (t, &[a, b, c]) in surface.triangles.iter().enumerate() {
        let [ab, bc, ca] = [0, 1, 2].map(|k| index(first + edges.of_side[3 * t + k]));
        triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    Ok(Mesh::new(positions, triangles)?)
}
