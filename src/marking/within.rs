//! The strongest mark within a limit of distortion.
//!
//! A strength that follows from what *this* codeword does to the host says something about the
//! codeword. Detection weighs with the strength, in the matched filter and in the comparison of bin
//! layouts. A bound that assumes codewords to be independent of all weights would then be too good.
//!
//! So the strength is fitted to the host alone (`fit`), with probes: codewords that belong to
//! nobody ([`Codeword::probe`]). The worst probe may use a fixed share of the limit. Where the
//! probes exceed this share even with the weakest strength, the first strength is the weakest one,
//! or the one that the fit began with if they also exceed the limit, but not by far.
//!
//! The own codeword is tried with this first strength. Where it distorts too much, it is tried with
//! weaker ones: fixed shares of the first, one after the other. Where other keys may be used, they
//! follow after few strengths. Each refused strength of each key is one more try of a series, like
//! a refused codeword. The number of tries is charged to the record's bound
//! (`service::verify::charge`). Given this number, a strength follows from the host alone.
//!
//! Must not know how a mark is made or measured.
//!
//! [`Codeword::probe`]: crate::watermark::Codeword::probe

use super::MarkError;
use super::fit::{LEAST, fitted, in_steps};
use crate::relief::Layers;
use crate::watermark::{Strength, WatermarkError};

/// Strengths that the last key is tried with, at most.
const MOST_STRENGTHS: u32 = 5;

/// These strengths as shares of the first: small steps for what is a little above the limit, and
/// large ones. Nine small steps down to 0.57 gave no more. Where norms are crowded, distortion
/// hardly falls with strength: half of the codewords on a gear were refused at all nine steps, and
/// one more in ten was accepted by the fourth.
const SHARES: [f64; 5] = [1.0, 0.93, 0.86, 0.7, 0.5];

/// Strengths that a key is tried with if another key may follow. Where norms are crowded, another
/// codeword helps more than a weaker mark: of ten keys on a gear, seven are within 0.006 % at
/// strength 0.02 and five at 0.1; on a hammer, nine and six.
const FEW_STRENGTHS: u32 = 1;

/// The shares of the first strength that a key is tried with; `last` if no other key follows.
pub(super) fn shares(last: bool) -> impl Iterator<Item = f64> {
    let most = if last { MOST_STRENGTHS } else { FEW_STRENGTHS };
    SHARES.into_iter().zip(0..most).map(|(share, _)| share)
}

/// Amplitudes of a relief alone that are tried, at most. On a mesh of few vertices, distortion
/// differs by a third between sets of signs.
pub(super) const MOST_AMPLITUDES: u32 = 5;

/// Strengths of `keys` keys that the blind layer is tried with, at most.
const fn blind_tries(keys: u32) -> u32 {
    FEW_STRENGTHS * keys.saturating_sub(1) + MOST_STRENGTHS
}

/// Tries of a request with `keys` keys, at most. With a relief, its amplitudes are tried after the
/// blind layer, and where the file cannot carry the relief, the blind layer is tried again alone.
#[must_use]
pub const fn most_tries(keys: u32, layers: Layers) -> u32 {
    match layers {
        Layers::Blind => blind_tries(keys),
        Layers::Relief => MOST_AMPLITUDES,
        Layers::Both => 2 * blind_tries(keys) + MOST_AMPLITUDES,
    }
}

/// No codeword is tried where the probes distort more than this many times what is left for them.
/// Where norms are crowded, distortion hardly grows with strength but differs between codewords: on
/// a hammer, two, one, three and two of three were within 0.01 % at strengths 0.02, 0.05, 0.08 and
/// 0.1.
const MOST_PROBE_EXCESS: f64 = 3.0;

/// The probes that a strength is fitted with: codewords that belong to nobody.
pub(super) const PROBES: [u8; 2] = [0, 1];

