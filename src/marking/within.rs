//! The strongest mark within a limit of distortion.
//!
//! Distortion grows with strength, nearly in proportion: a few embeddings find the strength, each
//! placed by the ones before. Deterministic, and strengths are whole multiples of 0.0001, so that
//! a record can name the one that was found. Must not know how a mark is made or measured.

use super::MarkError;
use crate::watermark::{Strength, WatermarkError};

/// Embeddings at most.
const MOST_TRIES: usize = 6;

/// The search ends when the mark uses this share of what it may distort.
const CLOSE: f64 = 0.95;

/// The share that is aimed at.
const AIM: f64 = 0.98;

/// The weakest strength there is.
const LEAST: f64 = 0.01;

/// Strengths closer than this ratio are the same.
const SAME: f64 = 1.01;

/// How much a mark may distort: its MRMS as a share of the bounding box's diagonal, from 0.000001
/// to 0.1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MaxDistortion(f64);

impl MaxDistortion {
    /// # Errors
    /// A text for the caller, when it is out of range; also for NaN.
    pub fn new(share: f64) -> Result<Self, String> {
        if (1e-6..=0.1).contains(&share) {
            Ok(Self(share))
        } else {
            Err(format!("{share} is out of range: {RANGE}"))
        }
    }

    /// The share.
    #[must_use]
    pub fn get(self) -> f64 {
        self.0
    }
}

const RANGE: &str = "it is a share of the bounding box's diagonal, from 0.000001 to 0.1";

impl std::str::FromStr for MaxDistortion {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        Self::new(text.parse().map_err(|_| format!("must be a number: {RANGE}"))?)
    }
}

/// The strength of an embedding and the distortion it gave, where it gave one.
type Tried = (f64, Option<f64>);

