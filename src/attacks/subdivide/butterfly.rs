//! The modified butterfly scheme.

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use super::super::edges::{Edges, corner, opposite};
use super::super::{AttackError, Target};
use super::{in_four, middle};
use crate::mesh::Mesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::surface::Surface;

/// The modified butterfly scheme: old vertices stay, new ones lie on a smooth surface through them
/// (Dyn, Levin and Gregory, *A butterfly subdivision scheme*, 1990, with the rules for irregular
/// vertices of Zorin, Schröder and Sweldens, *Interpolating subdivision for meshes with arbitrary
/// topology*, SIGGRAPH 1996).
///
/// Borders are subdivided by the four-point scheme; an inner edge whose neighbourhood is cut off by
/// a border is halved.
///
/// # Errors
/// As [`midpoint`](super::midpoint).
pub fn butterfly(target: &Target<'_>) -> Result<Mesh, AttackError> {
    let (surface, edges, around) = (target.surface()?, target.edges()?, target.around()?);
    let border = border_neighbours(surface, edges);
    let scheme = Scheme { surface, edges, around, border: &border };
    let new = (0..edges.ends.len())
        .into_par_iter()
        .with_min_len(4096)
        .map_init(Vec::new, |ring, edge| scheme.new_vertex(edge, ring))
        .collect();
    in_four(surface, edges, surface.positions.clone(), new)
}

/// For each vertex, its neighbours along borders.
fn border_neighbours(surface: &Surface, edges: &Edges) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::new(); surface.positions.len()];
    for [a, b] in edges.borders() {
        neighbours[a as usize].push(b);
        neighbours[b as usize].push(a);
    }
    neighbours
}

struct Scheme<'a> {
    surface: &'a Surface,
    edges: &'a Edges,
    around: &'a Adjacency,
    border: &'a [Vec<u32>],
}

impl Scheme<'_> {
    fn at(&self, vertex: u32) -> DVec3 {
        self.surface.positions[vertex as usize]
    }

    fn new_vertex(&self, edge: usize, ring: &mut Vec<u32>) -> DVec3 {
        let triangles = self.surface.triangles.as_slice();
        let ends = self.edges.ends[edge];
        let Some(sides) = self.edges.inner_sides(edge, triangles) else {
            return self.four_points(edge);
        };
        let [a, b] = sides.map(|side| corner(triangles, side));
        let [first, second] = [self.seen_from(a, b, ring), self.seen_from(b, a, ring)];
        match (first, second) {
            (End::Irregular(p), End::Irregular(q)) => p.midpoint(q),
            (End::Irregular(p), _) | (_, End::Irregular(p)) => p,
            (End::Regular(p), End::Regular(q)) => {
                let [c, d] = sides.map(|side| self.at(opposite(triangles, side)));
                middle(self.surface, ends) + 0.125 * (c + d) - 0.0625 * (p + q)
            }
            _ => middle(self.surface, ends),
        }
    }

    /// The four-point scheme along a border: -1/16, 9/16, 9/16, -1/16.
    fn four_points(&self, edge: usize) -> DVec3 {
        let [a, b] = self.edges.ends[edge];
        let beyond = |v: u32, not: u32| match self.border[v as usize].as_slice() {
            [x, y] => Some(self.at(if *x == not { *y } else { *x })),
            _ => None,
        };
        match (self.edges.count[edge], beyond(a, b), beyond(b, a)) {
            (1, Some(before), Some(after)) => {
                0.5625 * (self.at(a) + self.at(b)) - 0.0625 * (before + after)
            }
            _ => middle(self.surface, [a, b]),
        }
    }

    /// What the end `v` of the edge from `v` to `to` contributes to the new vertex.
    fn seen_from(&self, v: u32, to: u32, ring: &mut Vec<u32>) -> End {
        if !self.ring(v, to, ring) {
            return End::Cut;
        }
        let k = ring.len();
        if k == 6 {
            // The wings on this side are two steps from `to`, in both directions.
            return End::Regular(self.at(ring[2]) + self.at(ring[4]));
        }
        let mut place = 0.75 * self.at(v);
        for (j, &neighbour) in ring.iter().enumerate() {
            place += weight(j, k) * self.at(neighbour);
        }
        End::Irregular(place)
    }

    /// Writes the neighbours of `v` to `ring` in cyclic order from `start`. Returns `false` if they
    /// do not form a closed cycle.
    fn ring(&self, v: u32, start: u32, ring: &mut Vec<u32>) -> bool {
        let around = self.around.around(v as usize);
        let after = |from: u32| {
            around.iter().find_map(|&t| {
                let corners = self.surface.triangles[t as usize];
                let k = corners.iter().position(|&c| c == v)?;
                (corners[(k + 1) % 3] == from).then_some(corners[(k + 2) % 3])
            })
        };
        ring.clear();
        let mut next = start;
        for _ in around {
            ring.push(next);
            match after(next) {
                Some(found) => next = found,
                None => return false,
            }
        }
        // Where two fans touch in `v`, the cycle closes too early.
        next == start && !ring.iter().skip(1).any(|&neighbour| neighbour == start)
    }
}

/// What an end of an edge contributes.
enum End {
    /// Six neighbours: the sum of the two wings on its side.
    Regular(DVec3),
    /// Another number of neighbours: the new vertex by the stencil of this end.
    Irregular(DVec3),
    /// The neighbours do not form a closed cycle.
    Cut,
}

/// Weight of neighbour j of k, counted from the other end of the edge (Zorin et al. 1996).
fn weight(j: usize, k: usize) -> f64 {
    match (k, j) {
        (3, 0) => 5.0 / 12.0,
        (3, _) => -1.0 / 12.0,
        (4, 0) => 3.0 / 8.0,
        (4, 2) => -1.0 / 8.0,
        (4, _) => 0.0,
        _ => {
            let n = k as f64;
            let angle = TAU * j as f64 / n;
            (0.25 + libm::cos(angle) + 0.5 * libm::cos(2.0 * angle)) / n
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stencils_keep_a_constant() {
        for k in 3..12 {
            let sum: f64 = (0..k).map(|j| weight(j, k)).sum();
            assert!((sum - 0.25).abs() < 1e-12, "{k}: {sum}");
        }
    }
}