/// The share of the limit that the worst probe may use. The distortion of other codewords on the
/// same host differs from the worst probe's by a tenth to a half, more with fewer bits. A refused
/// try costs nearly a decade of the bound, which is more than some strength. Of 40 codewords each
/// on a generated blob and knot, with 16 to 64 bits and strengths 0.03 and 0.1, 3 % distort more
/// than 1.2 times as much as the worse of the two probes, and 12 % more than it.
/// `benches/limits.rs` counts refusals.
const PROBE_SHARE: f64 = 0.83;

/// How much a mark may distort: its MRMS as a share of the bounding box's diagonal, from 0.000001
/// to 0.1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MaxDistortion(f64);

impl MaxDistortion {
    /// The default for a mark with a relief: 0.01 %, half of what the paper's method takes on most
    /// of its meshes.
    pub const USUAL: Self = Self(1e-4);

    /// A limit of this share of the diagonal.
    ///
    /// # Errors
    /// A text for the caller, when `share` is out of range or NaN.
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

/// How much marks may distort.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// The limit of the own mark with all its layers.
    pub(super) limit: MaxDistortion,
    /// What is left of the limit for the probes, which are measured without a relief.
    pub(super) left: f64,
}

/// The strength that an own codeword is tried with first, at most `strongest`; the fit begins at
/// `start`. `attempt` returns the MRMS of a probe, given its index.
///
/// # Errors
/// [`MarkError::DistortionUnreachable`] where no codeword need be tried; the errors of `attempt`.
pub(super) fn first_strength(
    Room { limit, left }: Room,
    start: Strength,
    strongest: Strength,
    mut attempt: impl FnMut(usize, Strength) -> Result<f64, MarkError>,
) -> Result<f64, MarkError> {
    let allowed = PROBE_SHARE * left;
    let mut order = std::array::from_fn(|place| place);
    let worst = |strength| worst_probe(allowed, &mut order, |place| attempt(place, strength));
    match fitted(allowed, start, strongest, worst) {
        // The own codeword may stay within the limit where the probes nearly do.
        Err(MarkError::DistortionUnreachable { least, .. }) if least <= left => Ok(LEAST),
        Err(MarkError::DistortionUnreachable { least, .. })
            if least <= MOST_PROBE_EXCESS * left =>
        {
            Ok(start.get().min(strongest.get()))
        }
        Err(MarkError::DistortionUnreachable { least, .. }) => {
            Err(MarkError::DistortionUnreachable { limit: limit.get(), least })
        }
        fitted => fitted,
    }
}

