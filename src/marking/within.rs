//! The strongest mark within a limit of distortion.
//!
//! A strength that follows from what *this* codeword does to the host says something about the
//! codeword, and detection weighs with the strength (the matched filter, the likeness of lattices): a
//! bound that takes codewords for independent of all weights would be too good. So the strength is
//! fitted to the host alone (`fit`), with codewords that are nobody's ([`Codeword::probe`]): the worst of
//! them may use a fixed share of the limit. (Where no strength is weak enough for them, but nearly, it is
//! the one that the fit began with.) The own codeword is then tried with it, and where it
//! distorts too much, with weaker ones: fixed shares of the first, one after the other. Each
//! that is refused is one more try of a series, like a codeword that was refused, and its number is
//! charged to the record's bound (`service::verify::charge`): given its number, a strength follows from
//! the host alone.
//!
//! Must not know how a mark is made or measured.
//!
//! [`Codeword::probe`]: crate::watermark::Codeword::probe

use super::MarkError;
use super::fit::{LEAST, fitted, in_steps};
use crate::watermark::{Strength, WatermarkError};

/// Strengths that the own codeword is tried with, at most.
pub const MOST_STRENGTHS: u32 = 5;

/// What they are, as shares of the first: small steps for what is a little
/// above the limit, and large ones. (Nine small steps down to 0.57 gave no more: where norms are crowded,
/// distortion hardly falls with strength, half of the codewords on a gear were refused all nine, and one
/// more in ten was accepted by the fourth.)
const SHARES: [f64; 5] = [1.0, 0.93, 0.86, 0.7, 0.5];

/// Where the probes distort more than so many times what they may, no codeword is tried. (Where norms
/// are crowded, distortion hardly grows with strength but differs between codewords: on a hammer, two, one,
/// three and two of three were within 0.01 % at strengths 0.02, 0.05, 0.08 and 0.1.)
const HOPELESS: f64 = 3.0;

/// Nobody's codewords that a strength is fitted with.
pub(super) const PROBES: [u8; 2] = [0, 1];

/// The share of the limit that the worst probe may use. What others do to the same host differs from
/// it by a tenth to a half, the more the fewer the bits, and a try that is refused costs more than some
/// strength (nearly a decade of the bound). Of 40 codewords each on a generated blob and knot (16 to 64
/// bits, strengths 0.03 and 0.1), 3 % distort more than 1.2 times as much as the worse of the two, 12 %
/// more than it. `benches/limits.rs` counts refusals.
const SHARE: f64 = 0.83;

/// How much a mark may distort: its MRMS as a share of the bounding box's diagonal, from 0.000001
/// to 0.1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MaxDistortion(f64);

impl MaxDistortion {
    /// What a mark with a relief may distort where nothing else is asked for: 0.01 %, which is half of
    /// what the paper's method takes on most of its meshes.
    pub const USUAL: Self = Self(1e-4);

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

/// Whose codeword is embedded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Whose {
    /// Nobody's: the one at this place of [`PROBES`].
    Probe(usize),
    /// The record's own.
    Own,
}

/// What was settled for, and how many strengths of the own codeword were refused before.
#[derive(Debug, PartialEq)]
pub(super) struct Fitted<T> {
    pub(super) made: T,
    pub(super) refused_strengths: u32,
}

/// How much marks may distort.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// What the own mark may, all in all.
    pub(super) limit: MaxDistortion,
    /// What is left of it for the probes, which are measured without a relief.
    pub(super) left: f64,
}

impl Room {
    /// All of a limit.
    pub(super) fn whole(limit: MaxDistortion) -> Self {
        Self { limit, left: limit.get() }
    }
}

