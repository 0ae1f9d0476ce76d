//! The strongest mark within a limit of distortion.
//!
//! A strength that follows from what *this* codeword does to the host says something about the
//! codeword, and detection weighs with the strength (the matched filter, the likeness of lattices): a
//! bound that takes codewords for independent of all weights would be too good. So the strength is
//! fitted to the host alone, with a codeword that is nobody's ([`Codeword::probe`]), as closely as one
//! likes. The own codeword is then tried with it, and where it distorts too much, with weaker ones:
//! fixed shares of the fitted strength, one after the other. Each that is refused is one more try of a
//! series, like a codeword that was refused, and its number is charged to the record's bound
//! (`service::verify::charge`): given its number, a strength follows from the host alone.
//!
//! Distortion grows with strength, nearly in proportion: a few embeddings find the strength, each
//! placed by the ones before. Deterministic, and strengths are whole multiples of 0.0001, so that
//! a record can name the one that was found. Must not know how a mark is made or measured.
//!
//! [`Codeword::probe`]: crate::watermark::Codeword::probe

use super::MarkError;
use crate::watermark::{Strength, WatermarkError};

/// Strengths that the own codeword is tried with, at most. The last is 0.57 of the first.
pub const MOST_STRENGTHS: u32 = 9;

/// Each is this share of the one before.
const WEAKER: f64 = 0.93;

/// Embeddings at most.
const MOST_TRIES: usize = 6;

/// The search ends when the probe uses this share of what a mark may distort.
const CLOSE: f64 = 0.93;

/// The share that is aimed at. What others do to the same host differs from the probe by some percent,
/// mostly downward: a try that is refused costs as much as several percent of strength.
const AIM: f64 = 0.96;

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

/// Whose codeword is embedded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Whose {
    /// Nobody's.
    Probe,
    /// The record's own.
    Own,
}

/// What was settled for, and how many strengths of the own codeword were refused before.
#[derive(Debug, PartialEq)]
pub(super) struct Fitted<T> {
    pub(super) made: T,
    pub(super) refused_strengths: u32,
}

/// An embedding of the own codeword that stays within `limit`, about as strong as the host allows, at
/// most `strongest`, beginning at `start`. `attempt` answers with an embedding's MRMS and the
/// embedding.
///
/// # Errors
/// [`MarkError::DistortionUnreachable`] when none does; what `attempt` says.
pub(super) fn strongest_within<T>(
    limit: MaxDistortion,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(Whose, Strength) -> Result<(f64, T), MarkError>,
) -> Result<Fitted<T>, MarkError> {
    let probe = |strength| attempt(Whose::Probe, strength).map(|(mrms, _)| mrms);
    let mut wanted = fitted(limit, start, strongest, probe)?;
    let (mut refusal, mut least) = (None, f64::INFINITY);
    for refused_strengths in 0..MOST_STRENGTHS {
        let alpha = if refused_strengths == 0 { wanted } else { in_steps(wanted) };
        match attempt(Whose::Own, Strength::new(alpha)?) {
            Ok((mrms, made)) if mrms <= limit.get() => {
                return Ok(Fitted { made, refused_strengths });
            }
            Ok((mrms, _)) => least = least.min(mrms),
            Err(error @ MarkError::Watermark(WatermarkError::InsufficientCapacity { .. })) => {
                refusal.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
        if alpha <= LEAST {
            break;
        }
        wanted *= WEAKER;
    }
    match refusal {
        Some(error) if least.is_infinite() => Err(error),
        _ => Err(MarkError::DistortionUnreachable { limit: limit.get(), least }),
    }
}

/// Down to a whole multiple of 0.0001, at least the weakest there is. (Also what is no number.)
fn in_steps(alpha: f64) -> f64 {
    ((alpha * 1e4).floor() / 1e4).max(LEAST)
}

/// The strength with which the probe stays within `limit`, nearly the strongest. `attempt` answers
/// with its MRMS.
fn fitted(
    limit: MaxDistortion,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(Strength) -> Result<f64, MarkError>,
) -> Result<f64, MarkError> {
    let limit = limit.get();
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
                // A chord over the logarithms.
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
        let limit = MaxDistortion::new(limit).unwrap();
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

    /// What one codeword does must not show in the strength, but by the number of tries.
    #[test]
    fn the_strength_follows_from_the_host_and_the_number_of_tries() {
        let strength = |alpha| Strength::new(alpha).unwrap();
        let limit = MaxDistortion::new(1e-4).unwrap();
        let mut by_tries = std::collections::BTreeMap::new();
        for own in [0.7, 0.8, 0.9, 0.97, 1.0, 1.02, 1.06, 1.1, 1.15, 1.2, 1.3, 1.4, 1.5] {
            let found = strongest_within(limit, strength(0.1), Strength::MAX, |whose, strength| {
                let alpha = strength.get();
                let of = if whose == Whose::Own { own } else { 1.0 };
                Ok((of * alpha * 1e-3, alpha))
            });
            let Fitted { made: alpha, refused_strengths } = found.unwrap();
            assert!(own * alpha * 1e-3 <= limit.get(), "{own}: the limit is passed");
            let known = *by_tries.entry(refused_strengths).or_insert(alpha);
            assert!((known - alpha).abs() < 1e-12, "{own}: {known} {alpha}");
            assert!((refused_strengths == 0) == (own <= 1.0), "{own}: {refused_strengths}");
        }
        assert!(by_tries.len() > 3);
        let found = strongest_within(limit, strength(0.1), Strength::MAX, |whose, strength| {
            let of = if whose == Whose::Own { 9.0 } else { 1.0 };
            Ok((of * strength.get() * 1e-3, ()))
        });
        assert!(matches!(found, Err(MarkError::DistortionUnreachable { .. })), "{found:?}");
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
