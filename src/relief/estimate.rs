//! The estimate of all cells' signs that is best in the mean square, from weighted heights (method
//! section 8).
//!
//! A height is a weighted sum of the moves of the corners of its triangle of the host, and these moves
//! are sums over cells. Corners are grouped into the host's nodes, so that the normal equations are as
//! large as the surface has parts of cells, whatever host and suspect are made of. With `L` from nodes
//! to heights and `R` from cells to nodes, conjugate gradients solve
//! `(R' (L' W L) R + I / size^2) x = R' L' W o`. They run on one thread, in less time than the search
//! for closest points.

use rayon::prelude::*;

use super::heights::Height;
use super::host::ReliefHost;

/// A height after the regression, and its weight (one over its variance).
pub(super) struct Sample<'a> {
    pub(super) of: &'a Height,
    pub(super) height: f64,
    pub(super) weight: f64,
}

/// The estimate, per cell.
pub(super) struct Estimate {
    /// The distance by which the cell's sign moves the surface, as a share of the diagonal, with the
    /// sign.
    pub(super) values: Vec<f64>,
    /// The share of the prior variance that was explained, from 0 to 1.
    pub(super) explained: Vec<f64>,
}

/// Largest number of rounds of conjugate gradients. Every round gives an estimate; more rounds change
/// no figure of `benches/relief.rs`.
const ROUNDS: usize = 64;

/// Size of the residual, as a share of the first, at which the rounds end.
const SMALL: f64 = 1e-3;

/// `L' W L` and `L' W o` over the nodes of a host.
struct Equations<'a> {
    host: &'a ReliefHost,
    /// Lower and upper triangle of the matrix, in compressed rows.
    starts: Vec<usize>,
    entries: Vec<(u32, f64)>,
    right: Vec<f64>,
    /// `1 / size^2`.
    prior: f64,
}

/// An entry's row and column as one number, ordered by rows.
fn place(row: u32, column: u32) -> u64 {
    u64::from(row) << 32 | u64::from(column)
}

