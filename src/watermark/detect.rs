//! Detection: how strongly a suspect's bins agree with one known codeword, and a bound on the
//! probability that any file not carrying it would agree so well (method section 7).
//!
//! The bound needs no model of meshes. A codeword is drawn uniformly and independently of the
//! suspect, so whatever the suspect's bins say, each of their signs agrees with a fresh codeword
//! with probability one half. Nothing here that enters a weight may depend on a codeword.

use glam::DVec3;
use rayon::prelude::*;

use super::bins::{BinStatistic, Frame, Lattice, norms};
use super::{BitCount, Codeword, Modulation, WatermarkError};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;

/// A suspect in one frame: its norms sorted, with prefix sums, so that the statistics of all
/// bins of one lattice cost 2 M binary searches whatever the mesh size.
#[derive(Debug, Clone)]
pub struct Suspect {
    frame: Frame,
    positions: Vec<DVec3>,
    sorted: Vec<f64>,
    /// Sums over the first k sorted norms of `rho - middle` and its square; the middle of the
    /// range is subtracted so that nothing cancels.
    sums: Vec<[f64; 2]>,
    middle: f64,
}

impl Suspect {
    /// The suspect in its own, blind frame.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn new(mesh: &Mesh) -> Result<Self, WatermarkError> {
        let surface = Surface::new(mesh);
        let centre = surface.centre();
        let norms = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &norms);
        if frame.radial_extent() > 0.0 {
            Ok(Self::sort(frame, surface.positions, norms))
        } else {
            Err(WatermarkError::NoRadialExtent { vertices: norms.len() })
        }
    }

    /// The same suspect as seen in a known frame, in place: the frame's centre and range instead
    /// of its own.
    #[must_use]
    pub fn in_frame(&self, frame: &Frame) -> Self {
        let norms = norms(&self.positions, frame.centre);
        Self::sort(*frame, self.positions.clone(), norms)
    }

    /// The frame that is assumed.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// How many carrier vertices there are.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.positions.len()
    }

    fn sort(frame: Frame, positions: Vec<DVec3>, mut norms: Vec<f64>) -> Self {
        norms.par_sort_unstable_by(f64::total_cmp);
        let middle = f64::midpoint(frame.rho_min, frame.rho_max);
        let mut sums = Vec::with_capacity(norms.len() + 1);
        let mut sum = [0.0, 0.0];
        sums.push(sum);
        for rho in &norms {
            let from_middle = rho - middle;
            sum = [sum[0] + from_middle, sum[1] + from_middle * from_middle];
            sums.push(sum);
        }
        Self { frame, positions, sorted: norms, sums, middle }
    }

    /// The statistics of all bins of a lattice.
    fn statistics(&self, lattice: &Lattice, modulation: Modulation) -> Vec<BinStatistic> {
        let below = |rho: f64| self.sorted.partition_point(|&norm| norm < rho);
        let mut low = below(lattice.norm_at(0, 0.0));
        (0..lattice.bins)
            .map(|bin| {
                let high = below(lattice.norm_at(bin, 1.0)).max(low);
                let count = high - low;
                let [first, second] =
                    std::array::from_fn(|k| self.sums[high][k] - self.sums[low][k]);
                low = high;
                if count == 0 {
                    return BinStatistic::default();
                }
                let n = count as f64;
                let value = match modulation {
                    Modulation::Mean => {
                        let start = lattice.norm_at(bin, 0.0) - self.middle;
                        (first / n - start) / lattice.width
                    }
                    Modulation::Variance => {
                        let centre = lattice.norm_at(bin, 0.5) - self.middle;
                        let squares = second / n - 2.0 * centre * first / n + centre * centre;
                        4.0 * squares / (lattice.width * lattice.width)
                    }
                };
                BinStatistic { count, value }
            })
            .collect()
    }

    /// The soft bits of a lattice class.
    #[must_use]
    pub fn read(&self, class: u8, bits: BitCount, modulation: Modulation) -> SoftBits {
        let statistics = Lattice::new(&self.frame, class, bits).map_or_else(
            || vec![BinStatistic::default(); bits.get()],
            |lattice| self.statistics(&lattice, modulation),
        );
        SoftBits::new(&statistics, modulation)
    }
}

/// Per bin a sign and a weight.
#[derive(Debug, Clone, PartialEq)]
pub struct SoftBits {
    /// `w_i sign(z_i)`, zero for an erasure.
    signed_weights: Vec<f64>,
}

/// How well a codeword fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// `T = sum_i w_i sign(z_i) c_i`.
    pub t: f64,
    /// Bins whose sign agrees.
    pub bits_agreeing: usize,
    /// Bins that were read.
    pub bits_read: usize,
}

impl SoftBits {
    /// `z_i = sqrt(n_i) (statistic - neutral)`, `w_i = min(|z_i|, median |z|)`: the cap keeps a
    /// few crowded bins from outvoting all others.
    fn new(statistics: &[BinStatistic], modulation: Modulation) -> Self {
        let z: Vec<f64> = statistics
            .iter()
            .map(|s| {
                let read = if s.is_erasure() { 0.0 } else { s.value - modulation.neutral() };
                (s.count as f64).sqrt() * read
            })
            .collect();
        Self::weighted(z)
    }

