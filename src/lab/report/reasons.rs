//! Why a result differs from the printed one, as far as the rows show it. Each row has the bound in
//! the suspect's own frame and the bound in the host's frame.

use crate::lab::summary::Group;

/// Differences of detection ratios below this count as none. With ten trials of 64 bits, a ratio of
/// 0.8 has a standard error of about 0.016, with fifty trials of 0.007.
pub const ALIKE: f64 = 0.03;

/// Thresholds of the share that the host's frame recovers of the decades lost to an attack. Above
/// the first, the suspect's own frame is the reason. Below the second, the frame has no part in it.
const ALL_OF_IT: f64 = 0.8;
const NONE_OF_IT: f64 = 0.2;

/// Bounds that differ by less than this many decades count as equal.
const DECADES: f64 = 1.0;

/// Number of standard errors beyond which a difference of means is not chance.
const CERTAIN: f64 = 3.0;

/// Fewer marks than this do not show their spread.
const FEWEST: usize = 10;

/// Number of marks that the paper averages over (section 5).
const PAPERS_TRIALS: f64 = 50.0;

/// Half a unit of the last digit that the paper prints of a distortion.
const ROUNDING: f64 = 0.005;

/// Whether two results are of the same mark of the same mesh.
pub fn same_mark(a: &Group, b: &Group) -> bool {
    a.experiment == b.experiment && a.closed_loop == b.closed_loop && same_but_for_loop(a, b)
}

/// As `same_mark`, except for the experiment and the number of passes.
pub fn same_but_for_loop(a: &Group, b: &Group) -> bool {
    a.mesh == b.mesh
        && a.method == b.method
        && a.bits == b.bits
        && a.strength.to_bits() == b.strength.to_bits()
        && a.budget == b.budget
}

/// Why a detection ratio is above or below the printed one; empty if it is neither. `before` is the
/// same mark without an attack. `single_pass` is the share of bits that are read right without an
/// attack after a single pass, which is how the paper makes its marks.
pub fn of_ratio(
    group: &Group,
    printed: f64,
    before: Option<&Group>,
    single_pass: Option<f64>,
) -> String {
    let more = group.detection_ratio - printed;
    if more.abs() < ALIKE {
        return String::new();
    }
    let start = before.map_or(1.0, |before| before.detection_ratio);
    if more > 0.0 {
        let single = single_pass.map_or_else(String::new, |share| {
            format!(", in a single pass, as the paper makes it, with {:.1} %", 100.0 * share)
        });
        return format!(
            "not told by the rows; ours begin with {:.1} % of the bits right and equal \
             margins{single} (benches/gaps.rs attacks both)",
            100.0 * start
        );
    }
    let (blind, known) = (group.log10_bound, group.log10_bound_in_place);
    if group.family == "similarity" {
        return format!("moved: the host's frame tells nothing (10^{blind:.1} blindly)");
    }
    let best = before.map_or_else(
        || -(group.bits as f64) * std::f64::consts::LOG10_2,
        |before| before.log10_bound,
    );
    let missing = if start < 1.0 {
        format!("; {:.1} % of the bits were right before it", 100.0 * start)
    } else {
        String::new()
    };
    let given_back = (blind - known) / (blind - best).max(f64::MIN_POSITIVE);
    let reason = if given_back > ALL_OF_IT {
        "the frame: the attack moved the suspect's centre or the extremes of its norms"
    } else if given_back < NONE_OF_IT {
        "the bins: the attack changed what is in them"
    } else {
        "the frame in part (centre or extremes of the norms), for the rest what is in the bins"
    };
    format!("{reason} (10^{blind:.1} blindly, 10^{known:.1} in the host's frame{missing})")
}

/// Mean bounds of two kinds of marks, as decimal logarithms.
#[derive(Clone, Copy)]
pub struct Bounds {
    /// Of the marks that should be better, or equal.
    pub first: f64,
    /// Of the others.
    pub second: f64,
}

impl Bounds {
    fn fit(self, alike: bool) -> bool {
        let more = self.second - self.first;
        if alike { more.abs() < DECADES } else { more > DECADES }
    }
}

/// What the bounds say about a comparison of marks whose result differs from the printed one.
pub fn of_comparison(blind: Bounds, known: Bounds, alike: bool) -> String {
    let bounds = format!(
        "mean bounds 10^{:.1} and 10^{:.1} blindly, 10^{:.1} and 10^{:.1} in the host's frame",
        blind.first, blind.second, known.first, known.second
    );
    // Both frames are judged by the same rule.
    if !blind.fit(alike) && known.fit(alike) {
        format!("the suspects' frames; in the host's it holds: {bounds}")
    } else {
        bounds
    }
}

