//! How cheaply each vertex can change its norm, and how far it may go (method section 3).
//!
//! Quadrics and directions come from the original mesh and its centre; they are computed once.

use glam::DVec3;
use rayon::prelude::*;

use super::exact::{Factors, stiffness};
use crate::mesh::adjacency::Adjacency;
use crate::mesh::quadric::Quadric;
use crate::mesh::surface::{Surface, doubled_area};

/// A vertex may travel at most so many times the smallest height of its triangles. (With 0.45, at
/// which no triangle can turn over, neighbours on a dense, noisy mesh move by as unlike lengths
/// as their heights are: the dragon was distorted twice as much, and 6,700 of its triangles turned
/// over once most bins had asked for more. Triangles are what `guard` looks after.)
const REACH: f64 = 4.5;

/// What the compliance of one carrier is made of.
#[derive(Debug, Clone, Copy)]
pub struct Pliancy {
    quadric: Quadric,
    /// From the centre to the carrier, a unit vector.
    direction: DVec3,
    /// The smallest height of its triangles, in the mesh's unit.
    height: f64,
}

/// What changing a vertex norm by `delta` costs and how far it may go, in the mesh's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compliance {
    /// `g`: the cost of `delta` is `delta^2 / g`.
    pub compliance: f64,
    /// The largest `delta` at which the vertex stays within reach of its place.
    pub reach: f64,
}

impl Pliancy {
    /// The compliance when plain displacement is penalised by `lambda` (method section 4).
    #[must_use]
    pub fn at(&self, lambda: f64) -> Compliance {
        // d = B^-1 u / (u^T B^-1 u) delta is the cheapest way to change the norm by delta.
        let factors = Factors::new(&stiffness(&self.quadric, lambda), 0.0);
        let way = factors.map_or(DVec3::ZERO, |factors| factors.solve(self.direction));
        let along = way.dot(self.direction);
        if !(along > 0.0 && along.is_finite()) {
            return Compliance { compliance: 0.0, reach: 0.0 };
        }
        // The mean over the planes rather than their sum: how many triangles a vertex has says
        // nothing about what its move costs. (Weighting by the triangles' area was tried too: 14 %
        // to 19 % worse on bunny, nefertiti and rocker-arm.)
        let compliance = along * self.quadric.trace();
        Compliance { compliance, reach: REACH * self.height * along / way.length() }
    }
}

/// The pliancy of every carrier about `centre`.
#[must_use]
pub fn pliancies(
    surface: &Surface,
    adjacency: &Adjacency,
    quadrics: &[Quadric],
    centre: DVec3,
) -> Vec<Pliancy> {
    let pliancy = |(v, (&position, &quadric)): (usize, (&DVec3, &Quadric))| Pliancy {
        quadric,
        direction: (position - centre).normalize_or_zero(),
        height: smallest_height(surface, adjacency.around(v)),
    };
    surface.positions.par_iter().zip(quadrics).enumerate().with_min_len(1024).map(pliancy).collect()
}

fn smallest_height(surface: &Surface, triangles: &[u32]) -> f64 {
    let height = |&t: &u32| {
        let [a, b, c] = surface.triangles[t as usize].map(|i| surface.positions[i as usize]);
        let longest =
            (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
        doubled_area(a, b, c).length() / longest.sqrt()
    };
    triangles.iter().map(height).fold(f64::INFINITY, f64::min)
}