/// An embedding of the own codeword that stays within the limit, about as strong as the host allows, at
/// most `strongest`, beginning at `start`. `attempt` answers with an embedding's MRMS and the
/// embedding.
///
/// # Errors
/// [`MarkError::DistortionUnreachable`] when none does; what `attempt` says.
pub(super) fn strongest_within<T>(
    Room { limit, left }: Room,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(Whose, Strength) -> Result<(f64, T), MarkError>,
) -> Result<Fitted<T>, MarkError> {
    let allowed = SHARE * left;
    let mut order = std::array::from_fn(|place| place);
    let worst = |strength| {
        worst_probe(allowed, &mut order, |place| {
            attempt(Whose::Probe(place), strength).map(|(mrms, _)| mrms)
        })
    };
    let wanted = match fitted(allowed, start, strongest, worst) {
        // The own codeword may do what the probes nearly do.
        Err(MarkError::DistortionUnreachable { least, .. }) if least <= left => LEAST,
        Err(MarkError::DistortionUnreachable { least, .. }) if least <= HOPELESS * left => {
            start.get().min(strongest.get())
        }
        Err(MarkError::DistortionUnreachable { least, .. }) => {
            return Err(MarkError::DistortionUnreachable { limit: limit.get(), least });
        }
        fitted => fitted?,
    };
    let (mut refusal, mut least) = (None, f64::INFINITY);
    for (refused_strengths, share) in (0..).zip(SHARES) {
        let alpha = if refused_strengths == 0 { wanted } else { in_steps(share * wanted) };
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
    }
    match refusal {
        Some(error) if least.is_infinite() => Err(error),
        _ => Err(MarkError::DistortionUnreachable { limit: limit.get(), least }),
    }
}

