//! How far smoothing moves each vertex of a host along its normal. A reading takes these displacements
//! out of the heights of a smoothed or re-extracted suspect, so that shrinkage is not read as a mark.

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::stop::{Stop, go_on};
use crate::mesh::surface::Surface;

/// Rounds of umbrella smoothing, each half-way to the neighbours' mean, after which displacements are
/// taken (method section 8).
pub const ROUNDS: [u32; 5] = [1, 4, 12, 30, 60];

/// Neighbours of each vertex, as compressed rows. The neighbour across an edge between two triangles is
/// listed twice, across a boundary edge once, so that the triangles around a vertex give all
/// neighbours.
struct Neighbours {
    starts: Vec<u32>,
    all: Vec<u32>,
}

impl Neighbours {
    fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut starts = vec![0_u32; vertices + 1];
        for &v in triangles.iter().flatten() {
            starts[v as usize + 1] += 2;
        }
        for v in 0..vertices {
            starts[v + 1] += starts[v];
        }
        let mut next = starts.clone();
        let mut all = vec![0; triangles.len() * 6];
        for &[a, b, c] in triangles {
            for [v, first, second] in [[a, b, c], [b, c, a], [c, a, b]] {
                let slot = &mut next[v as usize];
                all[*slot as usize] = first;
                all[*slot as usize + 1] = second;
                *slot += 2;
            }
        }
        Self { starts, all }
    }

    fn of(&self, vertex: usize) -> &[u32] {
        &self.all[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

/// Per vertex and number of [`ROUNDS`], the displacement along the normal, as a share of `diagonal`;
/// `None` once `stop` answers `true`.
pub(super) fn smoothing(
    surface: &Surface,
    normals: &[DVec3],
    diagonal: f64,
    stop: Stop<'_>,
) -> Option<Vec<[f32; ROUNDS.len()]>> {
    let neighbours = Neighbours::new(surface.positions.len(), &surface.triangles);
    let mut now = surface.positions.clone();
    let mut next = now.clone();
    let mut moved = vec![[0.0; ROUNDS.len()]; now.len()];
    let last = ROUNDS.into_iter().max().unwrap_or(0);
    for round in 1..=last {
        go_on(stop)?;
        next.par_iter_mut().enumerate().with_min_len(4096).for_each(|(vertex, to)| {
            let around = neighbours.of(vertex);
            let at = now[vertex];
            let sum: DVec3 = around.iter().map(|&v| now[v as usize] - at).sum();
            *to = at + 0.5 * sum / around.len().max(1) as f64;
        });
        std::mem::swap(&mut now, &mut next);
        if let Some(column) = ROUNDS.iter().position(|&r| r == round) {
            let all = moved.par_iter_mut().zip(&now).zip(&surface.positions).zip(normals);
            all.with_min_len(4096).for_each(|(((moved, now), start), normal)| {
                moved[column] = narrowed((*now - *start).dot(*normal) / diagonal);
            });
        }
    }
    Some(moved)
}

#[expect(clippy::cast_possible_truncation, reason = "a feature of a fit: digits do not matter")]
fn narrowed(x: f64) -> f32 {
    x as f32
}
