//! The relief of one mark, read from a suspect wherever a look has it.

use glam::DVec3;

use super::home::{Home, Visitor};
use super::look::{Look, LookKind, looks_until};
use crate::registration::{Effort, Within};
use crate::relief::{Amplitude, ReliefReading, Signs};
use crate::watermark::MarkKey;

/// What one relief says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReliefFound {
    /// log10 of the bound on the probability that a fresh key reads so well, all looks counted.
    pub log10_fp: f64,
    /// Cells that were read.
    pub read: usize,
    /// Those of them whose sign agrees.
    pub agreeing: usize,
}

/// Whether a look says where the suspect's surface lies: one that only assumes that nothing was moved
/// is followed by another ([`LookKind::Near`]) where that is so.
#[must_use]
pub fn is_placed(look: &Look) -> bool {
    look.kind != LookKind::InPlace || !look.sightings.is_empty()
}

/// What a suspect's surface says of the signs of a host, at a look; `None` where it is nowhere near, the
/// look does not say where it is, or once `within.stop` answers `true`.
#[must_use]
pub fn relief_at(
    home: &Home,
    visitor: &Visitor<'_>,
    look: &Look,
    amplitude: Amplitude,
    within: Within<'_>,
) -> Option<ReliefReading> {
    if !is_placed(look) {
        return None;
    }
    let host = home.relief(within.stop)?;
    let suspect = visitor.surface();
    let positions: Vec<DVec3> =
        suspect.positions.iter().map(|p| look.similarity.apply(*p)).collect();
    let mirrored = look.similarity.scale < 0.0;
    ReliefReading::new(host, suspect, &positions, mirrored, amplitude.get(), within.stop)
}

/// The best that the relief of a key reads with.
#[must_use]
pub fn relief_of(
    home: &Home,
    visitor: &Visitor<'_>,
    key: &MarkKey,
    amplitude: Amplitude,
    within: Within<'_>,
) -> Option<ReliefFound> {
    /// A bound that needs no other look.
    const CERTAIN: f64 = -15.0;
    let mut best: Option<ReliefFound> = None;
    let _ = looks_until(home, visitor, Effort::Whole, within, &mut |look| {
        if let Some(reading) = relief_at(home, visitor, look, amplitude, within) {
            let signs = Signs::new(key, reading.signed_weights().len());
            let log10_bound = reading.log10_bound(reading.score(&signs));
            let log10_fp = (log10_bound - libm::log10(look.kind.share())).min(0.0);
            let (read, agreeing) = reading.agreeing(&signs);
            if best.is_none_or(|best| log10_fp < best.log10_fp) {
                best = Some(ReliefFound { log10_fp, read, agreeing });
            }
        }
        best.is_some_and(|best| best.log10_fp < CERTAIN)
    });
    best
}
