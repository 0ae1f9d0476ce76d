//! How much a suspect was smoothed: the host is smoothed until it fits the suspect best.
//!
//! A similarity that brought a moved suspect to the host was fitted to the unsmoothed host and took the
//! shrinkage of smoothing for a scale. The similarity is therefore fitted anew to each smoothed host.
//!
//! The search adds to the relief on meshes of few vertices. Measured on ten meshes with two keys each,
//! moved, after 10 and 20 rounds of smoothing: 20 and 20 of 20 marks are recognised. Without the search
//! it is 18 of 20 and 8 of 10, and none on a mesh of 10,000 vertices.
//!
//! Must not know codewords.

use glam::DVec3;

use super::nudge::SmallSimilarity;
use super::{Correspondence, HostFilter, JUDGES, median};

/// Rounds of smoothing (`lambda` 0.5) that are tried first; then those next to the best.
const SMOOTHINGS: [usize; 14] = [0, 1, 2, 3, 4, 5, 7, 10, 14, 20, 28, 40, 50, 70];

/// How many numbers of rounds in a row may fit no better than fewer rounds did before the search ends.
const PATIENCE: usize = 2;

/// Share of the misfit without smoothing below which a suspect counts as smoothed.
const SIGNIFICANT: f64 = 0.95;

/// A misfit below this many times the typical move of a mark comes from the mark, and smoothing is not
/// searched for.
const MARK_MISFIT: f64 = 1.1;

/// The host, smoothed as much as the suspect.
pub(super) struct SmoothingFit {
    pub(super) rounds: usize,
    /// `HostFilter::middle` after so many rounds.
    pub(super) middle: Vec<DVec3>,
    /// Moves correspondences to where they fit the smoothed host best.
    pub(super) nudge: SmallSimilarity,
}

/// A number of rounds, and how well it fits.
struct Trial {
    misfit: f64,
    nudge: SmallSimilarity,
    rounds: usize,
    middle: Vec<DVec3>,
}

