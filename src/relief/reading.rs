//! The reading of a suspect against a host: one signed weight per cell, from suspect and host alone.
//! The signs of any number of marks are scored against it.

use glam::DVec3;

use super::estimate::{Estimate, Sample, estimate};
use super::heights::{Height, Work, heights};
use super::host::ReliefHost;
use super::refine::refined;
use super::regress::{Rest, regress};
use super::signs::Signs;
use crate::mesh::surface::Surface;
use crate::watermark::{least_chernoff_score, log10_tail};

/// Heights are clipped at this many local deviations.
const CLIP: f64 = 3.0;

/// Side of the boxes within which a deviation is local, in cells.
const BOX: f64 = 1.5;

/// The weight of a cell is at most this many times the root mean square of all. The median would not
/// serve as the unit: where vertices are farther apart than cells, the weights of most cells are small.
const CAP: f64 = 4.0;

/// The unexplained share of a cell's variance counts as at least this much; its root divides the
/// weight.
const LEAST_UNEXPLAINED: f64 = 1e-3;

/// Tests of the search tree that a reading may make, and how many more per vertex and triangle of
/// suspect and host. A test takes 15 ns; ordinary surfaces need a third of this.
const TESTS: u64 = 3_000_000;
const TESTS_PER_ELEMENT: u64 = 100;

/// Fewer samples than this of one kind are not used.
const LEAST_SAMPLES: usize = 32;

/// Cells that are scored together.
const NIBBLE: usize = 4;

/// Signed weights, one per cell of the host.
#[derive(Debug, Clone)]
pub struct ReliefReading {
    weights: Vec<f64>,
    /// Per four cells, what each of the 16 patterns of their signs adds to a score.
    sums: Vec<[f64; 1 << NIBBLE]>,
}