/// The first embedding of an own codeword that stays within the limit, with these shares of the
/// first strength, one after the other. `attempt` returns an embedding's MRMS and the embedding.
///
/// # Errors
/// [`MarkError::DistortionUnreachable`] when no embedding does; the errors of `attempt`.
pub(super) fn strongest_within<T>(
    limit: MaxDistortion,
    first: f64,
    shares: impl Iterator<Item = f64>,
    mut attempt: impl FnMut(Strength) -> Result<(f64, T), MarkError>,
) -> Result<T, MarkError> {
    let (mut refusal, mut least) = (None, f64::INFINITY);
    for share in shares {
        let alpha = if share < 1.0 { in_steps(share * first) } else { first };
        match attempt(Strength::new(alpha)?) {
            Ok((mrms, made)) if mrms <= limit.get() => return Ok(made),
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

/// The MRMS of the worst probe, or of one that is above `allowed`. `order` begins with the probe
/// that was worst so far, so that most strengths above `allowed` take one embedding. A probe that
/// the mesh cannot carry is ignored as long as the mesh carries another.
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
        for keys in 1..9 {
            let tried = (1..=keys).map(|key| shares(key == keys).count()).sum::<usize>();
            assert_eq!(u32::try_from(tried), Ok(blind_tries(keys)), "{keys}");
        }
    }

    /// The first strength by the probes, then the strength at which an own codeword is accepted,
    /// and how many were refused before.
    fn settled(
        start: f64,
        probe: &dyn Fn(usize, f64) -> Result<f64, MarkError>,
        own: &dyn Fn(f64) -> Result<f64, MarkError>,
    ) -> Result<(f64, usize), MarkError> {
        let limit = MaxDistortion::new(1e-4).unwrap();
        let start = Strength::new(start).unwrap();
        let first = first_strength(
            Room { limit, left: limit.get() },
            start,
            Strength::MAX,
            |place, strength| probe(place, strength.get()),
        )?;
        let mut tries = 0;
        let found = strongest_within(limit, first, shares(true), |strength| {
            tries += 1;
            own(strength.get()).map(|mrms| (mrms, strength.get()))
        });
        found.map(|alpha| (alpha, tries - 1))
    }

    /// The distortion of one codeword must not show in the strength, except through the number of
    /// tries.
    #[test]
    fn the_strength_follows_from_the_host_and_the_number_of_tries() {
        let mut by_tries = std::collections::BTreeMap::new();
        let found =
            |own: f64| settled(0.1, &|_, alpha| Ok(alpha * 1e-3), &|alpha| Ok(own * alpha * 1e-3));
        for own in [0.7, 0.9, 1.0, 1.2, 1.25, 1.26, 1.3, 1.36, 1.4, 1.5, 1.6, 1.8, 2.0] {
            let (alpha, refused) = found(own).unwrap();
            assert!(own * alpha * 1e-3 <= 1e-4, "{own}: the limit is passed");
            let known = *by_tries.entry(refused).or_insert(alpha);
            assert!((known - alpha).abs() < 1e-12, "{own}: {known} {alpha}");
            assert!((refused == 0) == (own <= 1.25), "{own}: {refused}");
        }
        assert!(by_tries.len() > 3);
        let none = found(9.0);
        assert!(matches!(none, Err(MarkError::DistortionUnreachable { .. })), "{none:?}");
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
        for worst in 0..PROBES.len() {
            let embeddings = std::cell::Cell::new(0);
            let probe = |place, alpha: f64| {
                embeddings.set(embeddings.get() + 1);
                Ok(if place == worst { 1.5 } else { 1.0 } * alpha * 1e-3)
            };
            let (alpha, refused) = settled(0.1, &probe, &|alpha| Ok(1.8 * alpha * 1e-3)).unwrap();
            assert_eq!(refused, 0, "a fifth more than the worst probe is within the limit");
            assert!(1.5 * alpha * 1e-3 > 0.9 * PROBE_SHARE * 1e-4, "{alpha} is weak");
            assert!(embeddings.get() <= 5, "{}", embeddings.get());
        }
    }

    #[test]
    fn one_probe_that_is_refused_says_nothing() {
        let found = |refused: &dyn Fn(usize) -> bool| {
            let probe =
                |place, alpha: f64| if refused(place) { Err(full()) } else { Ok(alpha * 1e-3) };
            settled(0.1, &probe, &|alpha| Ok(alpha * 1e-3))
        };
        for refused in 0..PROBES.len() {
            assert!(found(&|place| place == refused).is_ok());
        }
        let refused = found(&|_| true);
        assert!(matches!(refused, Err(MarkError::Watermark(_))), "{refused:?}");
    }

    /// Two cases: the weakest mark of the probes is within the limit but above their share of it,
    /// or it is above the limit but not by far.
    #[test]
    fn where_probes_do_not_fit_the_own_codeword_decides() {
        let found = |probes: f64, own: f64| {
            settled(0.1, &|_, alpha| Ok(probes + alpha * 1e-6), &|alpha| Ok(own + alpha * 1e-6))
        };
        let (alpha, refused) = found(9e-5, 8e-5).unwrap();
        assert!((alpha - LEAST).abs() < 1e-12 && refused == 0);
        let (alpha, refused) = found(2.9e-4, 8e-5).unwrap();
        assert!((alpha - 0.1).abs() < 1e-12 && refused == 0);
        for (probes, own) in [(9e-5, 1.1e-4), (3.1e-4, 8e-5), (2e-4, 1.1e-4)] {
            let Err(MarkError::DistortionUnreachable { limit, .. }) = found(probes, own) else {
                panic!("{probes} {own}")
            };
            assert!((limit - 1e-4).abs() < 1e-15);
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
