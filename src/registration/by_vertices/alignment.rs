//! The alignment by vertices that suspect and host share, and whether it makes a search by the
//! surface needless.

use super::vertices::{SharedVertices, shared_vertices};
use crate::mesh::stop::Stop;
use crate::registration::budget::WorkLimits;
use crate::registration::by_surface::surface::rough_share_on;
use crate::registration::prepared::{Alignment, Basis, PreparedHost, PreparedSuspect};

/// Shared vertices suffice where correspondences cover more than `VERTICES_SUFFICE` of the
/// suspect's vertices and put at least `SURFACE_SUFFICES` of its surface on the host. The second
/// condition is needed because regular parts of a surface that was tessellated anew have the same
/// signatures in several places: on a bracket, a fifth of the vertices had false correspondences.
const VERTICES_SUFFICE: f64 = 0.2;
const SURFACE_SUFFICES: f64 = 0.9;

/// The alignment by the vertices that suspect and host share; also `None` once `stop` returns `true`.
#[must_use]
pub fn by_vertices(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    stop: Stop<'_>,
) -> Option<Alignment> {
    let found =
        shared_vertices(&host.shape, &host.landmarks, &suspect.shape, &suspect.landmarks, stop)?;
    Some(from_correspondences(host, suspect, found))
}

/// Whether the shared vertices suffice, so that no search by the surface is needed. `shared` is the
/// alignment by vertices.
#[must_use]
pub fn suffices(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    shared: &Alignment,
    within: WorkLimits<'_>,
) -> bool {
    shared.overlap > VERTICES_SUFFICE
        && rough_share_on(host, suspect, &shared.similarity, within)
            .is_some_and(|share| share >= SURFACE_SUFFICES)
}

