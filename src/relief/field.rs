//! The field of a host: its cells, and the direction and length of the moves of its vertices.

use glam::DVec3;
use rayon::prelude::*;

use super::cells::{Cells, weights};
use super::signs::Signs;
use crate::mesh::stop::{Stop, go_on, in_steps_of, mapped, unstopped};
use crate::mesh::sum::ordered_sum_until;
use crate::mesh::surface::{Surface, doubled_area};
use crate::mesh::turning::flipped_until;

/// Side of a cell, as a share of the diagonal. Of 0.01, 0.0125, 0.015 and 0.02 at one distortion, finer
/// cells read better from fragments and averaged copies. Coarser cells read better from sparse meshes
/// under strong simplification and turn normals less (`benches/relief.rs`, built with each side).
pub const CELL: f64 = 0.0125;

/// Halvings of the displacements at turned triangles before these displacements are undone.
const HALVINGS: usize = 6;

/// The part of a mark that follows from the host's surface alone.
#[derive(Debug, Clone)]
pub struct Field {
    cells: Cells,
    /// Length of the bounding box's diagonal.
    diagonal: f64,
    /// Unit normals of the vertices; zero where there is no normal.
    normals: Vec<DVec3>,
    /// Root mean square, over the surface and over all signs, of the distance that the surface moves
    /// when every sign counts 1.
    spread: f64,
}

/// Area-weighted unit normals; zero where they cancel.
pub(super) fn vertex_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let area = doubled_area(a, b, c);
        for &v in t {
            normals[v as usize] += area;
        }
    }
    normals.par_iter_mut().with_min_len(4096).for_each(|n| *n = n.normalize_or_zero());
    normals
}

impl Field {
    /// The field of a surface; `None` where the surface has no triangle, or a diagonal outside 1e-100
    /// to 1e100.
    #[must_use]
    pub fn new(surface: &Surface) -> Option<Self> {
        Self::new_until(surface, &|| false)
    }

    /// As [`Self::new`]; `None` also once `stop` answers `true`.
    #[must_use]
    pub fn new_until(surface: &Surface, stop: Stop<'_>) -> Option<Self> {
        let (positions, triangles) = (&surface.positions, &surface.triangles);
        let diagonal = surface.diagonal();
        if triangles.is_empty() || !(1e-100..1e100).contains(&diagonal) {
            return None;
        }
        go_on(stop)?;
        let normals = vertex_normals(positions, triangles);
        go_on(stop)?;
        let cells = Cells::new(positions, CELL * diagonal);
        let spread = spread(surface, &normals, &cells, stop)?;
        (spread > 0.0).then_some(Self { cells, diagonal, normals, spread })
    }

    /// Number of signs of a mark of this host.
    #[must_use]
    pub fn signs(&self) -> usize {
        self.cells.count()
    }

    /// Length of the bounding box's diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        self.diagonal
    }

    pub(super) fn cells(&self) -> &Cells {
        &self.cells
    }

    pub(super) fn normals(&self) -> &[DVec3] {
        &self.normals
    }

    /// The amount that one sign adds to the field of a mark of this amplitude, as a share of the
    /// diagonal.
    pub(super) fn size(&self, amplitude: f64) -> f64 {
        amplitude / self.spread
    }

    /// The positions of the host's vertices in a marked mesh. `amplitude` is the root mean square
    /// distance that the surface moves, as a share of the diagonal. Vertices of triangles that would
    /// turn over move less, and `pinned` vertices do not move. Readers know neither.
    #[must_use]
    pub fn marked(
        &self,
        surface: &Surface,
        signs: &Signs,
        amplitude: f64,
        pinned: &[bool],
    ) -> Vec<DVec3> {
        unstopped(|stop| self.marked_until(surface, signs, amplitude, pinned, stop))
    }

    /// As [`Self::marked`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn marked_until(
        &self,
        surface: &Surface,
        signs: &Signs,
        amplitude: f64,
        pinned: &[bool],
        stop: Stop<'_>,
    ) -> Option<Vec<DVec3>> {
        let size = self.size(amplitude) * self.diagonal;
        let move_of = |vertex: usize, p: &DVec3| {
            if pinned.get(vertex).copied().unwrap_or(false) {
                return DVec3::ZERO;
            }
            size * self.value(*p, signs) * self.normals[vertex]
        };
        let mut moves = mapped(&surface.positions, stop, move_of)?;
        for round in 0..=HALVINGS {
            let moved = added(&surface.positions, &moves);
            let turned = flipped_until(surface, &moved, stop)?;
            if turned.is_empty() {
                return Some(moved);
            }
            let less = if round < HALVINGS { 0.5 } else { 0.0 };
            let mut corners: Vec<u32> =
                turned.iter().flat_map(|&t| surface.triangles[t as usize]).collect();
            corners.sort_unstable();
            corners.dedup();
            for vertex in corners {
                moves[vertex as usize] *= less;
            }
        }
        Some(added(&surface.positions, &moves))
    }
}

