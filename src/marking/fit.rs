//! Fits a strength to a limit of distortion.
//!
//! Distortion grows nearly in proportion to strength. A few embeddings find the strength, each at a
//! strength that follows from those before. Deterministic. Strengths are whole multiples of 0.0001,
//! so that a record can name the one that was found.

use super::MarkError;
use crate::watermark::{Strength, WatermarkError};

/// Strengths that probes are embedded with, at most.
const MOST_TRIES: usize = 6;

/// The search ends when the worst probe uses this share of its limit.
const CLOSE: f64 = 0.93;

/// The share of the limit that the search aims at.
const AIM: f64 = 0.96;

/// The weakest strength there is.
pub(super) const LEAST: f64 = 0.01;

/// Strengths closer than this ratio are the same.
const SAME: f64 = 1.01;

/// The strength of an embedding and its distortion; `None` where the mesh could not carry it.
type Tried = (f64, Option<f64>);

/// Rounds down to a multiple of 0.0001, but not below the weakest strength; NaN becomes that one.
pub(super) fn in_steps(alpha: f64) -> f64 {
    ((alpha * 1e4).floor() / 1e4).max(LEAST)
}

/// Nearly the largest strength whose MRMS stays within `limit`, at most `strongest`. The search
/// begins at `start`. `attempt` returns the MRMS of a strength.
pub(super) fn fitted(
    limit: f64,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(Strength) -> Result<f64, MarkError>,
) -> Result<f64, MarkError> {
    let mut found: Option<Tried> = None;
    let mut too_strong: Option<Tried> = None;
    let mut refusal = None;
    let mut least = f64::INFINITY;
    let mut alpha = start.get().min(strongest.get());
    for number in 1..=MOST_TRIES {
        if number == MOST_TRIES && found.is_none() {
            alpha = LEAST;
        }
        match attempt(Strength::new(alpha)?) {
            Ok(mrms) if mrms <= limit => {
                found = Some((alpha, Some(mrms)));
                if mrms >= CLOSE * limit {
                    break;
                }
            }
            Ok(mrms) => {
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
        match next(found, too_strong, limit, strongest.get()) {
            Some(next) => alpha = next,
            None => break,
        }
    }
    match (found, refusal) {
        (Some((alpha, _)), _) => Ok(alpha),
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
                // Linear interpolation of the logarithms.
                (Some(at_low), Some(at_high)) => {
                    libm::log(aim / at_low) / libm::log(at_high / at_low)
                }
                _ => 0.5,
            };
            low * libm::pow(high / low, share.clamp(0.1, 0.9))
        }
    };
    let rounded = in_steps(wanted);
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
        let found = fitted(limit, start, strength(strongest), |strength| {
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
            mrms(alpha).ok_or(full.into())
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
}
