//! Counting: from the bound of one hypothesis to a bound for the whole verification.
//!
//! The probability that any of many wrong hypotheses scores so high is at most the sum of the
//! probabilities of each (union bound). This error probability is divided beforehand: each stage
//! has a fixed share of it, and the shares add up to at most 1. Within its share, a stage counts
//! everything that it scored (`host_search` divides its share further). So
//! `log10_fp = log10_bound + log10(hypotheses of the stage / share of the stage)` holds whichever
//! stages ran and whenever the cascade was left. A stage that scores few records does not pay for
//! one that scored a million. The cascade may also decide after each stage whether to go on,
//! without a further correction. With one count for all stages it could not, because each decision
//! would be another chance of an error.
//!
//! Nothing here may depend on what was found.

use super::super::verdict::StageName;

/// The part of the error probability that a stage may spend. All shares add up to at most 1.
pub(super) fn share(stage: StageName) -> f64 {
    match stage {
        // Plain copies have decades to spare.
        StageName::Blind | StageName::InPlace | StageName::LayoutSearch => 0.0625,
        // The marks that are hardest to read are decided here: smoothed copies whose host is not
        // kept; new tessellations, fragments, hosts with very many marks.
        StageName::LayoutSearchNear | StageName::Relief => 0.25,
        StageName::HostFrame => 0.125,
        StageName::MatchedFilter => 0.171_875,
        StageName::LayoutSearchWide | StageName::Overmarks => 0.007_812_5,
    }
}

/// The factor on the bounds of a stage's hypotheses.
pub(super) fn counted(stage: StageName, hypotheses: u64) -> f64 {
    // At most 2^53 hypotheses: exact.
    hypotheses.max(1) as f64 / share(stage)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_add_up_to_at_most_one() {
        let sum: f64 = StageName::ALL.into_iter().map(share).sum();
        assert!(sum <= 1.0, "{sum}");
        assert!(StageName::ALL.into_iter().all(|stage| share(stage) > 0.0));
    }
}