/// The MRMS of the worst probe, or of one that is above `allowed`. `order` begins with the one that was
/// worst so far: most that are above it show with one embedding. A probe that the mesh cannot carry says
/// nothing as long as it carries another.
fn worst_probe(
    allowed: f64,
    order: &mut [usize; PROBES.len()],
    mut attempt: impl FnMut(usize) -> Result<f64, MarkError>,
) -> Result<f64, MarkError> {
    let (mut worst, mut refusal) = (None, None);
    for (place, probe) in (*order).into_iter().enumerate() {
        match attempt(probe) {
            Ok(mrms) => {
                if worst.is_none_or(|worst| mrms > worst) {
                    worst = Some(mrms);
                    order[..=place].rotate_right(1);
                }
                if mrms > allowed {
                    break;
                }
            }
            Err(error @ MarkError::Watermark(WatermarkError::InsufficientCapacity { .. })) => {
                refusal.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
    }
    match (worst, refusal) {
        (None, Some(error)) => Err(error),
        (worst, _) => Ok(worst.unwrap_or(0.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_as_many_strengths_as_are_charged() {
        assert_eq!(u32::try_from(SHARES.len()), Ok(MOST_STRENGTHS));
    }

    /// What one codeword does must not show in the strength, but by the number of tries.
    #[test]
    fn the_strength_follows_from_the_host_and_the_number_of_tries() {
        let strength = |alpha| Strength::new(alpha).unwrap();
        let limit = MaxDistortion::new(1e-4).unwrap();
        let mut by_tries = std::collections::BTreeMap::new();
        for own in [0.7, 0.9, 1.0, 1.2, 1.25, 1.26, 1.3, 1.36, 1.4, 1.5, 1.6, 1.8, 2.0] {
            let found = strongest_within(
                Room::whole(limit),
                strength(0.1),
                Strength::MAX,
                |whose, strength| {
                    let alpha = strength.get();
                    let of = if whose == Whose::Own { own } else { 1.0 };
                    Ok((of * alpha * 1e-3, alpha))
                },
            );
            let Fitted { made: alpha, refused_strengths } = found.unwrap();
            assert!(own * alpha * 1e-3 <= limit.get(), "{own}: the limit is passed");
            let known = *by_tries.entry(refused_strengths).or_insert(alpha);
            assert!((known - alpha).abs() < 1e-12, "{own}: {known} {alpha}");
            assert!((refused_strengths == 0) == (own <= 1.25), "{own}: {refused_strengths}");
        }
        assert!(by_tries.len() > 3);
        let found = strongest_within(
            Room::whole(limit),
            strength(0.1),
            Strength::MAX,
            |whose, strength| {
                let of = if whose == Whose::Own { 9.0 } else { 1.0 };
                Ok((of * strength.get() * 1e-3, ()))
            },
        );
        assert!(matches!(found, Err(MarkError::DistortionUnreachable { .. })), "{found:?}");
    }

    fn full() -> MarkError {
        let (usable, needed, bits) = (1, 2, 3);
        let (vertices, in_bins, least_count, reason) = (4, 5, 6, "test");
        WatermarkError::InsufficientCapacity {
            usable,
            needed,
            bits,
            vertices,
            in_bins,
            least_count,
            reason,
        }
        .into()
    }

    #[test]
    fn the_worst_probe_leaves_room_for_other_codewords() {
        let limit = MaxDistortion::new(1e-4).unwrap();
        let start = Strength::new(0.1).unwrap();
        for worst in 0..PROBES.len() {
            let mut embeddings = 0;
            let found =
                strongest_within(Room::whole(limit), start, Strength::MAX, |whose, strength| {
                    embeddings += 1;
                    let of = match whose {
                        Whose::Probe(place) if place == worst => 1.5,
                        Whose::Probe(_) => 1.0,
                        Whose::Own => 1.8,
                    };
                    Ok((of * strength.get() * 1e-3, strength.get()))
                });
            let Fitted { made: alpha, refused_strengths: 0 } = found.unwrap() else {
                panic!("a fifth more than the worst probe is within the limit")
            };
            assert!(1.5 * alpha * 1e-3 > 0.9 * SHARE * limit.get(), "{alpha} is weak");
            assert!(embeddings <= 6, "{embeddings}");
        }
    }

    #[test]
    fn one_probe_that_is_refused_says_nothing() {
        let limit = MaxDistortion::new(1e-4).unwrap();
        let start = Strength::new(0.1).unwrap();
        let found = |refused: &dyn Fn(Whose) -> bool| {
            strongest_within(Room::whole(limit), start, Strength::MAX, |whose, strength| {
                if refused(whose) { Err(full()) } else { Ok((strength.get() * 1e-3, ())) }
            })
        };
        for place in 0..PROBES.len() {
            assert!(found(&|whose| whose == Whose::Probe(place)).is_ok());
        }
        let refused = found(&|whose| matches!(whose, Whose::Probe(_)));
        assert!(matches!(refused, Err(MarkError::Watermark(_))), "{refused:?}");
    }

    /// Where the weakest mark of a probe is within the limit, but not with room to spare; or not within
    /// it, but nearly.
    #[test]
    fn where_probes_do_not_fit_the_own_codeword_decides() {
        let limit = MaxDistortion::new(1e-4).unwrap();
        let start = Strength::new(0.1).unwrap();
        let found = |probes: f64, own: f64| {
            strongest_within(Room::whole(limit), start, Strength::MAX, |whose, strength| {
                let of = if whose == Whose::Own { own } else { probes };
                Ok((of + strength.get() * 1e-6, strength.get()))
            })
        };
        let Fitted { made, refused_strengths } = found(9e-5, 8e-5).unwrap();
        assert!((made - LEAST).abs() < 1e-12 && refused_strengths == 0);
        let Fitted { made, refused_strengths } = found(2.9e-4, 8e-5).unwrap();
        assert!((made - start.get()).abs() < 1e-12 && refused_strengths == 0);
        for (probes, own) in [(9e-5, 1.1e-4), (3.1e-4, 8e-5), (2e-4, 1.1e-4)] {
            let Err(MarkError::DistortionUnreachable { limit: told, .. }) = found(probes, own)
            else {
                panic!("{probes} {own}")
            };
            assert!((told - limit.get()).abs() < 1e-15);
        }
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
