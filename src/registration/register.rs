//! The whole way: from a host and a suspect to the similarities that bring the one home to the
//! other.

use std::sync::OnceLock;

use super::align::{Fit, Stop, Target};
use super::moments::by_moments;
use super::nearest::mutual;
use super::parts::{by_parts, sights};
use super::polish::polish;
use super::scatter::{Point, scatter};
use super::shape::Shape;
use super::similarity::Similarity;
use super::twins::{Landmarks, Twins, contacts, twins};

/// Points of the suspect that judge hypotheses, and those that the final alignment goes by.
const JUDGES: usize = 300;
const ALIGNED: usize = 3000;
const DESCRIBED: usize = 6000;
const REFINED: usize = 20_000;

/// Distance at which a hypothesis' point counts as on the host, a share of the diagonal; the same
/// once it is aligned.
const ROUGH: f64 = 0.08;
const FINE: f64 = 0.01;

/// Hypotheses that are aligned, and that are returned.
const ALIGNED_HYPOTHESES: usize = 12;
const RETURNED: usize = 3;

/// Twins that make up this share of the suspect leave nothing to search for.
const TWINS_SUFFICE: f64 = 0.2;

/// A whole that lies on its host like this need not be searched for as a part.
const WHOLE: f64 = 0.95;

/// Overlap from which an alignment is worth telling.
const LEAST_OVERLAP: f64 = 0.5;

/// How hard to try.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effort {
    /// Shared vertices only: fractions of a second, and nothing where the tessellation is new.
    Twins,
    /// Also wholes that were tessellated anew.
    Whole,
    /// Also parts that were tessellated anew, and mirrored wholes: seconds.
    Thorough,
}

/// What an alignment rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// The file's own coordinates, which were kept.
    InPlace,
    /// Vertices that suspect and host share.
    Twins,
    /// The surface.
    Surface,
}

/// A suspect brought home.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// From the suspect file's coordinates to the host file's.
    pub similarity: Similarity,
    /// What it rests on.
    pub basis: Basis,
    /// Share of the suspect that lies on the host: of its carriers that are paired, or of its area.
    pub overlap: f64,
    /// Root mean square distance over that share, relative to the host's diagonal.
    pub rms: f64,
    /// Carriers of the suspect and of the host that are one vertex, ascending by the first. Where
    /// the basis is the surface they are nearest to each other and no more; none where most of the
    /// one that has fewer have no such partner.
    pub pairs: Vec<[u32; 2]>,
}

/// A host made ready; worth keeping while several suspects are compared with it.
pub struct PreparedHost {
    shape: Shape,
    landmarks: Landmarks,
    points: Vec<Point>,
    /// Built when first asked for: twins do without.
    target: OnceLock<Option<Target>>,
}

/// A suspect made ready.
pub struct PreparedSuspect {
    shape: Shape,
    points: Vec<Point>,
}

impl PreparedHost {
    /// Takes a shape over.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        let (landmarks, points) = (Landmarks::new(&shape), scatter(&shape, ALIGNED));
        Self { shape, landmarks, points, target: OnceLock::new() }
    }

    /// Its shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    fn target(&self) -> Option<&Target> {
        self.target.get_or_init(|| Target::new(&self.shape)).as_ref()
    }
}

impl PreparedSuspect {
    /// Takes a shape over.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        let points = scatter(&shape, ALIGNED);
        Self { shape, points }
    }

    /// Its shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// About so many of its points, spread over all of it.
    fn some(&self, count: usize) -> Vec<Point> {
        self.points.iter().step_by((self.points.len() / count).max(1)).copied().collect()
    }
}

/// The similarities under which `suspect` is a part of `host`, best first; few, and none where
/// there is nothing in common. `stop` is asked between steps, the longest of which take tenths of
/// seconds on meshes of half a million vertices; `true` returns twins or nothing.
#[must_use]
pub fn register(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    effort: Effort,
    stop: Stop,
) -> Vec<Alignment> {
    if let Some(found) = twins(&host.shape, &host.landmarks, &suspect.shape) {
        let alignment = from_twins(host, suspect, found);
        if alignment.overlap > TWINS_SUFFICE || effort == Effort::Twins {
            return vec![alignment];
        }
        let mut all = by_surface(host, suspect, effort, stop);
        all.retain(|other| other.overlap > 2.0 * alignment.overlap);
        all.push(alignment);
        return all;
    }
    if effort == Effort::Twins { Vec::new() } else { by_surface(host, suspect, effort, stop) }
}