fn from_correspondences(
    host: &PreparedHost,
    suspect: &PreparedSuspect,
    found: SharedVertices,
) -> Alignment {
    let SharedVertices { similarity, pairs, .. } = found;
    let squared = |&[s, h]: &[u32; 2]| {
        let from = similarity.apply(suspect.shape.positions[s as usize]);
        from.distance_squared(host.shape.positions[h as usize])
    };
    let squares: f64 = pairs.iter().map(squared).sum();
    Alignment {
        similarity: suspect.shape.unit.then(&similarity).then(&host.shape.unit.inverse()),
        basis: Basis::Vertices,
        overlap: pairs.len() as f64 / suspect.shape.positions.len() as f64,
        rms: (squares / pairs.len().max(1) as f64).sqrt(),
        pairs,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::budget::Budget;
    use crate::registration::shape::Shape;
    use crate::registration::similarity::Similarity;
    use crate::registration::similarity::tests::awkward;
    use crate::registration::{Effort, by_surface, in_place};
    use crate::sample::Sample;
    use glam::DVec3;

    /// Similarities in the order in which they are tried.
    fn register(
        host: &PreparedHost,
        suspect: &PreparedSuspect,
        effort: Effort,
        within: WorkLimits<'_>,
    ) -> Vec<Alignment> {
        let shared = by_vertices(host, suspect, within.stop);
        match shared {
            Some(shared) if suffices(host, suspect, &shared, within) => vec![shared],
            _ => by_surface(host, suspect, effort, &[], within).into_iter().chain(shared).collect(),
        }
    }

    fn budget() -> Budget {
        Budget::new(u64::MAX)
    }

    fn free(budget: &Budget) -> WorkLimits<'_> {
        WorkLimits { budget, stop: &|| false }
    }

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
            let found = register(&host, &suspect, effort, free(&budget()));
            let best = found.first().unwrap();
            assert!(best.overlap > 0.99, "{best:?}");
            let error = best.similarity.apply(place.apply(DVec3::ZERO)).length();
            assert!(error * host.shape.unit.scale < 2e-4, "{error:e}");
            assert_eq!(by_vertices(&host, &suspect, &|| false), None);
        }
    }

    /// Splits every triangle into four.
    fn subdivided(mesh: &Mesh) -> Mesh {
        let mut positions = mesh.positions().to_vec();
        let mut triangles = Vec::new();
        // Midpoints of shared edges are welded by their position.
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
        let found = register(&host, &suspect, Effort::Whole, free(&budget()));
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
        assert!(in_place(&host, &kept, free(&budget())).is_some_and(|a| a.basis == Basis::InPlace));
        let moved = PreparedSuspect::new(shape(Sample::Knot, 3000, &awkward(1.0)));
        assert_eq!(in_place(&host, &moved, free(&budget())), None);
    }

    #[test]
    fn another_shape_has_no_place() {
        let host = PreparedHost::new(shape(Sample::Knot, 5000, &Similarity::IDENTITY));
        let other = PreparedSuspect::new(shape(Sample::Blob, 5000, &Similarity::IDENTITY));
        let found = register(&host, &other, Effort::Whole, free(&budget()));
        assert!(found.iter().all(|a| a.overlap < 0.9), "{found:?}");
    }

    #[test]
    fn the_outcome_is_the_same_on_one_and_on_many_threads() {
        let run = |threads: usize, tests: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let host = PreparedHost::new(shape(Sample::Knot, 3000, &Similarity::IDENTITY));
                let same = PreparedSuspect::new(shape(Sample::Knot, 3000, &awkward(2.0)));
                let new = PreparedSuspect::new(shape(Sample::Knot, 2000, &awkward(0.1)));
                [same, new].map(|suspect| {
                    let budget = Budget::new(tests);
                    let found = register(&host, &suspect, Effort::Thorough, free(&budget));
                    (found, budget.spent())
                })
            })
        };
        for tests in [300_000, 3_000_000, u64::MAX] {
            assert_eq!(run(1, tests), run(4, tests));
        }
    }

    /// Needles that all reach across the box. A search among them costs a hundred times more than
    /// on a usual mesh of as many vertices and triangles.
    fn needles(count: u32) -> Shape {
        let end = |k: u32, side: f64| {
            let turn = f64::from(k) * 2.4;
            let across = 1e-3 * f64::from(k % 7);
            DVec3::new(side, 0.02 * turn.sin() + across, 0.02 * turn.cos())
        };
        let corners = (0..count).flat_map(|k| [end(k, -1.0), end(k, 1.0), end(k + 1, 1.0)]);
        let triangles = (0..count).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        Shape::new(Surface::new(&Mesh::new(corners.collect(), triangles).unwrap())).unwrap()
    }

    #[test]
    fn work_stays_within_the_budget_whatever_the_surface() {
        let host = PreparedHost::new(needles(3000));
        let suspects =
            [needles(2500), shape(Sample::Knot, 2000, &awkward(0.2))].map(PreparedSuspect::new);
        for suspect in &suspects {
            let unbounded = budget();
            let _ = register(&host, suspect, Effort::Whole, free(&unbounded));
            for tests in [0, 1_000_000, 10_000_000] {
                let budget = Budget::new(tests);
                let found = register(&host, suspect, Effort::Whole, free(&budget));
                // Measuring what a search costs takes 60 searches per planned alignment.
                let planning = 25 * 60 * crate::mesh::tree::MOST_TESTS;
                assert!(budget.spent() <= tests + planning, "{tests}: {}", budget.spent());
                assert!(found.iter().all(|a| a.similarity.is_valid()));
            }
        }
    }

    #[test]
    fn what_can_be_afforded_is_as_if_there_were_no_budget() {
        let host = PreparedHost::new(shape(Sample::Blob, 4000, &Similarity::IDENTITY));
        let suspect = PreparedSuspect::new(shape(Sample::Blob, 3000, &awkward(2.0)));
        let unbounded = budget();
        let best = register(&host, &suspect, Effort::Whole, free(&unbounded));
        // A share of what is left is reserved for each step, even for steps that do not happen.
        let budget = Budget::new(10 * unbounded.spent());
        assert_eq!(register(&host, &suspect, Effort::Whole, free(&budget)), best);
    }

    #[test]
    fn a_job_that_is_stopped_returns_early() {
        let host = PreparedHost::new(shape(Sample::Blob, 3000, &Similarity::IDENTITY));
        let suspect = PreparedSuspect::new(shape(Sample::Blob, 2000, &awkward(2.0)));
        assert!(
            register(
                &host,
                &suspect,
                Effort::Thorough,
                WorkLimits { stop: &|| true, ..free(&budget()) }
            )
            .is_empty()
        );
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
            let _ = crate::registration::retrieval::sketch::Sketch::new(&shape);
            let suspect = PreparedSuspect::new(shape.clone());
            let _ = register(&sound, &suspect, Effort::Thorough, free(&budget()));
            let host = PreparedHost::new(shape);
            let _ = register(&host, &suspect, Effort::Whole, free(&budget()));
            let _ = in_place(&host, &suspect, free(&budget()));
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