impl<'a> Equations<'a> {
    fn new(host: &'a ReliefHost, samples: &[Sample<'_>], prior: f64) -> Self {
        let count = host.nodes.len();
        let mut right = vec![0.0; count];
        let mut all: Vec<(u64, f64)> = Vec::with_capacity(9 * samples.len());
        for sample in samples {
            let corners = host.tree.triangles()[sample.of.triangle as usize];
            let part = |k: usize| {
                let (vertex, share) = (corners[k] as usize, sample.of.at[k]);
                (host.node_of[vertex], share * host.field.normals()[vertex].dot(sample.of.normal))
            };
            let parts = [part(0), part(1), part(2)];
            for (i, a) in parts {
                right[i as usize] += sample.weight * a * sample.height;
                all.extend(parts.map(|(j, b)| (place(i, j), sample.weight * a * b)));
            }
        }
        // The sort is stable, so that values of one entry are added in the order of the samples on any
        // number of threads.
        all.par_sort_by_key(|entry| entry.0);
        let mut starts = vec![0; count + 1];
        let mut entries: Vec<(u32, f64)> = Vec::new();
        for same in all.chunk_by(|a, b| a.0 == b.0) {
            let at = same.first().map_or(0, |entry| entry.0);
            let (row, column) = ((at >> 32) as usize, u32::try_from(at & 0xffff_ffff).unwrap_or(0));
            entries.push((column, same.iter().map(|entry| entry.1).sum()));
            starts[row + 1] = entries.len();
        }
        for row in 0..count {
            starts[row + 1] = starts[row + 1].max(starts[row]);
        }
        Self { host, starts, entries, right, prior }
    }

    fn row(&self, node: usize) -> &[(u32, f64)] {
        &self.entries[self.starts[node]..self.starts[node + 1]]
    }

    /// `R`: cells to nodes.
    fn to_nodes(&self, cells: &[f64], nodes: &mut [f64]) {
        for (to, node) in nodes.iter_mut().zip(&self.host.nodes) {
            *to = node.cells.iter().zip(&node.weights).map(|(&c, w)| w * cells[c as usize]).sum();
        }
    }

    /// `R'`: nodes to cells.
    fn to_cells(&self, nodes: &[f64], cells: &mut [f64]) {
        cells.fill(0.0);
        for (from, node) in nodes.iter().zip(&self.host.nodes) {
            for (&c, w) in node.cells.iter().zip(&node.weights) {
                cells[c as usize] += w * from;
            }
        }
    }

    /// `L' W L`.
    fn between_nodes(&self, x: &[f64], y: &mut [f64]) {
        for (node, y) in y.iter_mut().enumerate() {
            *y = self.row(node).iter().map(|&(other, value)| value * x[other as usize]).sum();
        }
    }

    /// The diagonal of `R' L' W L R`: the information of the heights on each cell alone.
    fn diagonal(&self) -> Vec<f64> {
        let mut diagonal = vec![0.0; self.host.field.signs()];
        for (number, node) in self.host.nodes.iter().enumerate() {
            for &(other, value) in self.row(number) {
                let other = &self.host.nodes[other as usize];
                for (k, (&cell, weight)) in node.cells.iter().zip(&node.weights).enumerate() {
                    // Most neighbouring nodes are parts of one cell, and so belong to the same cells.
                    let same = if other.cells[k] == cell {
                        Some(k)
                    } else {
                        other.cells.iter().position(|&c| c == cell)
                    };
                    let common = same.map_or(0.0, |k| weight * other.weights[k]);
                    diagonal[cell as usize] += value * common;
                }
            }
        }
        diagonal
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The estimate from weighted heights; `size` is the distance by which one sign moves the surface, as a
/// share of the diagonal.
pub(super) fn estimate(host: &ReliefHost, samples: &[Sample<'_>], size: f64) -> Estimate {
    let prior = 1.0 / (size * size);
    let equations = Equations::new(host, samples, prior);
    let information: Vec<f64> = equations.diagonal().into_iter().map(|d| d.max(0.0)).collect();
    let count = information.len();
    let mut values = vec![0.0; count];
    let mut residual = vec![0.0; count];
    equations.to_cells(&equations.right, &mut residual);
    let precondition = |residual: &[f64], to: &mut [f64]| {
        for ((to, r), d) in to.iter_mut().zip(residual).zip(&information) {
            *to = r / (d + prior);
        }
    };
    let mut preconditioned = vec![0.0; count];
    precondition(&residual, &mut preconditioned);
    let mut direction = preconditioned.clone();
    let mut along = dot(&residual, &preconditioned);
    let enough = SMALL * SMALL * along;
    let mut image = vec![0.0; count];
    let (mut on_nodes, mut after) = (vec![0.0; host.nodes.len()], vec![0.0; host.nodes.len()]);
    for _ in 0..ROUNDS {
        if along.is_nan() || along <= enough {
            break;
        }
        equations.to_nodes(&direction, &mut on_nodes);
        equations.between_nodes(&on_nodes, &mut after);
        equations.to_cells(&after, &mut image);
        for (image, d) in image.iter_mut().zip(&direction) {
            *image += equations.prior * d;
        }
        let step = along / dot(&direction, &image);
        if !step.is_finite() {
            break;
        }
        for ((x, r), (d, i)) in
            values.iter_mut().zip(&mut residual).zip(direction.iter().zip(&image))
        {
            *x += step * d;
            *r -= step * i;
        }
        precondition(&residual, &mut preconditioned);
        let next = dot(&residual, &preconditioned);
        for (d, z) in direction.iter_mut().zip(&preconditioned) {
            *d = z + next / along * *d;
        }
        along = next;
    }
    let explained = information.iter().map(|d| d / (d + prior)).collect();
    Estimate { values, explained }
}