/// The alignment of a suspect that kept its host's coordinates, refined if `refined`. `None` if it
/// does not lie on the host, or was stopped.
#[must_use]
pub fn in_place(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    refined: bool,
    stop: Stop,
) -> Option<Alignment> {
    let start = suspect.shape.unit.inverse().then(&host.shape.unit);
    let target = host.target()?;
    let found = target.judge(&start, &suspect.points, FINE, stop);
    if found.overlap < LEAST_OVERLAP {
        return None;
    }
    let found = if refined {
        finish(host, suspect, target, &found, stop)
    } else {
        to_files(host, suspect, &found)
    };
    (!stop()).then_some(Alignment { basis: Basis::InPlace, ..found })
}

fn from_twins(host: &PreparedHost, suspect: &PreparedSuspect, found: Twins) -> Alignment {
    let Twins { similarity, pairs, .. } = found;
    let squared = |&[s, h]: &[u32; 2]| {
        let from = similarity.apply(suspect.shape.positions[s as usize]);
        from.distance_squared(host.shape.positions[h as usize])
    };
    let squares: f64 = pairs.iter().map(squared).sum();
    Alignment {
        similarity: suspect.shape.unit.then(&similarity).then(&host.shape.unit.inverse()),
        basis: Basis::Twins,
        overlap: pairs.len() as f64 / suspect.shape.positions.len() as f64,
        rms: (squares / pairs.len().max(1) as f64).sqrt(),
        pairs,
    }
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

fn by_surface(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    effort: Effort,
    stop: Stop,
) -> Vec<Alignment> {
    let Some(target) = host.target() else { return Vec::new() };
    let guesses = by_moments(&host.points, &suspect.points, false);
    let mut fits = aligned(target, suspect, &guesses, stop);
    if effort >= Effort::Thorough && fits.first().is_none_or(|fit| fit.overlap < WHOLE) {
        let [there, here] = [&host.shape, &suspect.shape].map(|s| sights(&scatter(s, DESCRIBED)));
        let mut guesses = by_parts(&there, &here);
        guesses.extend(by_moments(&host.points, &suspect.points, true));
        fits.extend(aligned(target, suspect, &guesses, stop));
        best_first(&mut fits);
        distinct(&mut fits);
    }
    let last = fits.iter().take(RETURNED).take_while(|_| !stop());
    let found = last.map(|fit| finish(host, suspect, target, fit, stop)).collect();
    // What was cut short is worth nothing.
    if stop() { Vec::new() } else { found }
}

/// Judges guesses by few points, aligns the better ones by more, and returns those that lie on the
/// host, best first.
fn aligned(
    target: &Target,
    suspect: &PreparedSuspect,
    guesses: &[Similarity],
    stop: Stop,
) -> Vec<Fit> {
    let judges = suspect.some(JUDGES);
    // The reach of a small part must not span all of it.
    let reach = |s: &Similarity| ROUGH * s.scale.abs().clamp(0.2, 1.0);
    let mut judged: Vec<Fit> = guesses
        .iter()
        .take_while(|_| !stop())
        .map(|guess| target.judge(guess, &judges, reach(guess), stop))
        .collect();
    best_first(&mut judged);
    let closer = |fit: &Fit, points: &[Point], to: f64, rounds: u32| {
        let reach = reach(&fit.similarity);
        target.align(&fit.similarity, points, reach..to * reach / ROUGH, rounds, stop)
    };
    let mut fits: Vec<Fit> = judged
        .iter()
        .take(ALIGNED_HYPOTHESES)
        .take_while(|_| !stop())
        .map(|guess| closer(guess, &judges, 2.0 * FINE, 12))
        .collect();
    best_first(&mut fits);
    distinct(&mut fits);
    fits.truncate(RETURNED);
    let mut fits: Vec<Fit> = fits
        .iter()
        .take_while(|_| !stop())
        .map(|fit| closer(fit, &suspect.points, FINE, 15))
        .collect();
    fits.retain(|fit| fit.overlap > LEAST_OVERLAP);
    best_first(&mut fits);
    distinct(&mut fits);
    fits
}

/// More overlap first; of equal overlaps the closer. Distances count relative to the suspect's
/// size: a tiny one would lie on any surface.
fn best_first(fits: &mut [Fit]) {
    let merit = |fit: &Fit| {
        let scale = fit.similarity.scale.abs().clamp(0.01, 1.0);
        fit.overlap * (1.0 - (fit.rms / (ROUGH * scale)).min(1.0))
    };
    fits.sort_by(|a, b| merit(b).total_cmp(&merit(a)));
}

/// Drops those that say what a better one says.
fn distinct(fits: &mut Vec<Fit>) {
    let mut kept: Vec<Fit> = Vec::new();
    for fit in fits.iter() {
        let same = |other: &Fit| {
            glam::DVec3::AXES
                .iter()
                .all(|&p| fit.similarity.apply(p).distance(other.similarity.apply(p)) < FINE)
        };
        if !kept.iter().any(same) {
            kept.push(*fit);
        }
    }
    *fits = kept;
}

/// The last stage: all of the surface, then vertices that lie on vertices, if there are such.
fn finish(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    target: &Target,
    fit: &Fit,
    stop: Stop,
) -> Alignment {
    let points = scatter(&suspect.shape, REFINED);
    let end = (3.0 * fit.rms).clamp(1e-4, FINE);
    let mut fit = target.align(&fit.similarity, &points, FINE..end, 8, stop);
    fit = Fit { similarity: fit.similarity, ..target.judge(&fit.similarity, &points, FINE, stop) };
    let pairs = mutual(&host.shape, target, &suspect.shape, &fit.similarity, FINE, stop);
    // Subdivision keeps all of the host's vertices and adds three times as many.
    let fewer = suspect.shape.positions.len().min(host.shape.positions.len());
    if pairs.len() * 2 < fewer {
        return to_files(host, suspect, &fit);
    }
    let similarity = polish(&contacts(&host.shape, &suspect.shape, &pairs), fit.similarity);
    let twins = Twins { similarity, pairs, median: 0.0 };
    let overlap = fit.overlap;
    Alignment { basis: Basis::Surface, overlap, ..from_twins(host, suspect, twins) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;
    use glam::DVec3;

    fn shape(sample: Sample, vertices: u32, place: &Similarity) -> Shape {
        let mesh = sample.mesh(vertices).unwrap();
        let positions = mesh.positions().iter().map(|&p| place.apply(p)).collect();
        Shape::new(Surface::new(&Mesh::new(positions, mesh.triangles().to_vec()).unwrap())).unwrap()
    }

    #[test]
    fn a_whole_with_another_tessellation_comes_home() {
        let host = PreparedHost::new(shape(Sample::Blob, 10_000, &Similarity::IDENTITY));
        for (scale, effort) in [(0.02, Effort::Whole), (-3.0, Effort::Thorough)] {
            let place = awkward(scale);
            let suspect = PreparedSuspect::new(shape(Sample::Blob, 6000, &place));
            let found = register(&host, &suspect, effort, &|| false);
            let best = found.first().unwrap();
            assert!(best.overlap > 0.99, "{best:?}");
            let error = best.similarity.apply(place.apply(DVec3::ZERO)).length();
            assert!(error * host.shape.unit.scale < 2e-4, "{error:e}");
            assert!(register(&host, &suspect, Effort::Twins, &|| false).is_empty());
        }
    }

    /// Every triangle in four.
    fn subdivided(mesh: &Mesh) -> Mesh {
        let mut positions = mesh.positions().to_vec();
        let mut triangles = Vec::new();
        // Sides that meet are welded by their position.
        for &[a, b, c] in mesh.triangles() {
            let [d, e, f] = [[a, b], [b, c], [c, a]].map(|[i, j]| {
                positions.push(positions[i as usize].midpoint(positions[j as usize]));
                u32::try_from(positions.len() - 1).unwrap()
            });
            triangles.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn the_vertices_of_a_subdivided_copy_are_the_hosts() {
        let mesh = Sample::Blob.mesh(4000).unwrap();
        let host = PreparedHost::new(Shape::new(Surface::new(&mesh)).unwrap());
        let fine = subdivided(&mesh);
        let place = awkward(0.5);
        let moved = fine.positions().iter().map(|&p| place.apply(p)).collect();
        let fine = Mesh::new(moved, fine.triangles().to_vec()).unwrap();
        let suspect = PreparedSuspect::new(Shape::new(Surface::new(&fine)).unwrap());
        let found = register(&host, &suspect, Effort::Whole, &|| false);
        let best = found.first().unwrap();
        let vertices = host.shape.positions.len();
        let vertex = |shape: &Shape, k: u32| shape.first_vertex[k as usize];
        let right = best
            .pairs
            .iter()
            .filter(|[s, h]| vertex(&suspect.shape, *s) == vertex(&host.shape, *h))
            .count();
        assert!(right * 10 > vertices * 9, "{right} of {vertices}");
        assert!(best.pairs.len() - right < vertices / 10, "{}", best.pairs.len());
    }

    #[test]
    fn in_place_is_told_from_moved() {
        let host = PreparedHost::new(shape(Sample::Knot, 5000, &Similarity::IDENTITY));
        let kept = PreparedSuspect::new(shape(Sample::Knot, 3000, &Similarity::IDENTITY));
        assert!(
            in_place(&host, &kept, false, &|| false).is_some_and(|a| a.basis == Basis::InPlace)
        );
        let moved = PreparedSuspect::new(shape(Sample::Knot, 3000, &awkward(1.0)));
        assert_eq!(in_place(&host, &moved, true, &|| false), None);
    }

    #[test]
    fn another_shape_has_no_place() {
        let host = PreparedHost::new(shape(Sample::Knot, 5000, &Similarity::IDENTITY));
        let other = PreparedSuspect::new(shape(Sample::Blob, 5000, &Similarity::IDENTITY));
        let found = register(&host, &other, Effort::Whole, &|| false);
        assert!(found.iter().all(|a| a.overlap < 0.9), "{found:?}");
    }

    #[test]
    fn the_outcome_is_the_same_on_one_and_on_many_threads() {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let host = PreparedHost::new(shape(Sample::Knot, 3000, &Similarity::IDENTITY));
                let same = PreparedSuspect::new(shape(Sample::Knot, 3000, &awkward(2.0)));
                let new = PreparedSuspect::new(shape(Sample::Knot, 2000, &awkward(2.0)));
                [same, new].map(|suspect| register(&host, &suspect, Effort::Thorough, &|| false))
            })
        };
        assert_eq!(run(1), run(4));
    }

    #[test]
    fn a_job_that_is_stopped_returns_early() {
        let host = PreparedHost::new(shape(Sample::Blob, 3000, &Similarity::IDENTITY));
        let suspect = PreparedSuspect::new(shape(Sample::Blob, 2000, &awkward(2.0)));
        assert!(register(&host, &suspect, Effort::Thorough, &|| true).is_empty());
    }

    #[test]
    fn strange_meshes_neither_panic_nor_take_long() {
        let ring = |k: u32| DVec3::new(f64::from(k).sin(), f64::from(k).cos(), f64::from(k % 7));
        let fan = |n: u32| (1..n).map(move |k| [0, k, k % (n - 1) + 1]);
        let spiky: Vec<DVec3> = (0..400).map(ring).collect();
        let flat: Vec<DVec3> = spiky.iter().map(|p| p.with_z(0.0)).collect();
        let line: Vec<DVec3> = spiky.iter().map(|p| DVec3::new(p.x, 1e-7 * p.y, 0.0)).collect();
        let stacked = std::iter::repeat_n([0, 1, 2], 400).collect::<Vec<_>>();
        let far: Vec<DVec3> = spiky.iter().map(|p| p * 1e100 + DVec3::splat(3e101)).collect();
        let strips = |n: u32| (0..n - 2).map(|k| [k, k + 1, k + 2]).collect::<Vec<_>>();
        let meshes = [
            (spiky.clone(), fan(400).collect()),
            (flat, strips(400)),
            (line, strips(400)),
            (spiky.clone(), stacked),
            (far, strips(300)),
            (spiky, vec![[0, 1, 2]]),
        ];
        let sound = PreparedHost::new(shape(Sample::Blob, 1000, &Similarity::IDENTITY));
        for (positions, triangles) in meshes {
            let surface = Surface::new(&Mesh::new(positions, triangles).unwrap());
            let Some(shape) = Shape::new(surface) else { continue };
            let _ = super::super::sketch::Sketch::new(&shape);
            let suspect = PreparedSuspect::new(shape.clone());
            let _ = register(&sound, &suspect, Effort::Thorough, &|| false);
            let host = PreparedHost::new(shape);
            let _ = register(&host, &suspect, Effort::Whole, &|| false);
            let _ = in_place(&host, &suspect, true, &|| false);
        }
    }

    #[test]
    fn sizes_beyond_numbers_are_refused() {
        for size in [1e300, 1e-310] {
            let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p * size);
            let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2]]).unwrap();
            assert!(Shape::new(Surface::new(&mesh)).is_none(), "{size:e}");
        }
    }
}
