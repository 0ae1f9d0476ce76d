//! Whether a mesh carries its codeword: readings are judged, and refusals report counts.

use super::bins::{Frame, LEAST_COUNT};
use super::detection::extract::Reading;
use super::{Codeword, WatermarkError};

/// A bin whose margin stays below this share of the strength counts as wrong: a conversion to
/// single precision could turn it.
const LEAST_MARGIN: f64 = 0.1;

/// A mesh whose norms differ by less than this share of the largest has no usable bins: a bin of 64
/// would be thinner than 1.6e-5 of the object.
const LEAST_EXTENT: f64 = 1e-3;

/// Least number of readable bins of a mark. 2^-40 is below the match threshold of 1e-9 with a thousand
/// hypotheses counted. A mark of fewer bits needs all of its bins.
const LEAST_USABLE_BINS: usize = 40;

/// How many bins of a mark with `bits` bits must be readable.
#[must_use]
pub fn needed_bins(bits: usize) -> usize {
    bits.min(LEAST_USABLE_BINS)
}

/// How a reading compares with the codeword that was embedded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judgement {
    /// Bins that read their bit.
    pub right: usize,
    /// Bins that are no erasures and do not read their bit.
    pub wrong: usize,
    /// The smallest margin of both kinds.
    pub smallest_margin: f64,
}

/// What readings are judged against.
#[derive(Debug, Clone, Copy)]
pub struct Judge<'a> {
    /// The bits that the bins must read.
    pub codeword: &'a Codeword,
    /// The requested strength.
    pub strength: f64,
    /// Carrier vertices of the mesh, for the refusal.
    pub vertices: usize,
}

impl Judge<'_> {
    /// Bins that read their bit, bins that do not, and the smallest margin of all that are read.
    pub fn judge(&self, reading: &Reading) -> Judgement {
        let least = LEAST_MARGIN * self.strength;
        let start = Judgement { right: 0, wrong: 0, smallest_margin: f64::INFINITY };
        let margins = self.codeword.bits().iter().enumerate();
        margins.filter_map(|(bin, &bit)| reading.margin(bin, bit)).fold(start, |sum, margin| {
            let reads = margin >= least;
            Judgement {
                right: sum.right + usize::from(reads),
                wrong: sum.wrong + usize::from(!reads),
                smallest_margin: sum.smallest_margin.min(margin),
            }
        })
    }

    /// Refuses, before any work, a host with too few readable bins. `reading` is that of the unmarked
    /// host.
    ///
    /// # Errors
    /// [`WatermarkError::InsufficientCapacity`].
    pub fn check_host(
        &self,
        frame: Frame,
        reading: Option<&Reading>,
    ) -> Result<(), WatermarkError> {
        let thin = frame.radial_extent() <= LEAST_EXTENT * frame.rho_max;
        let usable = reading.filter(|_| !thin).map_or(0, |reading| {
            reading.statistics.iter().filter(|s| s.count >= LEAST_COUNT).count()
        });
        let reason = if thin {
            "its vertices are all at nearly the same distance from its centre"
        } else {
            "a bin needs at least 4 vertices"
        };
        self.require(usable, reading, reason)
    }

    /// Refuses a result with a wrong bit, or with too few bits.
    ///
    /// # Errors
    /// [`WatermarkError::InsufficientCapacity`].
    pub fn check_result(&self, reading: &Reading) -> Result<(), WatermarkError> {
        let Judgement { right, wrong, .. } = self.judge(reading);
        if wrong > 0 {
            let reason = "the vertices of some bins cannot be moved far enough";
            return Err(self.insufficient(right, right + wrong, Some(reading), reason));
        }
        self.require(right, Some(reading), "a bin needs at least 4 vertices")
    }

    fn require(
        &self,
        usable: usize,
        reading: Option<&Reading>,
        reason: &'static str,
    ) -> Result<(), WatermarkError> {
        let needed = needed_bins(self.codeword.bits().len());
        if usable >= needed {
            return Ok(());
        }
        Err(self.insufficient(usable, needed, reading, reason))
    }

    fn insufficient(
        &self,
        usable: usize,
        needed: usize,
        reading: Option<&Reading>,
        reason: &'static str,
    ) -> WatermarkError {
        WatermarkError::InsufficientCapacity {
            usable,
            needed,
            bits: self.codeword.bits().len(),
            vertices: self.vertices,
            in_bins: reading.map_or(0, Reading::vertices_in_bins),
            least_count: reading.map_or(0, Reading::least_count),
            reason,
        }
    }
}
