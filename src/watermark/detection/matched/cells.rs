//! Bits of a quantised suspect, read from the cells of its grid that vertices fell into.
//!
//! The moves of a mark are tiny compared with the steps of a coarse grid. Nearly all vertices fall into
//! the same cell whether their bit is one or zero, and their residuals are then no evidence. The few
//! vertices near the edge of a cell are strong evidence. Per vertex and axis, the evidence is the
//! logarithm of how much likelier a one makes the cell than a zero does. It is summed per bin.
//!
//! Measured on ten meshes with two keys each, quantised in place to 7, 6, 5 and 4 bits: 19 of 20, 19 of
//! 20, 19 of 20 and 8 of 10 marks are recognised. Without the cells it is 19 of 20, 8, 4 and 0 of 10.
//! The relief is far smaller than such steps and reads none below 7 bits.
//!
//! Nothing here may depend on the codeword (I4). Edges and errors are judged by how well ones and zeros
//! together explain the cells.

use std::f64::consts::SQRT_2;

use rayon::prelude::*;

use super::grid::Grid;
use super::{Correspondence, HostFilter, median};
use crate::mesh::stop::{Stop, mapped};
use crate::watermark::SoftBits;

/// Standard error of a predicted displacement along an axis, as a share of the distance from a zero to
/// a one. Cells of exact-mean marks on a bunny, a horse, nefertiti, an armadillo and a rocker arm on
/// grids of 3 to 5 bits are explained best by 0.02 (smaller values were not tried) and hardly worse by
/// 0.1. No bound at 4 or 5 bits changes by more than 1.1 decades from 0.02 to 0.4.
const PREDICTION_ERROR: f64 = 0.05;

/// Probability that a vertex is a stray, which may be in any cell. No bound at 4 or 5 bits changes by
/// more than 0.3 decades from 0.001 to 0.05.
const STRAY: f64 = 0.01;

/// Values tried for the noise that was added to the suspect before it was quantised, in steps.
const ROUGH: [f64; 10] = [0.0, 0.004, 0.008, 0.016, 0.031, 0.063, 0.125, 0.25, 0.5, 1.0];

/// From this noise on, residuals are as good evidence as cells.
const TOO_ROUGH: f64 = 1.0;

/// `erfc` of this value is far below [`STRAY`].
const SURE: f64 = 4.0;

/// Largest number of vertices that judge the noise.
const JUDGES: usize = 5000;

/// A grid whose steps are shorter than this many times the typical distance from a zero to a one counts
/// as no grid.
const FINEST_STEP: f64 = 1.0;

/// Where levels may lie in their cells, in steps above the middle: coordinates rounded to nearest, cut
/// off, rounded up.
const SHIFTS: [f64; 3] = [0.0, -0.5, 0.5];

/// A vertex whose predicted position is more than this many steps off does not help to find where
/// levels lie in their cells.
const FARTHEST_LEVEL: f64 = 1.5;

/// A cell along one axis, and the coordinates predicted for a zero and for a one.
struct Cell {
    low: f64,
    high: f64,
    zero: f64,
    one: f64,
    /// Standard error of the prediction.
    error: f64,
    step: f64,
}

impl Cell {
    /// The probabilities that a zero and a one fall into this cell.
    fn likelihoods(&self, rough: f64) -> [f64; 2] {
        let spread = libm::hypot(self.error, rough * self.step) * SQRT_2;
        [self.zero, self.one].map(|at| {
            // The probability of being below an edge; `erfc` is not computed where it is 0 or 1 in any
            // case.
            let below = |edge: f64| match (at - edge) / spread {
                far if far > SURE => 0.0,
                far if far < -SURE => 1.0,
                near => 0.5 * libm::erfc(near),
            };
            below(self.high) - below(self.low) + STRAY
        })
    }
}

/// What all cells are computed from.
struct CellModel<'a> {
    filter: &'a HostFilter,
    grid: &'a Grid,
}

