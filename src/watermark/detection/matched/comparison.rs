//! A suspect compared with the filter of one layout class: the bits of one mark.
//!
//! Absent: a joint estimate of several marks. Copies that several recipients averaged, and overmarked
//! meshes, are read from the relief.

use glam::{DQuat, DVec3};

use super::estimate::Normal;
use super::smoothing_search::SmoothingFit;
use super::{Correspondence, HostFilter, grid_of};
use crate::mesh::stop::Stop;
use crate::watermark::SoftBits;

/// A suspect, ready to be read.
#[derive(Debug)]
pub struct Comparison {
    rounds: usize,
    normal: Normal,
    /// The correlations `t`.
    along: Vec<f64>,
    /// The soft bits of the cells, for a suspect on a coarse grid.
    cells: Option<SoftBits>,
}

impl Comparison {
    pub(super) fn new(
        filter: &HostFilter,
        correspondences: &[Correspondence],
        turned: Option<DQuat>,
        stop: Stop<'_>,
    ) -> Self {
        let SmoothingFit { rounds, middle, nudge } =
            filter.best_smoothing(correspondences, turned.is_some(), stop);
        if rounds > 0 {
            let at = |s: &Correspondence| Correspondence { at: nudge.apply(s.at), ..*s };
            let correspondences: Vec<Correspondence> = correspondences.iter().map(at).collect();
            return Self::after(filter, &correspondences, rounds, &middle, stop);
        }
        let grid = grid_of(correspondences, turned.unwrap_or_default(), stop);
        let cells = grid.and_then(|grid| filter.by_cells(correspondences, &grid, stop));
        Self { cells, ..Self::after(filter, correspondences, rounds, &middle, stop) }
    }

    /// The comparison with a suspect smoothed in this many rounds, which took the filter's middle to
    /// `middle`. The result must be discarded once `stop` answers `true`.
    pub(super) fn after(
        filter: &HostFilter,
        correspondences: &[Correspondence],
        rounds: usize,
        middle: &[DVec3],
        stop: Stop<'_>,
    ) -> Self {
        // Without weights, no correspondence is used.
        let weights = filter.weights(correspondences, rounds, middle, stop).unwrap_or_default();
        let mut rest = vec![DVec3::ZERO; middle.len()];
        let mut seen = vec![0.0; middle.len()];
        for (Correspondence { carrier, at }, weight) in correspondences.iter().zip(&weights) {
            let carrier = *carrier as usize;
            rest[carrier] = *at - middle[carrier];
            seen[carrier] = *weight;
        }
        let seen = if stop() { Vec::new() } else { seen };
        let weighted: Vec<DVec3> = rest.iter().zip(&seen).map(|(r, w)| *w * *r).collect();
        let noise = weighted.iter().map(|rest| rest.length_squared()).sum::<f64>();
        let noise = noise / (3.0 * seen.iter().sum::<f64>().max(1.0));
        let along = filter.along(&filter.smoothing().adjoint_until(weighted, rounds, stop));
        let gram = filter.gram(&seen, rounds, filter.apart(rounds), stop);
        let normal = Normal::new(gram, along.len(), noise);
        Self { rounds, normal, along, cells: None }
    }

    /// The estimated number of rounds of smoothing that the suspect went through.
    #[must_use]
    pub fn rounds(&self) -> usize {
        self.rounds
    }

    /// The soft bits of this mark.
    #[must_use]
    pub fn alone(&self) -> SoftBits {
        match &self.cells {
            Some(soft) => soft.clone(),
            None => SoftBits::weighted(self.normal.solve(&self.along)),
        }
    }
}
