//! Whether a suspect has the shape of a host at all: a blind reader looks at distances from a centre only,
//! and these can be copied on to another object.

use super::home::{Home, Visitor};
use super::look::{LookKind, looks_until};
use crate::registration::{Effort, Within};

/// Which share of a suspect's surface lies on a host's, under the best of all looks; `None` where that
/// cannot be told, or once `within.stop` answers `true`.
#[must_use]
pub fn share_on(
    home: &Home,
    visitor: &Visitor<'_>,
    effort: Effort,
    within: Within<'_>,
) -> Option<f64> {
    let mut best: Option<f64> = None;
    let _ = looks_until(home, visitor, effort, within, &mut |look| {
        let in_order = match look.kind {
            LookKind::InPlace => !look.sightings.is_empty(),
            kind => kind == LookKind::SameOrder,
        };
        // (Turned as the host can be turned onto itself, it lies on the same share.)
        // The same vertices at nearly the same places need no closer look.
        let share = if in_order {
            Some(1.0)
        } else if !look.is_placed() || matches!(look.kind, LookKind::Turned(_)) {
            None
        } else {
            let suspect = visitor.surface(home);
            let (positions, mirrored) = look.placed(suspect);
            let host = home.relief(within.stop);
            host.and_then(|host| host.share_on(suspect, &positions, mirrored, within.stop))
        };
        if let Some(share) = share {
            best = Some(best.map_or(share, |best| best.max(share)));
        }
        best.is_some_and(|share| share >= ENOUGH)
    });
    if (within.stop)() { None } else { Some(best.unwrap_or(0.0)) }
}

/// A share that no other look needs to beat.
const ENOUGH: f64 = 0.9;
