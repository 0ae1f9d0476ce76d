//! Why a figure of ours differs from one that was printed, as far as the rows themselves tell: each
//! has the bound in the suspect's own frame beside the bound in the host's.

use crate::lab::summary::Group;

/// Differences of detection ratios below this are none. (With ten trials of 64 bits, a ratio of 0.8
/// has a standard error of about 0.016, with fifty of 0.007.)
pub const ALIKE: f64 = 0.03;

/// Of the decades that an attack costs, the share that the host's frame gives back where the
/// suspect's own frame is the reason; and where it has no part in it.
const ALL_OF_IT: f64 = 0.8;
const NONE_OF_IT: f64 = 0.2;

/// Bounds that differ by less than this many decades are alike.
const DECADES: f64 = 1.0;

/// Standard errors beyond which a difference of means is not luck.
const CERTAIN: f64 = 3.0;

/// Fewer marks do not show how much they differ.
const FEWEST: usize = 3;

/// Marks that the paper averages over.
const PAPERS_TRIALS: f64 = 50.0;

/// Why a detection ratio is above or below the printed one; empty when it is neither. `single_pass`
/// is the share of bits that the same method reads right before any attack when it is made as the
/// paper does.
pub fn of_ratio(group: &Group, printed: f64, single_pass: Option<f64>) -> String {
    let more = group.detection_ratio - printed;
    if more.abs() < ALIKE {
        return String::new();
    }
    if more > 0.0 {
        let start = single_pass.filter(|share| *share < 1.0);
        let start = start.map_or_else(String::new, |share| {
            format!(", the paper's single pass with {:.1} % of them", 100.0 * share)
        });
        // Whether that is the whole reason, the rows do not tell.
        return format!(
            "the closed loop begins with every bit right and equal margins{start} (a single pass \
             under the same attack: benches/gaps.rs)"
        );
    }
    let (blind, known) = (group.log10_bound, group.log10_bound_in_place);
    let best = -(group.bits as f64) * std::f64::consts::LOG10_2;
    let bounds = format!("10^{blind:.1} blindly, 10^{known:.1} in the host's frame");
    let given_back = (blind - known) / (blind - best).max(f64::MIN_POSITIVE);
    let reason = if given_back > ALL_OF_IT {
        "the frame: the attack moved the suspect's centre or the extremes of its norms"
    } else if given_back < NONE_OF_IT {
        "the bins: the attack changed what is in them"
    } else {
        "the frame in part (centre or extremes of the norms), for the rest what is in the bins"
    };
    format!("{reason} ({bounds})")
}

/// What the host's frame says of a comparison of marks that came out otherwise than printed: mean
/// bounds of the first, which should be the better ones (or alike), and of the second.
pub fn of_comparison(first: f64, second: f64, alike: bool) -> String {
    let more = second - first;
    let holds = if alike { more.abs() < DECADES } else { more > DECADES };
    let there = match (holds, more.abs() < DECADES) {
        (true, _) => "there it holds, so that it is the suspects' frames",
        (false, true) => "no difference there either",
        (false, false) => "as here, so that it is the bins themselves",
    };
    format!("in the host's frame the mean bounds are 10^{first:.1} and 10^{second:.1}: {there}")
}

/// Why the mean distortion of marks is another than printed, for a mesh of so many `vertices`.
pub fn of_distortion(group: &Group, printed: f64, vertices: usize) -> String {
    if group.vertices != vertices {
        return format!(
            "another mesh: {} vertices, the paper's had {vertices}; only ratios between methods \
             compare",
            group.vertices
        );
    }
    if group.trials < FEWEST {
        return "too few marks to tell how much they differ by key and message".into();
    }
    let trials = group.trials as f64;
    let one = 1e4 * group.diagonal * group.mark_mrms_deviation;
    let error = one * (1.0 / trials + 1.0 / PAPERS_TRIALS).sqrt();
    let off = (1e4 * group.diagonal * group.mark_mrms - printed).abs() / error;
    let spread = format!(
        "by key and message single marks deviate by {one:.3} and two such means by {error:.3}"
    );
    if off <= CERTAIN {
        format!("{spread}: luck")
    } else {
        format!(
            "{spread}; these by {off:.0} times that, more than luck: the paper's centre and trim are \
             misprinted, and its bins may lie elsewhere than in the reading that was taken"
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
        let framed = Group { log10_bound_in_place: -18.0, ..lost.clone() };
        assert!(of_ratio(&framed, 1.0, None).starts_with("the frame: "));
        let gone = Group { log10_bound_in_place: -2.0, ..lost };
        assert!(of_ratio(&gone, 1.0, None).starts_with("the bins: "));
        let both = Group { log10_bound_in_place: -9.0, ..gone.clone() };
        assert!(of_ratio(&both, 1.0, None).starts_with("the frame in part"));
        let better = Group { detection_ratio: 0.95, ..group() };
        assert!(of_ratio(&better, 0.75, Some(0.97)).contains("97.0 %"));
        assert!(!of_ratio(&better, 0.75, Some(1.0)).contains('%'));
        assert_eq!(of_ratio(&better, 0.96, None), "");
    }

    #[test]
    fn comparisons_are_made_again_in_the_hosts_frame() {
        for (first, second, alike, said) in [
            (-12.0, -5.0, false, "there it holds"),
            (-5.0, -5.5, false, "no difference"),
            (-5.0, -12.0, false, "as here"),
            (-5.0, -5.5, true, "there it holds"),
            (-5.0, -12.0, true, "as here"),
        ] {
            let text = of_comparison(first, second, alike);
            assert!(text.contains(said), "{text}");
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
        let few = Group { trials: 2, ..own.clone() };
        assert!(of_distortion(&few, 1.0, 7).starts_with("too few"));
        let sure = Group { mark_mrms_deviation: 5e-6, ..own };
        assert!(of_distortion(&sure, 1.0, 7).contains("more than luck:"));
    }
}
