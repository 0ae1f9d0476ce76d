//! How cheaply each vertex can change its norm (method section 3).
//!
//! Quadrics and directions come from the original mesh and its centre. They are computed once.
//!
//! Absent: a limit on how far a vertex may go. A limit at a share of the heights of its triangles was
//! tried, to keep triangles from turning over. On a dense, noisy mesh such limits differ as much
//! between neighbours as the heights do, and the uneven moves turned thousands of triangles over: 6,754
//! of the dragon's triangles, at twice the distortion. Module `guard` keeps triangles from turning
//! over.

use glam::DVec3;

use super::exact::{Factors, LAMBDA, penalised};
use crate::mesh::quadric::Quadric;
use crate::mesh::stop::{Stop, mapped};
use crate::mesh::surface::Surface;

/// What the compliance of one carrier is computed from.
#[derive(Debug, Clone, Copy)]
pub struct ComplianceData {
    quadric: Quadric,
    /// From the centre to the carrier, a unit vector.
    direction: DVec3,
}

impl ComplianceData {
    /// The compliance `g`: changing the norm by `delta` costs `delta^2 / g`. Plain displacement is
    /// penalised by `stiffness` times the usual `lambda` (method section 4).
    #[must_use]
    pub fn at(&self, stiffness: f64) -> f64 {
        // d = B^-1 u / (u^T B^-1 u) delta is the cheapest way to change the norm by delta.
        let factors = Factors::new(&penalised(&self.quadric, stiffness * LAMBDA), 0.0);
        let along = factors.map_or(0.0, |f| f.solve(self.direction).dot(self.direction));
        if !(along > 0.0 && along.is_finite()) {
            return 0.0;
        }
        // The mean over the planes rather than their sum: the number of triangles at a vertex does not
        // change what its move costs. Weights by the areas of the triangles were tried too: 14 % to
        // 19 % worse on bunny, nefertiti and rocker-arm.
        along * self.quadric.trace()
    }
}

/// The pliancy of every carrier about `centre`; `None` once `stop` answers `true`.
#[must_use]
pub fn compliance_data(
    surface: &Surface,
    quadrics: &[Quadric],
    centre: DVec3,
    stop: Stop<'_>,
) -> Option<Vec<ComplianceData>> {
    mapped(quadrics, stop, |carrier, &quadric| ComplianceData {
        quadric,
        direction: (surface.positions[carrier] - centre).normalize_or_zero(),
    })
}