impl ReliefReading {
    /// Reads a suspect whose carriers lie at `positions`, in the host's coordinates. `mirrored` says
    /// whether the move to these coordinates turned the surface inside out. `amplitude` is that of the
    /// marks to be read, as a share of the diagonal. The number of tests is bounded by the sizes of
    /// host and suspect ([`Self::most_tests`]). `None` where the suspect is nowhere near the host, or
    /// once `stop` answers `true`.
    #[must_use]
    pub fn new(
        host: &ReliefHost,
        suspect: &Surface,
        positions: &[DVec3],
        mirrored: bool,
        amplitude: f64,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Self> {
        let mut work = Work::new(Self::most_tests(host, suspect), stop);
        Self::within(host, suspect, (positions, mirrored), amplitude, &mut work)
    }

    /// Limit of the tests of the search tree, from the sizes of host and suspect.
    #[must_use]
    pub fn most_tests(host: &ReliefHost, suspect: &Surface) -> u64 {
        let elements = suspect.positions.len()
            + suspect.triangles.len()
            + host.tree.points().len()
            + host.tree.triangles().len();
        TESTS + TESTS_PER_ELEMENT * elements as u64
    }

    /// As [`Self::new`], with as many tests as `work` has left; `work` counts them.
    #[must_use]
    pub fn within(
        host: &ReliefHost,
        suspect: &Surface,
        (positions, mirrored): (&[DVec3], bool),
        amplitude: f64,
        work: &mut Work<'_>,
    ) -> Option<Self> {
        let stop = work.stop;
        let positions = refined(host, suspect, positions, mirrored, work)?;
        let kinds = heights(host, suspect, &positions, mirrored, work)?;
        let mut samples: Vec<Sample<'_>> = Vec::new();
        for kind in kinds.iter().filter(|kind| kind.all.len() >= LEAST_SAMPLES) {
            let rest = regress(host, &kind.all, None);
            samples.extend(weighted(host, &kind.all, &rest, kind.distinct));
            if stop() {
                return None;
            }
        }
        if samples.is_empty() {
            return None;
        }
        let size = host.field.size(amplitude);
        let Estimate { values, explained } = estimate(host, &samples, size);
        let weight = |(x, r): (&f64, f64)| x / size / (1.0 - r).max(LEAST_UNEXPLAINED).sqrt();
        let weights = values.iter().zip(explained).map(weight).collect();
        (!stop()).then(|| Self::weighted(weights))
    }

    /// A reading from weights before they are capped. A value that is not finite counts as zero.
    fn weighted(mut weights: Vec<f64>) -> Self {
        for z in &mut weights {
            *z = if z.is_finite() { *z } else { 0.0 };
        }
        cap(&mut weights);
        let sums = weights
            .chunks(NIBBLE)
            .map(|four| {
                std::array::from_fn(|pattern| {
                    let signed =
                        |(k, z): (usize, &f64)| if pattern >> k & 1 == 1 { *z } else { -z };
                    four.iter().enumerate().map(signed).sum()
                })
            })
            .collect();
        Self { weights, sums }
    }

    /// One signed weight per cell; zero where nothing was read.
    #[must_use]
    pub fn signed_weights(&self) -> &[f64] {
        &self.weights
    }

    /// `sum_c z_c s_c`.
    #[must_use]
    pub fn score(&self, signs: &Signs) -> f64 {
        let halves = signs.bytes().flat_map(|byte| [byte & 15, byte >> 4]);
        let both = self.sums.iter().zip(halves);
        both.map(|(sums, half)| sums.get(usize::from(half)).copied().unwrap_or(0.0)).sum()
    }

    /// A score in standard deviations of the scores of fresh signs.
    #[must_use]
    pub fn deviations(&self, score: f64) -> f64 {
        let squares: f64 = self.weights.iter().map(|z| z * z).sum();
        score / squares.sqrt().max(f64::MIN_POSITIVE)
    }

    /// The number of cells that were read, and the number of those whose sign agrees.
    #[must_use]
    pub fn agreeing(&self, signs: &Signs) -> (usize, usize) {
        let read = (0..).zip(&self.weights).filter(|(_, z)| **z != 0.0);
        let count = |(read, agreeing), (cell, z): (u32, &f64)| {
            (read + 1, agreeing + usize::from(*z * signs.sign(cell) > 0.0))
        };
        read.fold((0, 0), count)
    }

    /// log10 of a bound on the probability that fresh signs have this score or more.
    #[must_use]
    pub fn log10_bound(&self, score: f64) -> f64 {
        log10_tail(&self.weights, score)
    }

    /// A score below which no bound is at or below `log10_bound`; `None` where no score reaches that
    /// bound.
    #[must_use]
    pub fn least_score(&self, log10_bound: f64) -> Option<f64> {
        // The bound of few weights is the exact tail, which is below Chernoff's bound by less than
        // this.
        const EXACT: f64 = 3.0;
        least_chernoff_score(&self.weights, (log10_bound + EXACT).min(0.0))
    }
}

fn cap(weights: &mut [f64]) {
    let read = weights.iter().filter(|&&z| z != 0.0);
    let (count, squares) = read.fold((0.0, 0.0), |(n, sum), z| (n + 1.0, sum + z * z));
    if count > 0.0 {
        let most = CAP * (squares / count).sqrt();
        for z in weights {
            *z = z.clamp(-most, most);
        }
    }
}

/// Clipped heights, weighted by the spread of the heights around them.
fn weighted<'a>(
    host: &ReliefHost,
    all: &'a [Height],
    rest: &Rest,
    distinct: f64,
) -> Vec<Sample<'a>> {
    /// The median of sizes in standard deviations, and the factor from a mean of sizes to a standard
    /// deviation.
    const MEDIAN: f64 = 0.67;
    const MEAN: f64 = 1.25;
    /// Number of points with the overall deviation that every box is given beforehand.
    const BEFOREHAND: f64 = 4.0;
    let side = BOX * host.field.cells().side();
    let low = host.low - DVec3::splat(side);
    let mut order: Vec<(u64, u32)> =
        (0..).zip(all).map(|(k, of)| (box_of(of.foot, low, side), k)).collect();
    order.sort_unstable();
    let deviation = rest.deviation;
    let mut samples: Vec<Sample<'a>> = Vec::with_capacity(all.len());
    for same in order.chunk_by(|a, b| a.0 == b.0) {
        let size =
            |&(_, k): &(u64, u32)| rest.heights[k as usize].abs().min(2.0 * CLIP * deviation);
        let sum: f64 = same.iter().map(size).sum();
        let count = same.len() as f64 + BEFOREHAND;
        let local = MEAN * (sum + BEFOREHAND * MEDIAN * deviation) / count;
        let weight = distinct / (local * local + EXACT * EXACT);
        for &(_, k) in same {
            let height = rest.heights[k as usize].clamp(-CLIP * local, CLIP * local);
            samples.push(Sample { of: &all[k as usize], height, weight });
        }
    }
    samples
}

/// Heights are taken to be no more exact than this share of the diagonal: the rounding of a
/// single-precision coordinate.
const EXACT: f64 = 1e-7;

/// The index of the box of side `side` that a point lies in.
fn box_of(p: DVec3, low: DVec3, side: f64) -> u64 {
    let at = ((p - low) / side).floor().as_ivec3();
    let axis = |x: i32| u64::from(u32::try_from(x.max(0)).unwrap_or(0)) & 0x1f_ffff;
    axis(at.x) << 42 | axis(at.y) << 21 | axis(at.z)
}

#[cfg(test)]
mod tests;
