//! A host prepared for readings: its field, a tree for closest points, its smoothing displacements, and
//! its vertices grouped into nodes.

use glam::DVec3;
use rayon::prelude::*;

use super::cells::{AROUND, Cells, weights};
use super::field::Field;
use super::heights::{Points, Work, heights_of};
use super::smoothing::{ROUNDS, smoothing};
use crate::mesh::stop::{Stop, go_on};
use crate::mesh::surface::Surface;
use crate::mesh::tree::SearchTree;

/// A node: the vertices of the host in one part of a cell, which belong to the same cells. There are no
/// more nodes than parts of cells that the surface touches, however many vertices it has.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) cells: [u32; AROUND],
    /// Means over the node's vertices of their weights.
    pub(super) weights: [f64; AROUND],
}

/// A host prepared for readings. It follows from the surface alone.
pub struct ReliefHost {
    pub(super) field: Field,
    pub(super) centre: DVec3,
    pub(super) low: DVec3,
    pub(super) tree: SearchTree,
    pub(super) node_of: Vec<u32>,
    pub(super) nodes: Vec<Node>,
    /// Per vertex, how far rounds of smoothing move it along the normal, as shares of the diagonal.
    pub(super) smoothed: Vec<[f32; ROUNDS.len()]>,
}

impl ReliefHost {
    /// Prepares a host; `None` where the surface has no [`Field`].
    #[must_use]
    pub fn new(surface: Surface) -> Option<Self> {
        Self::new_until(surface, &|| false)
    }

    /// As [`Self::new`]; `None` also once `stop` answers `true`.
    #[must_use]
    pub fn new_until(surface: Surface, stop: Stop<'_>) -> Option<Self> {
        let field = Field::new_until(&surface, stop)?;
        go_on(stop)?;
        let (node_of, nodes) = nodes(&surface.positions, field.cells());
        go_on(stop)?;
        let smoothed = smoothing(&surface, field.normals(), field.diagonal(), stop)?;
        let centre = surface.centre();
        let low = surface.positions.iter().fold(DVec3::INFINITY, |low, &p| low.min(p));
        let bounds = (low, field.diagonal());
        let tree = SearchTree::new(surface.positions, surface.triangles, bounds, stop)?;
        Some(Self { field, centre, low, tree, node_of, nodes, smoothed })
    }

    /// The share of a suspect's surface that lies on the host's, within 1.2 % of the diagonal and
    /// facing the same way. The suspect's carriers are at `positions`, in the host's coordinates;
    /// `mirrored` says whether the move to these coordinates turned the surface inside out. `None` once
    /// `stop` answers `true`.
    #[must_use]
    pub fn share_on(
        &self,
        suspect: &Surface,
        positions: &[DVec3],
        mirrored: bool,
        stop: Stop<'_>,
    ) -> Option<f64> {
        /// Points that are tested, for a share exact to a percent.
        const POINTS: usize = 4000;
        let points = Points::in_triangles(self, suspect, positions, mirrored, POINTS);
        let on = heights_of(self, &points.all, &mut Work::new(u64::MAX, stop))?.len();
        Some(on as f64 / points.all.len().max(1) as f64)
    }

    /// The host's field.
    #[must_use]
    pub fn field(&self) -> &Field {
        &self.field
    }
}

/// Per vertex its node, and the nodes in the order of their parts of cells.
fn nodes(positions: &[DVec3], cells: &Cells) -> (Vec<u32>, Vec<Node>) {
    let mut order: Vec<(u64, u32)> =
        (0..).zip(positions).map(|(vertex, p)| (Cells::part(&cells.place(*p)), vertex)).collect();
    order.par_sort_unstable();
    let mut node_of = vec![0; positions.len()];
    let mut nodes: Vec<Node> = Vec::new();
    for part in order.chunk_by(|a, b| a.0 == b.0) {
        let number = u32::try_from(nodes.len()).unwrap_or(u32::MAX);
        let mut node = Node { cells: [0; AROUND], weights: [0.0; AROUND] };
        for &(_, vertex) in part {
            let place = cells.place(positions[vertex as usize]);
            node.cells = cells.numbers(&place);
            for (sum, weight) in node.weights.iter_mut().zip(weights(&place)) {
                *sum += weight / part.len() as f64;
            }
            node_of[vertex as usize] = number;
        }
        nodes.push(node);
    }
    (node_of, nodes)
}
