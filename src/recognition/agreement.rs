//! Whether a suspect has the shape of a host at all: a blind reader looks at distances from a centre only,
//! and these can be copied on to another object.

use super::model::{HostModel, SuspectModel};
use super::pose::{PoseKind, poses_until};
use crate::registration::{Effort, Within};

/// Which share of a suspect's surface lies on a host's, under the best of all pose hypotheses; `None` where that
/// cannot be told, or once `within.stop` answers `true`.
#[must_use]
pub fn share_on(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    effort: Effort,
    within: Within<'_>,
) -> Option<f64> {
    let mut best: Option<f64> = None;
    let _ = poses_until(host_model, suspect_model, effort, within, &mut |pose| {
        let in_order = match pose.kind {
            PoseKind::InPlace => !pose.correspondences.is_empty(),
            kind => kind == PoseKind::SameOrder,
        };
        // Turned as the host can be turned onto itself, it lies on the same share.
        // The same vertices at nearly the same places need no closer look.
        let share = if in_order {
            Some(1.0)
        } else if !pose.is_placed() || matches!(pose.kind, PoseKind::Turned(_)) {
            None
        } else {
            let suspect = suspect_model.surface(host_model);
            let (positions, mirrored) = pose.placed(suspect);
            let host = host_model.relief(within.stop);
            host.and_then(|host| host.share_on(suspect, &positions, mirrored, within.stop))
        };
        if let Some(share) = share {
            best = Some(best.map_or(share, |best| best.max(share)));
        }
        best.is_some_and(|share| share >= ENOUGH)
    });
    if (within.stop)() { None } else { Some(best.unwrap_or(0.0)) }
}

/// A share that no other pose hypothesis needs to beat.
const ENOUGH: f64 = 0.9;
