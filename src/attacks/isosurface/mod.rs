//! A surface from values at the corners of a cubic grid: marching cubes over the cells that the
//! surface passes.

mod cases;
mod grid;
mod winding;

use glam::DVec3;
use rayon::prelude::*;

use super::{AttackError, index};
use crate::mesh::Mesh;
use cases::{Cases, EDGES};

pub use grid::{Grid, grown, touched};
pub use winding::{Winding, is_closed};

/// A vertex keeps this share of its edge's length from both ends of the edge. So vertices of
/// different edges never coincide, and no triangle loses its area.
const LEAST_SHARE: f64 = 1e-3;

/// An unknown value. Cells with such a corner are left out.
pub const UNKNOWN: f64 = f64::NAN;

/// The surface where `value`, which is negative inside, passes through zero, within `cells`
/// (ascending).
///
/// A distance changes along an edge by at most the edge's length. So where its sign changes, the
/// absolute values at both ends add up to at most one cell. Cells with an edge where the sign
/// changes and this sum exceeds `slack` cells are left out: there the sign changes for another
/// reason, such as a border of the surface. So open surfaces stay open. Curless and Levoy (*A
/// volumetric method for building complex models from range images*, SIGGRAPH 1996) leave out cells
/// with unobserved corners likewise.
///
/// The method is marching cubes (Lorensen and Cline, SIGGRAPH 1987). Where the corners of a face
/// alternate, the inside corners are separated, in the same way on both sides of the face (Montani,
/// Scateni and Scopigno, *A modified look-up table for implicit disambiguation of marching cubes*,
/// 1994). So the surface has borders only where cells were left out, and every inner edge has two
/// triangles.
///
/// # Errors
/// [`AttackError::NoSurface`] when no value passes through zero.
pub fn extract(
    grid: &Grid,
    cells: &[u64],
    slack: f64,
    value: impl Fn(DVec3) -> f64 + Sync,
) -> Result<Mesh, AttackError> {
    let corners = grid::corners(cells);
    let values: Vec<f64> = corners.par_iter().map(|&corner| value(grid.place(corner))).collect();
    let most = slack * grid.cell();
    let passed: Vec<Passed> = cells
        .par_iter()
        .with_min_len(1024)
        .filter_map(|&cell| passed(cell, &corners, &values, most))
        .collect();
    let cases = Cases::new();
    let mut edges: Vec<u64> = passed.par_iter().flat_map_iter(|cell| cell.edges(&cases)).collect();
    edges.par_sort_unstable();
    edges.dedup();
    let positions = edges.par_iter().map(|&edge| {
        let (low, axis) = ends(edge);
        let (start, end) = (corners[low], grid::next(corners[low], axis));
        let far = values[position(&corners, end)];
        let share = values[low] / (values[low] - far);
        grid.place(start).lerp(grid.place(end), share.clamp(LEAST_SHARE, 1.0 - LEAST_SHARE))
    });
    let positions: Vec<DVec3> = positions.collect();
    let triangles = passed.par_iter().flat_map_iter(|cell| {
        let of = |edge: usize| index(edges.partition_point(|&other| other < cell.edge(edge)));
        cases.of(cell.case).iter().map(move |triangle| triangle.map(of))
    });
    let triangles: Vec<[u32; 3]> = triangles.collect();
    if triangles.is_empty() {
        Err(AttackError::NoSurface)
    } else {
        Ok(Mesh::new(positions, triangles)?)
    }
}

/// A cell that the surface passes: its corners, and which of them are inside.
struct Passed {
    corners: [usize; 8],
    case: usize,
}

impl Passed {
    /// The grid edge of this number in the cell, as one number for its lower corner and axis.
    fn edge(&self, number: usize) -> u64 {
        let (corner, axis) = EDGES[number];
        3 * self.corners[corner] as u64 + axis as u64
    }

    /// Edges of the grid that carry vertices.
    fn edges<'a>(&'a self, cases: &'a Cases) -> impl Iterator<Item = u64> + 'a {
        cases.of(self.case).iter().flatten().map(|&number| self.edge(number))
    }
}

/// Lower corner and axis of an edge.
fn ends(edge: u64) -> (usize, usize) {
    let part = |number: u64| usize::try_from(number).unwrap_or(usize::MAX);
    (part(edge / 3), part(edge % 3))
}

/// The index of a corner in the sorted list, which has all corners of the cells.
fn position(corners: &[u64], corner: u64) -> usize {
    corners.partition_point(|&other| other < corner)
}

fn passed(cell: u64, corners: &[u64], values: &[f64], most: f64) -> Option<Passed> {
    let around = grid::around(cell).map(|corner| position(corners, corner));
    let at = around.map(|corner| values[corner]);
    let case = (0..8).filter(|&k| at[k] < 0.0).fold(0, |case, k| case | 1 << k);
    let sound = |&(corner, axis): &(usize, usize)| {
        let [a, b] = [at[corner], at[corner | 1 << axis]];
        (a < 0.0) == (b < 0.0) || a.abs() + b.abs() <= most
    };
    let known = at.iter().all(|value| !value.is_nan());
    (known && case != 0 && case != 255 && EDGES.iter().all(sound))
        .then_some(Passed { corners: around, case })
}

#[cfg(test)]
mod tests;
