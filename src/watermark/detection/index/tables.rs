//! Byte tables in small integers: the scores of one codeword under eight readings at once.
//!
//! A table entry holds, for one value of one byte of a codeword, what the byte adds to the score of
//! each of up to [`LANES`] readings, as 16-bit integers. A row of M bits costs M / 8 loads and
//! additions whatever the number of readings. Rounding is bounded, so a row below the floor of every
//! lane is certainly below the requested score; the other rows are scored again exactly.

use crate::watermark::SoftBits;
use crate::watermark::detection::bound::least_score;

/// Readings per table: an entry has sixteen bytes, one SIMD register of any 64-bit processor.
pub(super) const LANES: usize = 8;

/// The value to which the sum of a lane's weights is scaled. With the rounding of at most 256 weights
/// it stays below 2^15.
const FULL: f64 = 32_000.0;

/// One entry: a lane per reading.
type Entry = [i16; LANES];

/// Tables of up to [`LANES`] readings of the same bins.
pub(super) struct Tables {
    /// One table per byte of the codeword.
    bytes: Vec<[Entry; 256]>,
    /// Per lane, the score from which a row is scored exactly.
    floors: Entry,
}

impl Tables {
    /// Tables for scores whose bound is at most `worth_log10`. `None` when no score of any reading can
    /// have such a bound. Readings after the first [`LANES`] are ignored.
    pub(super) fn new<'a>(
        readings: impl Iterator<Item = &'a SoftBits>,
        worth_log10: f64,
    ) -> Option<Self> {
        let mut weights: Vec<Entry> = Vec::new();
        let mut floors = [i16::MAX; LANES];
        let mut worthwhile = false;
        for (lane, soft) in readings.take(LANES).enumerate() {
            let signed = soft.signed_weights();
            weights.resize(weights.len().max(signed.len()), [0; LANES]);
            let Some(least) = least_score(signed, worth_log10) else { continue };
            worthwhile = true;
            let scale = FULL / signed.iter().map(|w| w.abs()).sum::<f64>().max(f64::MIN_POSITIVE);
            for (entry, w) in weights.iter_mut().zip(signed) {
                entry[lane] = small(w * scale);
            }
            // Each weight is off by at most one half; one more is for the rounding of the floor.
            floors[lane] = small(least * scale - 0.5 * signed.len() as f64 - 1.0);
        }
        worthwhile.then(|| Self { bytes: weights.chunks(8).map(table).collect(), floors })
    }

    /// Whether a row may reach the requested score in some lane.
    #[inline]
    pub(super) fn may_reach(&self, row: &[u8]) -> bool {
        let mut sum = [0_i16; LANES];
        for (table, &byte) in self.bytes.iter().zip(row) {
            let entry = &table[usize::from(byte)];
            for (sum, part) in sum.iter_mut().zip(entry) {
                *sum = sum.wrapping_add(*part);
            }
        }
        let mut reached = 0;
        for (sum, floor) in sum.iter().zip(&self.floors) {
            reached |= u8::from(sum >= floor);
        }
        reached != 0
    }
}

/// Rounds to the nearest 16-bit integer, saturating.
fn small(x: f64) -> i16 {
    #[expect(clippy::cast_possible_truncation, reason = "clamped; a float cast saturates anyway")]
    let rounded = x.round().clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16;
    rounded
}

/// What each of the 256 values of one byte adds, built from all bits 0 by adding one bit at a time.
fn table(weights: &[Entry]) -> [Entry; 256] {
    let mut table: [Entry; 256] = [[0; LANES]; 256];
    for w in weights {
        table[0] = std::array::from_fn(|lane| table[0][lane].wrapping_sub(w[lane]));
    }
    for (bit, w) in weights.iter().enumerate() {
        let (known, new) = table.split_at_mut(1 << bit);
        for (new, known) in new.iter_mut().zip(known) {
            *new = std::array::from_fn(|lane| known[lane].wrapping_add(w[lane].wrapping_mul(2)));
        }
    }
    table
}