impl CellModel<'_> {
    /// The cell of a vertex along an axis, for levels that lie `shift` steps above the middle of their
    /// cells. `None` when the vertex lies between levels or its bit does not move it.
    fn cell(&self, s: &Correspondence, k: usize, shift: f64) -> Option<Cell> {
        let carrier = s.carrier as usize;
        let difference = self.filter.difference[carrier];
        let error = PREDICTION_ERROR * difference.length();
        let (axis, levels) = (self.grid.axes[k], self.grid.levels[k]?);
        let centre = levels.snapped(s.at.dot(axis))? - shift * levels.step;
        let (at, half) = (self.filter.middle[carrier].dot(axis), 0.5 * difference.dot(axis));
        error.is_normal().then_some(Cell {
            low: centre - 0.5 * levels.step,
            high: centre + 0.5 * levels.step,
            zero: at - half,
            one: at + half,
            error,
            step: levels.step,
        })
    }

    /// The cells of a vertex along all axes.
    fn cells(&self, s: &Correspondence, shifts: [f64; 3]) -> impl Iterator<Item = Cell> {
        (0..3).filter_map(move |k| self.cell(s, k, shifts[k]))
    }

    /// The shift along an axis that explains the cells best: one of [`SHIFTS`], or the mean shift that
    /// is observed.
    fn shift(&self, judges: &[&Correspondence], k: usize) -> f64 {
        let off = |s: &&Correspondence| {
            let cell = self.cell(s, k, 0.0)?;
            let off = 0.5 * ((cell.low - cell.zero) + (cell.high - cell.one)) / cell.step;
            (off.abs() <= FARTHEST_LEVEL).then_some(off)
        };
        let seen: Vec<f64> = judges.iter().filter_map(off).collect();
        let mean = seen.iter().sum::<f64>() / seen.len().max(1) as f64;
        let fit = |shift: f64| {
            let cells: Vec<Cell> = judges.iter().filter_map(|s| self.cell(s, k, shift)).collect();
            best_noise(&cells).0
        };
        let mut best = (f64::NEG_INFINITY, 0.0);
        for shift in SHIFTS.into_iter().chain([mean]) {
            let fit = fit(shift);
            if fit > best.0 {
                best = (fit, shift);
            }
        }
        best.1
    }
}

impl HostFilter {
    /// Per bin how much likelier a one is than a zero, for a suspect on a grid. `None` where cells are
    /// no better evidence than residuals, or once `stop` answers `true`.
    pub(super) fn by_cells(
        &self,
        correspondences: &[Correspondence],
        grid: &Grid,
        stop: Stop<'_>,
    ) -> Option<SoftBits> {
        let judges: Vec<&Correspondence> =
            correspondences.iter().step_by((correspondences.len() / JUDGES).max(1)).collect();
        let ways = judges.iter().map(|s| self.difference[s.carrier as usize].length());
        let way = median(ways.filter(|&way| way > 0.0).collect());
        if grid.levels.iter().flatten().all(|levels| levels.step <= FINEST_STEP * way) {
            return None;
        }
        let view = CellModel { filter: self, grid };
        let shifts = [0, 1, 2].map(|k| view.shift(&judges, k));
        let cells: Vec<Cell> = judges.into_iter().flat_map(|s| view.cells(s, shifts)).collect();
        let rough = best_noise(&cells).1;
        if rough >= TOO_ROUGH {
            return None;
        }
        let evidence = |_, s: &Correspondence| -> f64 {
            let ratio = |cell: Cell| {
                let [zero, one] = cell.likelihoods(rough);
                libm::log(one / zero)
            };
            view.cells(s, shifts).map(ratio).sum()
        };
        let evidence = mapped(correspondences, stop, evidence)?;
        let mut sums = vec![0.0; self.bits.get()];
        for (s, evidence) in correspondences.iter().zip(evidence) {
            if let Some(sum) = sums.get_mut(usize::from(self.bins[s.carrier as usize])) {
                *sum += evidence;
            }
        }
        Some(SoftBits::weighted(sums))
    }
}