/// The strongest of the tried embeddings that stays within `limit`, at most `strongest`, beginning
/// at `start`. `attempt` answers with an embedding's MRMS and the embedding.
///
/// # Errors
/// [`MarkError::DistortionUnreachable`] when none does; what `attempt` says.
pub(super) fn strongest_within<T>(
    limit: MaxDistortion,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(Strength) -> Result<(f64, T), MarkError>,
) -> Result<T, MarkError> {
    let limit = limit.get();
    let mut found: Option<(Tried, T)> = None;
    let mut too_strong: Option<Tried> = None;
    let mut refusal = None;
    let mut least = f64::INFINITY;
    let mut alpha = start.get().min(strongest.get());
    for number in 1..=MOST_TRIES {
        if number == MOST_TRIES && found.is_none() {
            alpha = LEAST;
        }
        match attempt(Strength::new(alpha)?) {
            Ok((mrms, made)) if mrms <= limit => {
                found = Some(((alpha, Some(mrms)), made));
                if mrms >= CLOSE * limit {
                    break;
                }
            }
            Ok((mrms, _)) => {
                too_strong = Some((alpha, Some(mrms)));
                least = least.min(mrms);
            }
            // What cannot carry a strong mark may carry a weak one.
            Err(error @ MarkError::Watermark(WatermarkError::InsufficientCapacity { .. })) => {
                too_strong = Some((alpha, None));
                refusal.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
        match next(found.as_ref().map(|found| found.0), too_strong, limit, strongest.get()) {
            Some(next) => alpha = next,
            None => break,
        }
    }
    match (found, refusal) {
        (Some((_, made)), _) => Ok(made),
        (None, Some(error)) if least.is_infinite() => Err(error),
        (None, _) => Err(MarkError::DistortionUnreachable { limit, least }),
    }
}

/// The strength to try next; `None` when there is none left.
fn next(
    found: Option<Tried>,
    too_strong: Option<Tried>,
    limit: f64,
    strongest: f64,
) -> Option<f64> {
    let aim = AIM * limit;
    let wanted = match (found, too_strong) {
        (None, None) => return None,
        (Some((alpha, mrms)), None) => alpha * mrms.map_or(2.0, |mrms| aim / mrms),
        (None, Some((alpha, mrms))) => alpha * mrms.map_or(0.5, |mrms| aim / mrms),
        (Some((low, at_low)), Some((high, at_high))) => {
            let share = match (at_low, at_high) {
                // A chord over the logarithms.
                (Some(at_low), Some(at_high)) => (aim / at_low).ln() / (at_high / at_low).ln(),
                _ => 0.5,
            };
            low * (high / low).powf(share.clamp(0.1, 0.9))
        }
    };
    // (Whatever is no number ends as the weakest.)
    let rounded = ((wanted * 1e4).floor() / 1e4).max(LEAST);
    let alpha = if rounded >= strongest { strongest } else { rounded };
    let new = found.is_none_or(|(low, _)| alpha > low * SAME)
        && too_strong.is_none_or(|(high, _)| alpha < high);
    new.then_some(alpha)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(
        limit: f64,
        strongest: f64,
        mrms: impl Fn(f64) -> Option<f64>,
    ) -> (Result<f64, MarkError>, usize) {
        let mut tries = 0;
        let strength = |alpha| Strength::new(alpha).unwrap();
        let start = strength(0.1);
        let limit = MaxDistortion::new(limit).unwrap();
        let found = strongest_within(limit, start, strength(strongest), |strength| {
            tries += 1;
            let alpha = strength.get();
            let full = WatermarkError::InsufficientCapacity {
                usable: 1,
                needed: 2,
                bits: 3,
                vertices: 4,
                in_bins: 5,
                least_count: 6,
                reason: "test",
            };
            mrms(alpha).map(|mrms| (mrms, alpha)).ok_or(full.into())
        });
        (found, tries)
    }

    #[test]
    fn the_limit_is_used_and_never_passed() {
        type Law = fn(f64) -> f64;
        let laws: [(&str, Law); 4] = [
            ("in proportion", |alpha| alpha * 1e-3),
            ("faster", |alpha| alpha * alpha * 1e-2),
            ("with a floor", |alpha| 5e-6 + alpha * 1e-3),
            ("in steps", |alpha| (alpha * 50.0).ceil() * 2e-5),
        ];
        for (name, law) in laws {
            for limit in [3e-5, 5e-5, 1e-4, 2e-4] {
                let (found, tries) = search(limit, 0.25, |alpha| Some(law(alpha)));
                let alpha = found.unwrap();
                assert!(law(alpha) <= limit && tries <= MOST_TRIES, "{name} {limit}: {alpha}");
                let better = law((alpha * 1.25).min(0.25));
                assert!(better > limit || alpha >= 0.25, "{name} {limit}: {alpha} is weak");
            }
        }
    }

    #[test]
    fn never_above_the_strongest_and_no_more_tries_than_needed() {
        for (strongest, expected) in [(0.25, 0.25), (0.12, 0.12), (0.05, 0.05)] {
            let (found, tries) = search(0.1, strongest, |alpha| Some(alpha * 1e-3));
            assert_eq!(found, Ok(expected));
            assert!(tries <= 2, "{tries}");
        }
    }

    #[test]
    fn what_cannot_be_reached_is_refused_with_the_figures() {
        let (found, tries) = search(1e-6, 0.25, |alpha| Some(1e-5 + alpha * 1e-3));
        let Err(MarkError::DistortionUnreachable { limit, least }) = found else {
            panic!("{found:?}")
        };
        assert!(tries <= 3 && (limit - 1e-6).abs() < 1e-15 && (least - 2e-5).abs() < 1e-12);
        let (found, _) = search(1e-4, 0.25, |_| None);
        let full = |error| matches!(error, MarkError::Watermark(_));
        assert!(found.is_err_and(full));
        let weak_only = search(1e-3, 0.25, |alpha| (alpha < 0.06).then_some(alpha * 1e-3));
        assert!(weak_only.0.unwrap() >= 0.05);
    }

    #[test]
    fn the_range_is_closed() {
        for (text, fits) in [
            ("1e-6", true),
            ("0.1", true),
            ("0.0001", true),
            ("9e-7", false),
            ("0.11", false),
            ("nan", false),
            ("-1", false),
            ("x", false),
        ] {
            assert_eq!(text.parse::<MaxDistortion>().is_ok(), fits, "{text}");
        }
    }
}
