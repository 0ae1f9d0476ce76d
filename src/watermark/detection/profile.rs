//! The radial profile of a suspect: its norms about one centre, sorted, with prefix sums. The
//! statistics of all bins of any bin layout then cost 2 M binary searches, whatever the size of the
//! mesh.
//!
//! Must not know how centres and bin layouts are chosen.

use glam::DVec3;

use crate::mesh::stop::{STEP, Stop, go_on, sorted, unstopped};
use crate::watermark::bins::{BinLayout, BinStatistic, Frame, norms};
use crate::watermark::{BitCount, Modulation, SoftBits};

/// Sorted norms with prefix sums, in a frame.
#[derive(Debug, Clone)]
pub struct Profile {
    frame: Frame,
    sorted: Vec<f64>,
    /// Sums of `rho - middle` and of its square over the first k sorted norms. The middle of the norms
    /// is subtracted to avoid cancellation.
    sums: Vec<[f64; 2]>,
    middle: f64,
}

impl Profile {
    /// The profile about the centre of `frame`.
    #[must_use]
    pub fn new(positions: &[DVec3], frame: Frame) -> Self {
        unstopped(|stop| Self::new_until(positions, frame, stop))
    }

    /// As [`Self::new`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(positions: &[DVec3], frame: Frame, stop: Stop<'_>) -> Option<Self> {
        Self::of_norms(norms(positions, frame.centre), frame, stop)
    }

    /// The profile about a centre, in the frame that the norms themselves span.
    #[must_use]
    pub fn about(positions: &[DVec3], centre: DVec3) -> Self {
        unstopped(|stop| Self::about_until(positions, centre, stop))
    }

    /// As [`Self::about`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn about_until(positions: &[DVec3], centre: DVec3, stop: Stop<'_>) -> Option<Self> {
        let norms = norms(positions, centre);
        let frame = Frame::spanning(centre, &norms);
        Self::of_norms(norms, frame, stop)
    }

    fn of_norms(norms: Vec<f64>, frame: Frame, stop: Stop<'_>) -> Option<Self> {
        let norms = sorted(norms, stop, f64::total_cmp)?;
        // The middle is taken from the norms, not from the frame: one distant stray point must not cost
        // the other norms digits.
        let middle = norms.get(norms.len() / 2).copied().unwrap_or(0.0);
        let mut sums = Vec::with_capacity(norms.len() + 1);
        let mut sum = [0.0, 0.0];
        sums.push(sum);
        for step in norms.chunks(STEP) {
            go_on(stop)?;
            for rho in step {
                let from_middle = rho - middle;
                sum = [sum[0] + from_middle, sum[1] + from_middle * from_middle];
                sums.push(sum);
            }
        }
        Some(Self { frame, sorted: norms, sums, middle })
    }

    /// The frame that is assumed.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// The norms, ascending.
    #[must_use]
    pub fn norms(&self) -> &[f64] {
        &self.sorted
    }

    /// The statistics of all bins of a bin layout.
    #[must_use]
    pub fn statistics(&self, layout: &BinLayout, modulation: Modulation) -> Vec<BinStatistic> {
        let below = |rho: f64| self.sorted.partition_point(|&norm| norm < rho);
        let mut low = below(layout.norm_at(0, 0.0));
        (0..layout.bins)
            .map(|bin| {
                let high = below(layout.norm_at(bin, 1.0)).max(low);
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
                        let start = layout.norm_at(bin, 0.0) - self.middle;
                        (first / n - start) / layout.width
                    }
                    Modulation::Variance => {
                        let centre = layout.norm_at(bin, 0.5) - self.middle;
                        let squares = second / n - 2.0 * centre * first / n + centre * centre;
                        4.0 * squares / (layout.width * layout.width)
                    }
                };
                BinStatistic { count, value }
            })
            .collect()
    }

    /// Per bin of a layout class in this frame, how far its statistic is above neutral; `None` for an
    /// erasure.
    #[must_use]
    pub fn bins(&self, class: u8, bits: BitCount, modulation: Modulation) -> Vec<Option<f64>> {
        let Some(layout) = BinLayout::new(&self.frame, class, bits) else {
            return vec![None; bits.get()];
        };
        let off = |s: &BinStatistic| (!s.is_erasure()).then_some(s.value - modulation.neutral());
        self.statistics(&layout, modulation).iter().map(off).collect()
    }

    /// The soft bits of one bin layout.
    #[must_use]
    pub fn read_layout(&self, layout: &BinLayout, modulation: Modulation) -> SoftBits {
        SoftBits::new(&self.statistics(layout, modulation), modulation)
    }

    /// The soft bits of a layout class in this frame; all erasures where the frame has no extent.
    #[must_use]
    pub fn read(&self, class: u8, bits: BitCount, modulation: Modulation) -> SoftBits {
        match BinLayout::new(&self.frame, class, bits) {
            Some(layout) => self.read_layout(&layout, modulation),
            None => SoftBits::new(&vec![BinStatistic::default(); bits.get()], modulation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::sample::Sample;
    use crate::watermark::bins;

    #[test]
    fn prefix_sums_agree_with_the_direct_statistics() {
        let surface = Surface::new(&Sample::Blob.mesh(9000).unwrap());
        let profile = Profile::about(&surface.positions, surface.centre());
        let norms = norms(&surface.positions, surface.centre());
        for class in [0, 100, 255] {
            for modulation in [Modulation::Mean, Modulation::Variance] {
                let layout = BinLayout::new(&profile.frame, class, BitCount::default()).unwrap();
                let direct = bins::statistics(&norms, &layout, modulation);
                for (a, b) in profile.statistics(&layout, modulation).iter().zip(&direct) {
                    assert_eq!(a.count, b.count);
                    assert!((a.value - b.value).abs() < 1e-9, "{a:?} {b:?}");
                }
            }
        }
    }
}