/// Why the mean distortion of marks differs from the printed one. The paper's mesh has `vertices`
/// vertices.
pub fn of_distortion(group: &Group, printed: f64, vertices: usize) -> String {
    if group.vertices != vertices {
        return format!(
            "another mesh: {} vertices, the paper's had {vertices}; only ratios between methods \
             compare",
            group.vertices
        );
    }
    let scale = 1e4 * group.diagonal;
    let off = ((scale * group.mark_mrms - printed).abs() - ROUNDING).max(0.0);
    if off <= 0.0 {
        return "the same, as far as digits were printed".into();
    }
    if group.trials < FEWEST || group.mark_mrms_deviation <= 0.0 {
        return "too few marks to tell how much they differ by key and message".into();
    }
    let trials = group.trials as f64;
    let one = scale * group.mark_mrms_deviation * (trials / (trials - 1.0)).sqrt();
    let error = one * (1.0 / trials + 1.0 / PAPERS_TRIALS).sqrt();
    let spread = format!(
        "by key and message single marks deviate by {one:.3} and two such means by {error:.3}"
    );
    if off <= CERTAIN * error {
        format!("{spread}: luck")
    } else {
        format!(
            "{spread}; these by {:.0} times that, more than luck: the paper's centre and trim are \
             misprinted, and its bins may lie elsewhere than in the reading that was taken",
            off / error
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::report::test_support::group;

    #[test]
    fn reasons_follow_from_the_two_frames() {
        let lost = Group { detection_ratio: 0.6, log10_bound: -1.0, ..group() };
        for (known, reason) in
            [(-18.0, "the frame: "), (-2.0, "the bins: "), (-9.0, "the frame in part")]
        {
            let lost = Group { log10_bound_in_place: known, ..lost.clone() };
            let text = of_ratio(&lost, 1.0, None, None);
            assert!(text.starts_with(reason), "{text}");
            let moved = Group { family: "similarity".into(), ..lost };
            assert!(of_ratio(&moved, 1.0, None, None).starts_with("moved"));
        }
        // Bits that were wrong before the attack are not attributed to it.
        let before = Group { detection_ratio: 0.7, log10_bound: -4.0, ..group() };
        let after = Group { log10_bound_in_place: -3.8, ..lost };
        let text = of_ratio(&after, 1.0, Some(&before), None);
        assert!(text.starts_with("the frame: ") && text.contains("70.0 %"), "{text}");
    }

    #[test]
    fn what_the_rows_do_not_tell_is_said_so() {
        let better = Group { detection_ratio: 0.95, ..group() };
        let text = of_ratio(&better, 0.75, Some(&group()), Some(0.97));
        assert!(text.starts_with("not told") && text.contains("97.0 %"), "{text}");
        assert_eq!(of_ratio(&better, 0.96, None, None), "");
    }

    #[test]
    fn a_comparison_is_the_frames_fault_by_one_rule_alone() {
        let bounds = |first, second| Bounds { first, second };
        for (blind, known, alike, frames) in [
            (bounds(-5.0, -5.5), bounds(-12.0, -5.0), false, true),
            (bounds(-12.0, -5.0), bounds(-13.0, -5.0), false, false),
            (bounds(-5.0, -5.5), bounds(-5.0, -5.5), false, false),
            (bounds(-5.0, -5.5), bounds(-5.0, -12.0), false, false),
            (bounds(-5.0, -9.0), bounds(-12.0, -12.5), true, true),
            (bounds(-5.0, -9.0), bounds(-5.0, -12.0), true, false),
        ] {
            let text = of_comparison(blind, known, alike);
            assert_eq!(text.starts_with("the suspects' frames"), frames, "{text}");
        }
    }

    #[test]
    fn distortion_is_held_against_its_spread() {
        // 1e4 times the diagonal is 1e4.
        let own = Group {
            mark_mrms: 1.1e-4,
            mark_mrms_deviation: 5e-5,
            vertices: 7,
            trials: 50,
            ..group()
        };
        assert!(of_distortion(&own, 1.0, 7).ends_with(": luck"));
        assert!(of_distortion(&own, 1.0, 8).starts_with("another mesh: 7"));
        assert!(of_distortion(&own, 1.1, 7).starts_with("the same"));
        for unsure in
            [Group { trials: 2, ..own.clone() }, Group { mark_mrms_deviation: 0.0, ..own.clone() }]
        {
            assert!(of_distortion(&unsure, 1.0, 7).starts_with("too few"));
        }
        let sure = Group { mark_mrms_deviation: 5e-6, ..own };
        assert!(of_distortion(&sure, 1.0, 7).contains("more than luck:"));
    }
}
