//! From pairs of points, many of which are wrong, to a similarity: RANSAC (Fischler and Bolles
//! 1981) over triples, then reweighted least squares over all.

use super::signatures::mix;
use crate::mesh::powers::{cubed, squared};
use crate::mesh::stop::{Stop, go_on};
use crate::registration::similarity::{Pair, Similarity, fit};

/// Triples tried at most. With one right pair in six, 2,000 triples include one of three right
/// pairs with a probability of 0.9999.
const TRIPLES: u32 = 2000;

/// Pairs on which a triple's similarity is judged.
const JUDGES: usize = 400;

/// Pairs farther apart than this are not inliers of a triple. A share of the suspect's diagonal:
/// noise of 0.5 % of the host is 2.5 % of a fragment with a fifth of its diagonal.
const TOLERANCE: f64 = 0.03;

/// Least number of inliers. Fewer prove nothing: three pairs always agree.
const LEAST_INLIERS: usize = 8;

/// Allowed scales from suspect to host, with diagonals of 1. A fragment has at least a hundredth of
/// its host's diagonal, and a host with additions to it is rarely larger than 20 times its own.
const SCALES: std::ops::Range<f64> = 0.005..20.0;

/// Residuals beyond this many medians do not count. Of Gaussian noise in three dimensions, 1 in
/// 10^11 lies beyond 5 medians.
const CUT: f64 = 5.0;

/// Smallest cut of residuals, a share of the host's diagonal.
const FLOOR: f64 = 1e-13;

/// Rounds of reweighting. Later rounds would move points by less than the noise.
const ROUNDS: usize = 15;

/// A similarity and how well the pairs agree with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consensus {
    /// From suspect to host.
    pub similarity: Similarity,
    /// Median distance between the pairs within the tolerance.
    pub median: f64,
    /// Pairs within the tolerance.
    pub inliers: usize,
}

/// The similarity that most pairs agree on, refined over all pairs that agree. `None` where too few
/// do, and once `stop` returns `true`.
///
/// Points are in units of the shapes' diagonals. Deterministic: triples come from a fixed sequence.
#[must_use]
pub fn consensus(pairs: &[Pair], mirrored: bool, stop: Stop<'_>) -> Option<Consensus> {
    if pairs.len() < LEAST_INLIERS {
        return None;
    }
    let judges: Vec<Pair> = if pairs.len() <= JUDGES {
        pairs.to_vec()
    } else {
        (0..JUDGES as u64).filter_map(|k| draw(pairs, mix(k, 0x6a75_6467_6573))).collect()
    };
    let mut best: Option<(usize, Similarity)> = None;
    let mut needed = TRIPLES;
    let mut tried = 0;
    while tried < needed.min(TRIPLES) {
        go_on(stop)?;
        let triple = pick(pairs, tried)?;
        tried += 1;
        let Some(similarity) = fit(&triple, mirrored).filter(plausible) else { continue };
        let count = inliers(&judges, &similarity).count();
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, similarity));
            needed = triples_for(count as f64 / judges.len() as f64);
        }
    }
    let (_, mut similarity) = best?;
    // The similarity of a triple is rough. A fit to all pairs that agree with it is better, and
    // then more pairs agree.
    for _ in 0..4 {
        go_on(stop)?;
        let agreeing: Vec<Pair> = inliers(pairs, &similarity).copied().collect();
        similarity = fit(&agreeing, mirrored).filter(plausible)?;
    }
    let found = refine(pairs, similarity, stop)?;
    (found.inliers >= LEAST_INLIERS).then_some(found)
}

fn plausible(similarity: &Similarity) -> bool {
    SCALES.contains(&similarity.scale.abs())
}

fn inliers<'a>(pairs: &'a [Pair], s: &'a Similarity) -> impl Iterator<Item = &'a Pair> {
    let tolerance = squared(TOLERANCE * s.scale.abs().min(1.0));
    pairs.iter().filter(move |p| s.apply(p.from).distance_squared(p.to) < tolerance)
}

/// Triples after which one of three right pairs was met with a probability of 1 - 10^-6, if `right`
/// is the share of right pairs.
fn triples_for(right: f64) -> u32 {
    let missed = libm::log((1.0 - cubed(right)).clamp(1e-9, 1.0 - 1e-9));
    let triples = (libm::log(1e-6) / missed).ceil().clamp(1.0, f64::from(TRIPLES));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to TRIPLES")]
    let triples = triples as u32;
    triples
}

