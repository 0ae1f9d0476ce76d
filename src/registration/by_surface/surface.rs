//! Aligns a suspect with its host by the surface alone, whatever the triangles. Hypotheses are
//! judged and aligned on the host's surfels. The few that pass are aligned on all of the host's
//! triangles.

use std::borrow::Cow;

use super::icp::{AlignmentTarget, Fit, IcpTarget};
use super::moments::by_moments;
use super::nearest::mutual;
use super::partial::{self, by_parts};
use super::samples::{Point, scatter_until};
use crate::registration::budget::WorkLimits;
use crate::registration::prepared::{Alignment, Basis, Effort, PreparedHost, PreparedSuspect};
use crate::registration::similarity::Similarity;

/// Points of the suspect that judge hypotheses, and points of the final alignment.
const JUDGES: usize = 300;
const REFINED: usize = 20_000;

/// Distance within which a point counts as on the host, a share of the diagonal: before the
/// alignment, and after it.
pub(super) const ROUGH: f64 = 0.08;
pub(super) const FINE: f64 = 0.01;

/// Hypotheses that are aligned, and alignments that are returned, at most.
const ALIGNED_HYPOTHESES: usize = 12;
const RETURNED: usize = 3;

/// A whole suspect with this overlap is not searched for as a part.
const WHOLE: f64 = 0.95;

/// Least overlap of an alignment that is reported, and the share of it that suffices in a rough
/// measurement.
const LEAST_OVERLAP: f64 = 0.5;
const ROUGH_OVERLAP_RATIO: f64 = 0.7;

/// An alignment is dropped if its RMS distance is over `MOST_RMS_RATIO` times that of the best one, or its
/// overlap under `LEAST_OVERLAP_RATIO` times that of the best one. The RMS distance of the best one counts as at
/// least `LEAST_RMS`.
const MOST_RMS_RATIO: f64 = 3.0;
const LEAST_OVERLAP_RATIO: f64 = 0.7;
const LEAST_RMS: f64 = 2e-3;

/// Fewest carrier vertices of a part: with fewer, it fits anywhere.
const LEAST_PART: usize = 64;

/// Largest RMS distance of a part; a looser fit is an accident. Right alignments are at 0.0005,
/// those on other hosts at 0.002 to 0.005.
const LOOSEST_PART: f64 = 1.5e-3;

/// Rounds of an alignment by few points, by more, and by the most.
const FEW_ROUNDS: u32 = 12;
const MORE_ROUNDS: u32 = 15;
const LAST_ROUNDS: u32 = 8;

/// Points that measure what a search on the host's triangles costs, and the fewest points of an
/// alignment on them.
const PROBES: usize = 60;
const LEAST_POINTS: usize = 200;

/// Smallest reach for which surfels stand for the surface.
const SURFELS_REACH: f64 = 0.006;

/// The refined alignment of a suspect that kept its host's coordinates. `None` if the suspect does
/// not lie on the host, or once `within.stop` returns `true`.
#[must_use]
pub fn in_place(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    within: WorkLimits<'_>,
) -> Option<Alignment> {
    let start = suspect.shape.unit.inverse().then(&host.shape.unit);
    let roughly = host.surfels(within.stop)?.judge(&start, &suspect.points, FINE, within);
    if roughly.overlap < ROUGH_OVERLAP_RATIO * LEAST_OVERLAP {
        return None;
    }
    let target = host.target(within.stop)?;
    let found = target.judge(&start, &suspect.points, FINE, within);
    if found.overlap < LEAST_OVERLAP {
        return None;
    }
    let points = scatter_until(&suspect.shape, REFINED, within.stop)?;
    // Half of what is left: the other half is for a suspect that moved.
    let found = finish(host, suspect, target, &found, &points, within.budget.share(2), within);
    (!(within.stop)()).then_some(Alignment { basis: Basis::InPlace, ..found })
}

/// The rough share of the suspect's surface that lies on the host's, from 0 to 1; `None` when
/// stopped.
pub(in crate::registration) fn rough_share_on(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    similarity: &Similarity,
    within: WorkLimits<'_>,
) -> Option<f64> {
    let start = suspect.shape.unit.inverse().then(similarity).then(&host.shape.unit);
    Some(host.surfels(within.stop)?.judge(&start, &suspect.points, FINE, within).overlap)
}