    /// From `z_i`, positive for a one, zero for an erasure; what is no number counts as one.
    #[must_use]
    pub fn weighted(mut z: Vec<f64>) -> Self {
        for z in &mut z {
            *z = if z.is_finite() { *z } else { 0.0 };
        }
        let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).filter(|&z| z > 0.0).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let cap = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        Self { signed_weights: z.iter().map(|z| z.clamp(-cap, cap)).collect() }
    }

    /// Scores one codeword of the same number of bits.
    #[must_use]
    pub fn score(&self, codeword: &Codeword) -> Score {
        let start = Score { t: 0.0, bits_agreeing: 0, bits_read: 0 };
        self.signed_weights.iter().zip(codeword.bits()).fold(start, |mut score, (&w, &bit)| {
            score.t += if bit { w } else { -w };
            score.bits_read += usize::from(w != 0.0);
            score.bits_agreeing += usize::from(w != 0.0 && (w > 0.0) == bit);
            score
        })
    }

    /// The signed weights, one per bin.
    #[must_use]
    pub fn signed_weights(&self) -> &[f64] {
        &self.signed_weights
    }

    /// Decimal logarithm of a bound on the probability that a codeword drawn at random scores
    /// `t` or more: one hypothesis, nothing counted yet.
    #[must_use]
    pub fn log10_bound(&self, t: f64) -> f64 {
        log10_chernoff(&self.signed_weights, t)
    }
}

/// `log10 min_{s > 0} exp(sum_i ln cosh(s w_i) - s t)`: the Chernoff bound on
/// `P(sum_i +/- w_i >= t)` with fair, independent signs. Weights enter by their size; zero
/// weights are erasures. At full agreement it is `-n log10 2`, the exact probability.
///
/// Every `s` gives a valid bound, so the minimum need not be found exactly.
#[must_use]
pub fn log10_chernoff(weights: &[f64], t: f64) -> f64 {
    let total: f64 = weights.iter().map(|w| w.abs()).sum();
    if !(t > 0.0 && total > 0.0) {
        return 0.0;
    }
    let full = -(weights.iter().filter(|&&w| w != 0.0).count() as f64) * std::f64::consts::LOG10_2;
    // The infimum lies at s = infinity; rounding may hide that t is the whole sum.
    if t >= total * (1.0 - 1e-12) {
        return full;
    }
    let slope = |s: f64| weights.iter().map(|w| w.abs() * libm::tanh(s * w.abs())).sum::<f64>() - t;
    let value = |s: f64| {
        let log_cosh = |x: f64| x + libm::log1p(libm::exp(-2.0 * x)) - std::f64::consts::LN_2;
        weights.iter().map(|w| log_cosh(s * w.abs())).sum::<f64>() - s * t
    };
    // The slope grows from -t at 0 to total - t > 0: double, then bisect.
    let mean = total / weights.len() as f64;
    let (mut low, mut high) = (0.0, 1.0 / mean);
    for _ in 0..60 {
        if slope(high) > 0.0 {
            break;
        }
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if slope(middle) > 0.0 { high = middle } else { low = middle }
    }
    (value(f64::midpoint(low, high)) * std::f64::consts::LOG10_E).clamp(full, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;
    use crate::watermark::bins;

    #[test]
    #[expect(clippy::float_cmp, reason = "no evidence is exactly zero")]
    fn full_agreement_is_two_to_the_minus_m_and_no_agreement_is_no_evidence() {
        for (n, weight) in [(64, 1.0), (16, 0.003), (256, 7.0)] {
            let weights = vec![weight; n];
            let full = log10_chernoff(&weights, weight * n as f64);
            assert!((full + n as f64 * std::f64::consts::LOG10_2).abs() < 1e-9);
            assert_eq!(log10_chernoff(&weights, 0.0), 0.0);
            assert_eq!(log10_chernoff(&weights, -3.0), 0.0);
        }
        assert_eq!(log10_chernoff(&[], 1.0), 0.0);
        assert_eq!(log10_chernoff(&[0.0; 4], 1.0), 0.0);
    }

    #[test]
    fn the_bound_is_above_the_exact_tail_and_below_hoeffding() {
        // All 2^14 sign patterns of uneven weights.
        let weights: Vec<f64> = (0..14).map(|i| 0.2 + f64::from(i % 5)).collect();
        let total: f64 = weights.iter().sum();
        let energy: f64 = weights.iter().map(|w| w * w).sum();
        for share in [0.1, 0.3, 0.5, 0.8, 0.95, 1.0] {
            let t = share * total;
            let sums = (0..1_u32 << 14).map(|signs| -> f64 {
                weights
                    .iter()
                    .enumerate()
                    .map(|(i, w)| if signs >> i & 1 == 1 { *w } else { -w })
                    .sum()
            });
            let tail = sums.filter(|&s| s >= t - 1e-9).count() as f64 / f64::from(1 << 14);
            let bound = log10_chernoff(&weights, t);
            assert!(bound >= tail.log10() - 1e-9, "{share}: {bound} < {}", tail.log10());
            assert!(bound <= -t * t / (2.0 * energy) * std::f64::consts::LOG10_E + 1e-9, "{share}");
        }
    }

    #[test]
    fn prefix_sums_agree_with_the_direct_statistics() {
        let mesh = Sample::Blob.mesh(9000).unwrap();
        let suspect = Suspect::new(&mesh).unwrap();
        let surface = Surface::new(&mesh);
        let norms = norms(&surface.positions, surface.centre());
        for class in [0, 100, 255] {
            for modulation in [Modulation::Mean, Modulation::Variance] {
                let lattice = Lattice::new(&suspect.frame, class, BitCount::default()).unwrap();
                let direct = bins::statistics(&norms, &lattice, modulation);
                for (a, b) in suspect.statistics(&lattice, modulation).iter().zip(&direct) {
                    assert_eq!(a.count, b.count);
                    assert!((a.value - b.value).abs() < 1e-9, "{a:?} {b:?}");
                }
            }
        }
    }
}