impl HostFilter {
    /// The number of rounds of smoothing that fits the suspect best; `moved` when a similarity brought
    /// the suspect to the host.
    pub(super) fn best_smoothing(
        &self,
        correspondences: &[Correspondence],
        moved: bool,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> SmoothingFit {
        let judges: Vec<Correspondence> = correspondences
            .iter()
            .step_by((correspondences.len() / JUDGES).max(1))
            .copied()
            .collect();
        let trial = |rounds: usize, middle: &Vec<DVec3>, nudge: SmallSimilarity| {
            let pair = |s: &Correspondence| (s.at, middle[s.carrier as usize]);
            let pairs: Vec<(DVec3, DVec3)> = judges.iter().map(pair).collect();
            let nudge = if moved { nudge.onto(&pairs, stop) } else { nudge };
            let off = pairs.iter().map(|&(from, to)| nudge.apply(from).distance(to));
            (median(off.collect()), nudge, rounds)
        };
        let kept = |(misfit, nudge, rounds): (f64, SmallSimilarity, usize), middle: &[DVec3]| {
            Trial { misfit, nudge, rounds, middle: middle.to_vec() }
        };
        let mut now = self.middle.clone();
        let mut best = kept(trial(0, &now, SmallSimilarity::NONE), &now);
        let own = judges.iter().map(|s| 0.5 * self.difference[s.carrier as usize].length());
        if best.misfit <= MARK_MISFIT * median(own.collect()) {
            return SmoothingFit { rounds: 0, middle: now, nudge: SmallSimilarity::NONE };
        }
        let mut nudge = best.nudge;
        let (mut rounds, mut worse, mut least) = (0, 0, best.misfit);
        // What the best was smoothed from, and the number tried after it.
        let (mut before, mut after) = ((0, now.clone()), None);
        for upto in SMOOTHINGS.into_iter().skip(1) {
            if stop() {
                return SmoothingFit {
                    rounds: 0,
                    middle: best.middle,
                    nudge: SmallSimilarity::NONE,
                };
            }
            let next = self.smoothing().smoothed_until(now.clone(), upto - rounds, stop);
            let last = (rounds, std::mem::replace(&mut now, next));
            rounds = upto;
            let tried = trial(rounds, &now, nudge);
            nudge = tried.1;
            // Any decrease counts: for a suspect after many rounds, the first few rounds reduce the
            // misfit only a little.
            worse = if tried.0 < least { 0 } else { worse + 1 };
            least = least.min(tried.0);
            let clearly = if best.rounds == 0 { SIGNIFICANT } else { 1.0 };
            if tried.0 < clearly * best.misfit {
                best = kept(tried, &now);
                (before, after) = (last, None);
            } else {
                after = after.or(Some(upto));
            }
            if worse == PATIENCE {
                break;
            }
        }
        if best.rounds == 0 {
            return SmoothingFit { rounds: 0, middle: best.middle, nudge: SmallSimilarity::NONE };
        }
        // The numbers of rounds between entries of the table, one by one.
        let (mut rounds, mut now) = before;
        let mut worse = 0;
        nudge = best.nudge;
        while rounds + 1 < after.unwrap_or(best.rounds) && worse < PATIENCE && !stop() {
            now = self.smoothing().smoothed_until(now, 1, stop);
            rounds += 1;
            let tried = trial(rounds, &now, nudge);
            if tried.0 < best.misfit {
                best = kept(tried, &now);
                worse = 0;
            } else if rounds > best.rounds {
                worse += 1;
            }
        }
        let pair = |s: &Correspondence| (s.at, best.middle[s.carrier as usize]);
        let nudge = if moved {
            best.nudge.onto(&correspondences.iter().map(pair).collect::<Vec<_>>(), stop)
        } else {
            SmallSimilarity::NONE
        };
        SmoothingFit { rounds: best.rounds, middle: best.middle, nudge }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::super::tests::marked;
    use super::*;
    use crate::sample::Sample;
    use crate::watermark::Method;

    #[test]
    fn the_number_of_rounds_is_found_where_the_suspect_lies_and_where_a_fit_took_it() {
        let marked = marked(Sample::Knot, Method::ExactMean);
        let class = marked.codeword.layout_class();
        let filter = HostFilter::new(&marked.host, class, &marked.params).unwrap();
        let carriers = filter.surface().first_vertex.iter();
        let field: Vec<DVec3> = carriers.map(|&v| marked.positions[v as usize]).collect();
        let turn = DQuat::from_rotation_x(1e-3);
        for rounds in [6, 10, 12, 50] {
            let field =
                filter.smoothing().smoothed_until(field.clone(), rounds, &crate::mesh::stop::never);
            let seen = |at: &dyn Fn(DVec3) -> DVec3| -> Vec<Correspondence> {
                (0..)
                    .zip(&field)
                    .map(|(carrier, p)| Correspondence { carrier, at: at(*p) })
                    .collect()
            };
            // A fit to the unsmoothed host compensates some of the shrinkage.
            let cases = [(seen(&|p| p), false), (seen(&|p| turn * (1.01 * p) + 0.002), true)];
            for (correspondences, moved) in cases {
                assert_eq!(
                    filter.best_smoothing(&correspondences, moved, &|| false).rounds,
                    rounds,
                    "{moved}"
                );
                let turned = moved.then_some(DQuat::IDENTITY);
                let soft = filter.compare(&correspondences, turned).alone();
                let bound = soft.log10_bound(soft.score(&marked.codeword).t);
                assert!(bound < -5.0, "{rounds} {moved}: {bound}");
            }
        }
    }

    #[test]
    fn what_differs_by_the_mark_alone_was_not_smoothed() {
        for sample in Sample::ALL {
            let marked = marked(sample, Method::ExactMean);
            let class = marked.codeword.layout_class();
            let filter = HostFilter::new(&marked.host, class, &marked.params).unwrap();
            for moved in [false, true] {
                let carriers = (0..).zip(&filter.surface().first_vertex);
                let seen = carriers.map(|(carrier, &v)| Correspondence {
                    carrier,
                    at: marked.positions[v as usize],
                });
                let best_smoothing =
                    filter.best_smoothing(&seen.collect::<Vec<_>>(), moved, &|| false);
                assert_eq!(
                    (best_smoothing.rounds, best_smoothing.nudge),
                    (0, SmallSimilarity::NONE),
                    "{sample} {moved}"
                );
            }
        }
    }
}
