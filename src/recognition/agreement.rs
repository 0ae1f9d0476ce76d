//! Whether a suspect has the shape of a host at all. A blind reader only uses distances from a
//! centre, and these can be copied onto another object.

use super::model::{HostModel, SuspectModel};
use super::pose::{PoseKind, poses_until};
use crate::registration::{Effort, WorkLimits};

/// The largest share of a suspect's surface that lies on a host's, over all pose hypotheses; 0
/// where none places the suspect. `None` once `within.stop` returns `true`.
#[must_use]
pub fn share_on(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    effort: Effort,
    within: WorkLimits<'_>,
) -> Option<f64> {
    let mut best: Option<f64> = None;
    let _ = poses_until(host_model, suspect_model, effort, within, &mut |pose| {
        let in_order = match pose.kind {
            PoseKind::InPlace => !pose.correspondences.is_empty(),
            kind => kind == PoseKind::SameOrder,
        };
        // The same vertices at nearly the same positions need no measurement. A pose hypothesis
        // that differs by a symmetry of the host has the same share.
        let share = if in_order {
            Some(1.0)
        } else if !pose.is_placed() || matches!(pose.kind, PoseKind::Symmetric(_)) {
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

/// From this share on, no other pose hypothesis is tried.
const ENOUGH: f64 = 0.9;