/// The share of a mark's displacements that a surface has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// 1 for all displacements, 0 for none.
    pub value: f64,
    /// Standard deviation of the share, if all other displacements are independent noise.
    pub uncertainty: f64,
}

impl Field {
    /// The share of a mark that the carriers at `moved` have: least squares along the normals. `None`
    /// once `stop` answers `true`.
    #[must_use]
    pub fn share_of(
        &self,
        surface: &Surface,
        moved: &[DVec3],
        signs: &Signs,
        amplitude: f64,
        stop: Stop<'_>,
    ) -> Option<Share> {
        let size = self.size(amplitude) * self.diagonal;
        let all: Vec<usize> = (0..surface.positions.len().min(moved.len())).collect();
        let pair = |&v: &usize| {
            let (p, n) = (surface.positions[v], self.normals[v]);
            (size * self.value(p, signs) * n.length(), (moved[v] - p).dot(n))
        };
        let sums = ordered_sum_until(
            &all,
            DVec3::ZERO,
            |sums, v| {
                let (meant, found) = pair(v);
                sums + DVec3::new(meant * meant, meant * found, found * found)
            },
            |a, b| a + b,
            stop,
        )?;
        let value = sums.y / sums.x;
        let noise = (sums.z - value * sums.y).max(0.0) / all.len().max(1) as f64;
        Some(Share { value, uncertainty: (noise / sums.x).sqrt() })
    }

    /// The field at a point of the host.
    fn value(&self, p: DVec3, signs: &Signs) -> f64 {
        let place = self.cells.place(p);
        let numbers = self.cells.numbers(&place).into_iter();
        numbers.zip(weights(&place)).map(|(cell, weight)| weight * signs.sign(cell)).sum()
    }
}

fn added(positions: &[DVec3], moves: &[DVec3]) -> Vec<DVec3> {
    positions.iter().zip(moves).map(|(p, m)| *p + *m).collect()
}

/// The root mean square, over the surface and over all signs, of the distance that the surface moves
/// when every sign counts 1. Over the signs, `E u_k u_l = (n_k . n)(n_l . n) sum_c B_kc B_lc` for the
/// distances `u` that two corners of a triangle with normal `n` move along it. Between the corners the
/// mean square over a triangle is `(sum_k u_k^2 + sum_(k < l) u_k u_l) / 6`.
fn spread(surface: &Surface, normals: &[DVec3], cells: &Cells, stop: Stop<'_>) -> Option<f64> {
    /// Triangles between two calls of `stop`; each takes about a microsecond.
    const STEP: usize = 8192;
    let (positions, triangles) = (&surface.positions, &surface.triangles);
    let of = |triangle: usize| {
        let t = triangles[triangle];
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let across = doubled_area(a, b, c);
        let normal = across.normalize_or_zero();
        let places = [a, b, c].map(|p| cells.place(p));
        let along = t.map(|v| normals[v as usize].dot(normal));
        let all = places.map(|place| weights(&place));
        let mut mean = 0.0;
        for k in 0..3 {
            for l in k..3 {
                let common = Cells::common((&places[k], &all[k]), (&places[l], &all[l]));
                mean += along[k] * along[l] * common / 6.0;
            }
        }
        let size = across.length();
        (size * mean, size)
    };
    let all = in_steps_of(STEP, triangles.len(), stop, of)?;
    let (squares, area) = ordered_sum_until(
        &all,
        (0.0, 0.0),
        |(squares, area), (square, size)| (squares + square, area + size),
        |(s, a), (t, b)| (s + t, a + b),
        stop,
    )?;
    Some((squares / area).max(0.0).sqrt())
}
