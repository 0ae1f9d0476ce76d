//! Frame, bin layout and bins: which vertex norms carry which bit (paper eq. 4-8, 12).

use glam::DVec3;
use rayon::prelude::*;

use super::codeword::LAYOUT_CLASSES;
use super::{BitCount, Modulation};
use crate::mesh::powers::squared;

/// Largest trimmed share of the radial extent at each end (paper eq. 4: eps in [0, 0.15]).
pub const LARGEST_EPS: f64 = 0.15;

/// Fewest vertices from which a bit is read; a bin with fewer is an erasure. With three vertices one
/// stray vertex decides the bit. With four or more, the closed loop moved every bin of every mesh it
/// was tried on.
pub const LEAST_COUNT: usize = 4;

/// Vertices per block of the ordered sums below.
const BLOCK: usize = 16_384;

/// The centre and radial range that a detector assumes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Area-weighted centre `o`.
    pub centre: DVec3,
    /// Smallest vertex norm.
    pub rho_min: f64,
    /// Largest vertex norm.
    pub rho_max: f64,
}

impl Frame {
    /// The frame about `centre` whose range is that of `norms`.
    #[must_use]
    pub fn spanning(centre: DVec3, norms: &[f64]) -> Self {
        let block = |block: &[f64]| {
            let start = (f64::INFINITY, f64::NEG_INFINITY);
            block.iter().fold(start, |(low, high), &rho| (low.min(rho), high.max(rho)))
        };
        let wider = |a: (f64, f64), b: (f64, f64)| (a.0.min(b.0), a.1.max(b.1));
        let none = || (f64::INFINITY, f64::NEG_INFINITY);
        let (rho_min, rho_max) = norms.par_chunks(BLOCK).map(block).reduce(none, wider);
        Self { centre, rho_min, rho_max }
    }

    /// `R = rho_max - rho_min`.
    #[must_use]
    pub fn radial_extent(&self) -> f64 {
        self.rho_max - self.rho_min
    }
}

/// Distances of `positions` to `centre`: the vertex norms.
#[must_use]
pub fn norms(positions: &[DVec3], centre: DVec3) -> Vec<f64> {
    positions.par_iter().with_min_len(BLOCK).map(|&v| (v - centre).length()).collect()
}

/// The share of the radial extent that a layout class trims at each end.
#[must_use]
pub fn trimmed_share(class: u8) -> f64 {
    LARGEST_EPS * (f64::from(class) + 0.5) / LAYOUT_CLASSES as f64
}

/// Where the bins lie: `bins` intervals of equal `width`, the first from `start`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BinLayout {
    /// Lower end of the first bin.
    pub start: f64,
    /// Width of every bin.
    pub width: f64,
    /// Number of bins.
    pub bins: usize,
}

impl BinLayout {
    /// The bin layout of a class in a frame: `eps = 0.15 (k + 1/2) / 256`, `start = rho_min + eps R`,
    /// `width = (1 - 2 eps) R / M`. Equations 5 to 7 print `|O| eps`, where `|O|` is a number of
    /// vertices. Only `eps R` is a length, and it reproduces the paper's Table 1.
    ///
    /// `None` when the frame has no radial extent.
    #[must_use]
    pub fn new(frame: &Frame, class: u8, bits: BitCount) -> Option<Self> {
        let extent = frame.radial_extent();
        let eps = trimmed_share(class);
        let width = (1.0 - 2.0 * eps) * extent / bits.get() as f64;
        let start = frame.rho_min + eps * extent;
        // Where `start + width` rounds to `start`, bins cannot be distinguished.
        (width.is_finite() && start + width > start).then_some(Self {
            start,
            width,
            bins: bits.get(),
        })
    }

    /// The bin of a norm and the place `t` of the norm in that bin, in [0, 1); `None` outside all bins.
    #[must_use]
    pub fn locate(&self, rho: f64) -> Option<(usize, f64)> {
        let x = (rho - self.start) / self.width;
        let below = x.floor();
        if !(below >= 0.0 && below < self.bins as f64) {
            return None;
        }
        // In [0, 256] by the test above.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let bin = below as usize;
        Some((bin, x - below))
    }

