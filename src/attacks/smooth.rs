//! Smoothing by the umbrella operator: Laplacian, and Taubin's variant without shrinking.

use glam::DVec3;
use rayon::prelude::*;

use super::edges::Edges;
use super::{AttackError, Target, index, with_carriers_at};
use crate::mesh::Mesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::surface::Surface;

/// Moves all points at once `lambda` of the way to the mean of their neighbours, `iterations` times
/// (Taubin, *Geometric signal processing on polygonal meshes*, Eurographics 2000, with equal
/// weights; Luo and Bors 2009, fig. 6: lambda 0.5; Wang et al. 2010: lambda 0.1).
///
/// Each triangle counts its corners as neighbours, so that inside a closed surface all weights are
/// equal. A point on a border moves only towards the mean of itself and its neighbours along the
/// border, as in `MeshLab`, so that holes do not grow.
///
/// # Errors
/// [`AttackError::NoSurface`]; [`AttackError::Mesh`] when a `lambda` above 1 makes the steps
/// diverge.
pub fn laplacian(target: &Target<'_>, lambda: f64, iterations: usize) -> Result<Mesh, AttackError> {
    let steps = std::iter::repeat_n(lambda, iterations);
    umbrella(target, steps)
}

/// Lambda and mu, as in `MeshLab`'s defaults.
pub const TAUBIN: [f64; 2] = [0.5, -0.53];

/// Alternates a step by `lambda`, as in [`laplacian`], and a step by the negative `mu`,
/// `iterations` times. This is a low-pass filter that does not shrink the surface if `0 < lambda <
/// -mu` (Taubin, *A signal processing approach to fair surface design*, SIGGRAPH 1995; the pass
/// band of [`TAUBIN`] ends at `1/lambda + 1/mu = 0.11`).
///
/// # Errors
/// As [`laplacian`].
pub fn taubin(
    target: &Target<'_>,
    [lambda, mu]: [f64; 2],
    iterations: usize,
) -> Result<Mesh, AttackError> {
    umbrella(target, (0..iterations).flat_map(|_| [lambda, mu]))
}

/// For each of `steps`, moves every point by that share of the way to the mean of its neighbours.
fn umbrella(target: &Target<'_>, steps: impl Iterator<Item = f64>) -> Result<Mesh, AttackError> {
    let mut now = target.surface()?.positions.clone();
    let rings = target.rings()?;
    let mut next = now.clone();
    for step in steps {
        target.go_on()?;
        next.par_iter_mut().with_min_len(4096).enumerate().for_each(|(vertex, next)| {
            let old = now[vertex];
            let ring = rings.of(vertex);
            let sum = ring.iter().fold(DVec3::ZERO, |sum, &v| sum + now[v as usize]);
            *next = old + step * (sum / ring.len() as f64 - old);
        });
        std::mem::swap(&mut now, &mut next);
    }
    with_carriers_at(target, &now)
}

/// For each vertex, the vertices that it is averaged with, in compressed rows. Some are listed
/// twice.
pub(super) struct Rings {
    starts: Vec<usize>,
    members: Vec<u32>,
}

impl Rings {
    pub(super) fn new(surface: &Surface, edges: &Edges, around: &Adjacency) -> Self {
        let vertices = surface.positions.len();
        let mut along_border = vec![Vec::new(); vertices];
        for [a, b] in edges.borders() {
            along_border[a as usize].push(b);
            along_border[b as usize].push(a);
        }
        let mut rings = Self { starts: vec![0], members: Vec::new() };
        for (vertex, border) in along_border.iter().enumerate() {
            let this = index(vertex);
            if border.is_empty() {
                let triangles = around.around(vertex).iter();
                let corners = triangles.flat_map(|&t| surface.triangles[t as usize]);
                rings.members.extend(corners.filter(|&corner| corner != this));
            } else {
                rings.members.push(this);
                rings.members.extend(border);
            }
            rings.starts.push(rings.members.len());
        }
        rings
    }

    pub(super) fn of(&self, vertex: usize) -> &[u32] {
        &self.members[self.starts[vertex]..self.starts[vertex + 1]]
    }
}
