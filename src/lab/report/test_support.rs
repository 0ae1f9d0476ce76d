//! Results for tests of reports.

use crate::lab::summary::Group;

/// Fifty perfect trials on a mesh with a diagonal of 1.
pub fn group() -> Group {
    Group {
        experiment: "figures 5-9, table 2".into(),
        mesh: "bunny".into(),
        method: "qsp-mean".into(),
        strength: 0.1,
        bits: 64,
        closed_loop: true,
        budget: None,
        attack: "no attack".into(),
        family: "none".into(),
        amount: None,
        trials: 50,
        failed: 0,
        error: None,
        detection_ratio: 1.0,
        detection_ratio_deviation: 0.0,
        bit_error_rate: 0.0,
        log10_bound: -19.3,
        log10_bound_worst: -19.3,
        matches: 1.0,
        log10_bound_in_place: -19.3,
        matches_in_place: 1.0,
        log10_bound_relief: None,
        matches_with_host: 1.0,
        vertices: 35_947,
        diagonal: 1.0,
        strength_used: 0.1,
        fell_back: 0,
        mark_mrms: 1e-4,
        mark_mrms_deviation: 1e-5,
        mark_hausdorff: 1e-3,
        mark_normal_deviation: 1.0,
        mark_flipped: 0.0,
        mark_perceived: None,
        attacked_mrms: None,
        attacked_hausdorff: None,
    }
}