    /// The norm at place `t` of a bin.
    #[must_use]
    pub fn norm_at(&self, bin: usize, t: f64) -> f64 {
        self.start + (bin as f64 + t) * self.width
    }
}

/// The statistic of one bin.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BinStatistic {
    /// Vertices in the bin.
    pub count: usize,
    /// Modulation mean: mean of `t`. Modulation variance: mean of `(2t - 1)^2`. 0 when the bin is
    /// empty.
    pub value: f64,
}

impl BinStatistic {
    /// Whether there are too few vertices to read a bit.
    #[must_use]
    pub fn is_erasure(&self) -> bool {
        self.count < LEAST_COUNT
    }
}

/// What one vertex at place `t` adds to its bin's statistic.
#[must_use]
pub fn contribution(modulation: Modulation, t: f64) -> f64 {
    match modulation {
        Modulation::Mean => t,
        Modulation::Variance => squared(2.0 * t - 1.0),
    }
}

/// The statistics of all bins (paper eq. 8 and 12), the same to the bit on any number of threads.
#[must_use]
pub fn statistics(norms: &[f64], layout: &BinLayout, modulation: Modulation) -> Vec<BinStatistic> {
    let block = |block: &[f64]| {
        let mut sums = vec![BinStatistic::default(); layout.bins];
        for (bin, t) in block.iter().filter_map(|&rho| layout.locate(rho)) {
            if let Some(sum) = sums.get_mut(bin) {
                sum.count += 1;
                sum.value += contribution(modulation, t);
            }
        }
        sums
    };
    let blocks: Vec<_> = norms.par_chunks(BLOCK).map(block).collect();
    let mut total = vec![BinStatistic::default(); layout.bins];
    for part in &blocks {
        for (sum, part) in total.iter_mut().zip(part) {
            sum.count += part.count;
            sum.value += part.value;
        }
    }
    for sum in &mut total {
        sum.value /= sum.count.max(1) as f64;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        Frame { centre: DVec3::ZERO, rho_min: 2.0, rho_max: 6.0 }
    }

    #[test]
    fn bins_tile_the_trimmed_range() {
        for class in [0, 17, 255] {
            let layout = BinLayout::new(&frame(), class, BitCount::default()).unwrap();
            let eps = 0.15 * (f64::from(class) + 0.5) / 256.0;
            assert!((layout.start - (2.0 + 4.0 * eps)).abs() < 1e-15);
            let end = layout.start + 64.0 * layout.width;
            assert!((end - (6.0 - 4.0 * eps)).abs() < 1e-12);
            assert_eq!(layout.locate(layout.start - 1e-9), None);
            assert_eq!(layout.locate(end + 1e-9), None);
            for bin in 0..64 {
                let (found, t) = layout.locate(layout.norm_at(bin, 0.25)).unwrap();
                assert_eq!(found, bin);
                assert!((t - 0.25).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn no_extent_no_layout() {
        let point = Frame { rho_max: 2.0, ..frame() };
        assert_eq!(BinLayout::new(&point, 3, BitCount::default()), None);
        let empty = Frame::spanning(DVec3::ZERO, &[]);
        assert_eq!(BinLayout::new(&empty, 3, BitCount::default()), None);
    }

    #[test]
    fn even_norms_are_neutral() {
        let layout = BinLayout::new(&frame(), 9, BitCount::new(16).unwrap()).unwrap();
        let norms: Vec<f64> = (0..160_000)
            .map(|i| layout.start + (f64::from(i) + 0.5) * layout.width / 1e4)
            .collect();
        for modulation in [Modulation::Mean, Modulation::Variance] {
            for bin in statistics(&norms, &layout, modulation) {
                assert_eq!(bin.count, 10_000);
                assert!((bin.value - modulation.neutral()).abs() < 1e-7);
            }
        }
    }
}