/// The alignments by the surface alone, best first, without those that are nearly a `known` one;
/// empty when stopped.
#[must_use]
pub fn by_surface(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    effort: Effort,
    known: &[Alignment],
    within: WorkLimits<'_>,
) -> Vec<Alignment> {
    let guesses = by_moments(&host.points, &suspect.points, false);
    let mut fits = aligned(host, suspect, &guesses, within);
    let is_whole = fits.first().is_some_and(|fit| fit.overlap >= WHOLE);
    let is_part = suspect.shape.positions.len() >= LEAST_PART;
    if !is_whole && is_part && within.budget.left() >= partial::PRICE {
        within.budget.spend(partial::PRICE);
        let (Some(there), Some(here)) = (host.places(within.stop), suspect.places(within.stop))
        else {
            return Vec::new();
        };
        let mut guesses = by_parts(there, here, within.stop);
        if effort >= Effort::Thorough {
            guesses.extend(by_moments(&host.points, &suspect.points, true));
        }
        let loosest = if effort >= Effort::Thorough { f64::INFINITY } else { LOOSEST_PART };
        let parts = aligned(host, suspect, &guesses, within);
        fits.extend(parts.into_iter().filter(|fit| fit.rms <= loosest));
        best_first(&mut fits);
        drop_duplicates(&mut fits);
    }
    drop_accidents(&mut fits);
    let units = (suspect.shape.unit.inverse(), host.shape.unit);
    let known = known.iter().map(|a| units.0.then(&a.similarity).then(&units.1));
    let known: Vec<Similarity> = known.collect();
    fits.retain(|fit| known.iter().all(|k| k.apart(&fit.similarity) > FINE));
    if fits.is_empty() {
        return Vec::new();
    }
    let Some(target) = host.target(within.stop) else { return Vec::new() };
    let Some(points) = scatter_until(&suspect.shape, REFINED, within.stop) else {
        return Vec::new();
    };
    // Each alignment may spend half of what is left, the best one first.
    let last = fits.iter().take(RETURNED).take_while(|_| !(within.stop)());
    let found =
        last.map(|fit| finish(host, suspect, target, fit, &points, within.budget.share(2), within));
    let found = found.filter(|alignment| alignment.overlap > LEAST_OVERLAP).collect();
    // An alignment that was cut short is not valid.
    if (within.stop)() { Vec::new() } else { found }
}

fn to_files(host: &PreparedHost, suspect: &PreparedSuspect, fit: &Fit) -> Alignment {
    Alignment {
        similarity: suspect.shape.unit.then(&fit.similarity).then(&host.shape.unit.inverse()),
        basis: Basis::Surface,
        overlap: fit.overlap,
        rms: fit.rms,
        pairs: Vec::new(),
    }
}

/// Drops fits that are accidents in comparison with the best one.
fn drop_accidents(fits: &mut Vec<Fit>) {
    if let Some(&best) = fits.first() {
        let loosest = MOST_RMS_RATIO * best.rms.max(LEAST_RMS);
        fits.retain(|fit| fit.rms <= loosest && fit.overlap >= LEAST_OVERLAP_RATIO * best.overlap);
    }
}

/// Judges hypotheses by few points, aligns the better ones by more, and returns those that lie on
/// the host, best first.
fn aligned(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    guesses: &[Similarity],
    within: WorkLimits<'_>,
) -> Vec<Fit> {
    let Some(surfels) = host.surfels(within.stop) else { return Vec::new() };
    let judges = suspect.some(JUDGES);
    // The reach must not span all of a small part.
    let reach = |s: &Similarity| ROUGH * s.scale.abs().clamp(0.2, 1.0);
    let mut judged: Vec<Fit> = guesses
        .iter()
        .take_while(|_| !(within.stop)())
        .map(|guess| surfels.judge(guess, &judges, reach(guess), within))
        .collect();
    best_first(&mut judged);
    let closer = |fit: &Fit, points: &[Point], to: f64, rounds: u32, share: u64| {
        let reach = reach(&fit.similarity);
        let end = to * reach / ROUGH;
        let target = if end < SURFELS_REACH { host.target(within.stop) } else { None };
        let searched = target.and_then(|target| {
            let cost = cost_of_a_search(target, &fit.similarity, points, reach, within);
            let points = affordable(points, share / cost / u64::from(rounds + 1))?;
            Some((target as &dyn AlignmentTarget, points))
        });
        // Surfels cost the same few look-ups on any host.
        let (ground, points) = searched.unwrap_or((surfels, Cow::Borrowed(points)));
        let similarity = ground.align(&fit.similarity, &points, reach..end, rounds, within);
        ground.judge(&similarity, &points, end, within)
    };
    // Each of the two stages here may spend half of what is left.
    let each = within.budget.share(2 * ALIGNED_HYPOTHESES);
    let mut fits: Vec<Fit> = judged
        .iter()
        .take(ALIGNED_HYPOTHESES)
        .take_while(|_| !(within.stop)())
        .map(|guess| closer(guess, &judges, 2.0 * FINE, FEW_ROUNDS, each))
        .collect();
    best_first(&mut fits);
    drop_duplicates(&mut fits);
    fits.truncate(RETURNED);
    let each = within.budget.share(2 * RETURNED);
    let mut fits: Vec<Fit> = fits
        .iter()
        .take_while(|_| !(within.stop)())
        .map(|fit| closer(fit, &suspect.points, FINE, MORE_ROUNDS, each))
        .collect();
    fits.retain(|fit| fit.overlap > ROUGH_OVERLAP_RATIO * LEAST_OVERLAP);
    best_first(&mut fits);
    drop_duplicates(&mut fits);
    fits
}