/// The best fit of any noise of [`ROUGH`], and that noise. The fit is the logarithm of the likelihood
/// of the cells, by ones and zeros together.
fn best_noise(cells: &[Cell]) -> (f64, f64) {
    let fit = |&rough: &f64| -> f64 {
        cells.iter().map(|cell| libm::log(cell.likelihoods(rough).iter().sum())).sum()
    };
    let fits: Vec<f64> = ROUGH.par_iter().map(fit).collect();
    let all = fits.into_iter().zip(ROUGH);
    all.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::super::comparison::Comparison;
    use super::super::grid_of;
    use super::super::tests::{Marked, bound, marked};
    use super::*;
    use crate::mesh::stop::never;
    use crate::sample::Sample;
    use crate::watermark::Method;

    type Snap = fn(f64) -> f64;

    /// Correspondences of a mark that is turned, put by `snap` on a grid of `steps` steps along its
    /// longest side, and turned back.
    fn seen(
        marked: &Marked,
        filter: &HostFilter,
        turned: DQuat,
        steps: f64,
        snap: Snap,
    ) -> Vec<Correspondence> {
        let carriers = filter.surface().first_vertex.iter();
        let all: Vec<DVec3> =
            carriers.map(|&v| turned.inverse() * marked.positions[v as usize]).collect();
        let low = all.iter().copied().reduce(DVec3::min).unwrap();
        let high = all.iter().copied().reduce(DVec3::max).unwrap();
        let step = (high - low).max_element() / steps;
        let snapped = |p: DVec3| {
            let levels = ((p - low) / step).to_array().map(snap);
            (low + step * DVec3::from_array(levels)).as_vec3().as_dvec3()
        };
        (0..)
            .zip(all)
            .map(|(carrier, p)| Correspondence { carrier, at: turned * snapped(p) })
            .collect()
    }

    #[test]
    fn a_mark_is_read_from_the_cells_of_coarse_grids() {
        let turned = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.3, -0.8);
        let still = DQuat::IDENTITY;
        let table: [(f64, DQuat, Snap); 6] = [
            (255.0, still, f64::round),
            (63.0, still, f64::round),
            (31.0, still, f64::round),
            (31.0, still, f64::floor),
            (31.0, still, f64::ceil),
            (31.0, turned, f64::round),
        ];
        for sample in Sample::ALL {
            let marked = marked(sample, Method::ExactMean);
            let class = marked.codeword.layout_class();
            let filter = HostFilter::new(&marked.host, class, &marked.params).unwrap();
            let bound = |soft: &SoftBits| soft.log10_bound(soft.score(&marked.codeword).t);
            for (steps, turned, snap) in table {
                let correspondences = seen(&marked, &filter, turned, steps, snap);
                let grid = grid_of(&correspondences, turned, &never);
                assert!(grid.is_some(), "{sample} {steps}");
                let cells = bound(&filter.compare(&correspondences, Some(turned)).alone());
                let residuals = bound(
                    &Comparison::after(&filter, &correspondences, 0, &filter.middle, &never)
                        .alone(),
                );
                // With `floor`, the flat sides of the gear are the edges of cells.
                assert!(cells < -10.0, "{sample} {steps}: {cells}");
                assert!(cells <= residuals + 1e-9, "{sample} {steps}: {cells} {residuals}");
            }
        }
    }

    #[test]
    fn roughness_before_the_grid_is_found() {
        let cell = |rough: f64, k: u32| {
            // Evenly spread quantiles of a normal distribution about where the vertex was.
            let even = f64::from(k % 97) / 97.0 + 0.005;
            let off = rough * (even / (1.0 - even)).ln() / 1.702;
            let at = f64::from(k) * 0.618;
            let low = (at + off).floor();
            Cell { low, high: low + 1.0, zero: at - 1e-3, one: at + 1e-3, error: 1e-4, step: 1.0 }
        };
        for (rough, found) in [(0.0, 0.0), (0.03, 0.031), (0.25, 0.25), (1.5, TOO_ROUGH)] {
            let cells: Vec<Cell> = (0..20_000).map(|k| cell(rough, k)).collect();
            assert!((best_noise(&cells).1 - found).abs() < 1e-12, "{rough}");
        }
    }

    #[test]
    fn an_unmarked_host_on_a_grid_says_nothing() {
        let marked = marked(Sample::Blob, Method::ExactMean);
        let size = marked.positions.iter().map(|p| p.length()).fold(0.0, f64::max);
        for steps in [15.0, 31.0, 127.0] {
            let step = size / steps;
            let snapped = |v: usize| (marked.host.positions()[v] / step).round() * step;
            let host = bound(&marked, |v, _| Some(snapped(v))).0;
            assert!(host > -4.0, "{steps}: {host}");
        }
    }
}
