//! How cheaply each vertex can change its norm (method section 3).
//!
//! Quadrics and directions come from the original mesh and its centre; they are computed once.
//!
//! How far a vertex may go is not said here: with a limit of a share of its triangles' heights, at
//! which none could turn over, neighbours on a dense, noisy mesh move by as unlike lengths as their
//! heights are, which turned thousands over (the dragon: 6,754 of its triangles, and twice the
//! distortion). Triangles are what `guard` looks after.

use glam::DVec3;

use super::exact::{Factors, LAMBDA, penalised};
use crate::mesh::quadric::Quadric;
use crate::mesh::stop::{Stop, mapped};
use crate::mesh::surface::Surface;

/// What the compliance of one carrier is made of.
#[derive(Debug, Clone, Copy)]
pub struct Pliancy {
    quadric: Quadric,
    /// From the centre to the carrier, a unit vector.
    direction: DVec3,
}

impl Pliancy {
    /// Its compliance `g`, with plain displacement penalised by `stiffness` times the usual
    /// `lambda` (method section 4): changing its norm by `delta` costs `delta^2 / g`.
    #[must_use]
    pub fn at(&self, stiffness: f64) -> f64 {
        // d = B^-1 u / (u^T B^-1 u) delta is the cheapest way to change the norm by delta.
        let factors = Factors::new(&penalised(&self.quadric, stiffness * LAMBDA), 0.0);
        let along = factors.map_or(0.0, |f| f.solve(self.direction).dot(self.direction));
        if !(along > 0.0 && along.is_finite()) {
            return 0.0;
        }
        // The mean over the planes rather than their sum: how many triangles a vertex has says
        // nothing about what its move costs. (Weighting by the triangles' area was tried too: 14 %
        // to 19 % worse on bunny, nefertiti and rocker-arm.)
        along * self.quadric.trace()
    }
}

/// The pliancy of every carrier about `centre`; `None` once `stop` answers `true`.
#[must_use]
pub fn pliancies(
    surface: &Surface,
    quadrics: &[Quadric],
    centre: DVec3,
    stop: Stop<'_>,
) -> Option<Vec<Pliancy>> {
    mapped(quadrics, stop, |carrier, &quadric| Pliancy {
        quadric,
        direction: (surface.positions[carrier] - centre).normalize_or_zero(),
    })
}