/// Sorts by overlap times closeness, the best first. Distances count relative to the suspect's
/// size, because a tiny suspect lies close to any surface.
fn best_first(fits: &mut [Fit]) {
    let merit = |fit: &Fit| {
        let scale = fit.similarity.scale.abs().clamp(0.01, 1.0);
        fit.overlap * (1.0 - (fit.rms / (ROUGH * scale)).min(1.0))
    };
    fits.sort_by(|a, b| merit(b).total_cmp(&merit(a)));
}

/// Drops fits that are nearly equal to a better one.
fn drop_duplicates(fits: &mut Vec<Fit>) {
    let mut kept: Vec<Fit> = Vec::new();
    for fit in fits.iter() {
        let same = |other: &Fit| fit.similarity.apart(&other.similarity) < FINE;
        if !kept.iter().any(same) {
            kept.push(*fit);
        }
    }
    *fits = kept;
}

/// About how many tests a search on the host's triangles takes; at least 1.
fn cost_of_a_search(
    target: &IcpTarget,
    s: &Similarity,
    points: &[Point],
    reach: f64,
    within: WorkLimits<'_>,
) -> u64 {
    let probes: Vec<Point> = thinned(points, PROBES);
    let before = within.budget.spent();
    let _ = target.touches(s, &probes, reach, within);
    ((within.budget.spent() - before) / probes.len().max(1) as u64).max(1)
}

/// About `most` of the points, evenly spread.
fn thinned(points: &[Point], most: usize) -> Vec<Point> {
    points.iter().step_by(points.len().div_ceil(most.max(1)).max(1)).copied().collect()
}

/// All points, or `count` of them; `None` where those are too few for an alignment.
fn affordable(points: &[Point], count: u64) -> Option<Cow<'_, [Point]>> {
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    if count >= points.len() {
        return Some(Cow::Borrowed(points));
    }
    (count >= LEAST_POINTS).then(|| Cow::Owned(thinned(points, count)))
}

/// The last stage: aligns the suspect to all of the host's triangles, then pairs vertices that lie
/// on vertices. The pairs do not influence the alignment. Simplification puts vertices outside the
/// host's surface, smoothing puts them inside, and nearest vertices pull in random directions.
///
/// Takes about `share` tests at most. Where searches are expensive, it uses fewer points. Where
/// pairs would take more than half of the share, it makes none. Where nothing can be afforded, it
/// keeps the fit.
fn finish(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    target: &IcpTarget,
    fit: &Fit,
    points: &[Point],
    share: u64,
    within: WorkLimits<'_>,
) -> Alignment {
    let cost = cost_of_a_search(target, &fit.similarity, points, FINE, within);
    let vertices = suspect.shape.positions.len();
    let paired = (vertices as u64).saturating_mul(cost);
    let paired = if paired <= share / 2 { paired } else { 0 };
    let searches = (share - paired) / cost / u64::from(LAST_ROUNDS + 1);
    let Some(points) = affordable(points, searches) else {
        return to_files(host, suspect, fit);
    };
    let end = (3.0 * fit.rms).clamp(1e-4, FINE);
    let similarity = target.align(&fit.similarity, &points, FINE..end, LAST_ROUNDS, within);
    let fit = target.judge(&similarity, &points, FINE, within);
    if paired == 0 {
        return to_files(host, suspect, &fit);
    }
    let mut pairs = mutual(&host.shape, target, &suspect.shape, &fit.similarity, FINE, within);
    // Subdivision keeps all of the host's vertices and adds three times as many.
    let fewer = vertices.min(host.shape.positions.len());
    if pairs.len() * 2 < fewer {
        pairs.clear();
    }
    Alignment { pairs, ..to_files(host, suspect, &fit) }
}