fn draw(pairs: &[Pair], random: u64) -> Option<Pair> {
    let count = u64::try_from(pairs.len()).ok().filter(|&n| n >= 3)?;
    pairs.get(usize::try_from(random % count).ok()?).copied()
}

/// Three pairs at random.
fn pick(pairs: &[Pair], number: u32) -> Option<[Pair; 3]> {
    let draw = |k: u32| draw(pairs, mix(u64::from(3 * number + k), 0x7177_696e_7321));
    Some([draw(0)?, draw(1)?, draw(2)?])
}

/// Least squares over all pairs. Each is weighted by its residual: Tukey's biweight, scaled by the
/// median. `None` once `stop` returns `true`.
#[must_use]
pub fn refine(pairs: &[Pair], start: Similarity, stop: Stop<'_>) -> Option<Consensus> {
    let mirrored = start.scale < 0.0;
    let mut similarity = start;
    let mut weighted = pairs.to_vec();
    let mut distances = Vec::with_capacity(pairs.len());
    let mut found = None;
    for _ in 0..ROUNDS {
        go_on(stop)?;
        distances.clear();
        distances
            .extend(inliers(pairs, &similarity).map(|p| similarity.apply(p.from).distance(p.to)));
        let inliers = distances.len();
        let middle = inliers / 2;
        if inliers == 0 {
            return None;
        }
        let (_, &mut median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
        found = Some(Consensus { similarity, median, inliers });
        let cut = (CUT * median).max(FLOOR);
        for (w, p) in weighted.iter_mut().zip(pairs) {
            let share = similarity.apply(p.from).distance(p.to) / cut;
            w.weight = if share < 1.0 { p.weight * squared(1.0 - share * share) } else { 0.0 };
        }
        let Some(next) = fit(&weighted, mirrored).filter(plausible) else { break };
        similarity = next;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::similarity::tests::awkward;
    use glam::DVec3;

    fn noise(i: u32) -> DVec3 {
        let word = |k: u32| (mix(u64::from(3 * i + k), 5) >> 40) as f64 / f64::from(1 << 24);
        DVec3::new(word(0), word(1), word(2)) - 0.5
    }

    fn pairs(count: u32, wrong_of_ten: u32, truth: &Similarity, rough: f64) -> Vec<Pair> {
        let pair = |i: u32| {
            let from = noise(i);
            let to = if i % 10 < wrong_of_ten { noise(i + 99_999) } else { truth.apply(from) };
            Pair { from: from + rough * noise(i + 55_555), to, weight: 1.0 }
        };
        (0..count).map(pair).collect()
    }

    #[test]
    fn wrong_pairs_do_not_matter() {
        for scale in [0.4, -1.1] {
            let truth = Similarity { translation: DVec3::new(0.1, 0.2, -0.3), ..awkward(scale) };
            let pairs = pairs(500, 7, &truth, 0.0);
            let found = consensus(&pairs, scale < 0.0, &|| false).unwrap();
            assert!(found.inliers >= 150 && found.median < 1e-12, "{found:?}");
            assert!((found.similarity.scale - scale).abs() < 1e-9);
            // Points near a plane agree with their mirror image, too.
            let other = consensus(&pairs, scale > 0.0, &|| false).map_or(0, |c| c.inliers);
            assert!(other < 50, "{other}");
        }
    }

    #[test]
    fn noise_averages_out() {
        let truth = Similarity { translation: DVec3::ZERO, ..awkward(0.5) };
        let found = consensus(&pairs(4000, 3, &truth, 0.02), false, &|| false).unwrap();
        assert!(found.similarity.apply(DVec3::ZERO).length() < 5e-4, "{found:?}");
    }

    #[test]
    fn what_has_nothing_in_common_has_no_similarity() {
        assert_eq!(consensus(&pairs(3000, 10, &Similarity::IDENTITY, 0.0), false, &|| false), None);
        let heap = vec![Pair { from: DVec3::ZERO, to: DVec3::ZERO, weight: 1.0 }; 5000];
        assert_eq!(consensus(&heap, false, &|| false), None);
        assert_eq!(consensus(&[], false, &|| false), None);
    }
}
