//! The rotations that map a host onto itself.
//!
//! A gear with six holes lies on itself in twelve ways, and nothing in the shape of a suspect shows
//! which of them is right. A comparison with a suspect has to consider all of them.

use super::icp::{AlignmentTarget, Fit};
use super::moments::by_moments;
use super::samples::Point;
use super::surface::{FINE, ROUGH};
use crate::mesh::stop::Stop;
use crate::registration::budget::{Budget, WorkLimits};
use crate::registration::prepared::PreparedHost;
use crate::registration::similarity::Similarity;

/// Rotations other than the identity, at most: those of a cube.
const MOST: usize = 23;

/// Points that judge hypotheses and align them.
const JUDGES: usize = 600;

/// Distance within which a point counts as on the surface in the last stage, a share of the
/// diagonal.
const EXACT: f64 = 1e-3;

/// Least share of the points that lie on the surface: in the rough stages, and in the last one.
const ROUGHLY: f64 = 0.85;
const NEARLY_ALL: f64 = 0.97;

/// Largest RMS distance, a share of the diagonal. A suspect from a scan with noise of 0.05 % is
/// 3.9e-4 off and cannot distinguish a rotation within this distance from a symmetry; a remeshed
/// suspect is 1e-4 off.
const LOOSEST: f64 = 2.5e-4;

/// How far the scale may differ from 1.
const SAME_SIZE: f64 = 1e-3;

/// Rounds of an alignment.
const ROUNDS: u32 = 12;

/// Tests per host, at most: 0.36 s.
const MOST_TESTS: u64 = 24_000_000;

/// The proper rotations other than the identity that map the host onto itself, in its unit
/// coordinates; `None` once `stop` returns `true`.
pub(in crate::registration) fn symmetries(
    host: &PreparedHost,
    stop: Stop<'_>,
) -> Option<Vec<Similarity>> {
    let (points, surfels) = (&host.points, host.surfels(stop)?);
    let budget = Budget::new(MOST_TESTS);
    let within = WorkLimits { budget: &budget, stop };
    let judges: Vec<Point> =
        points.iter().step_by((points.len() / JUDGES).max(1)).copied().collect();
    let few: Vec<Point> = judges.iter().step_by(4).copied().collect();
    let mut found: Vec<Similarity> = vec![Similarity::IDENTITY];
    for guess in by_moments(points, points, false) {
        if stop() {
            return None;
        }
        let is_new = |fit: &Fit, found: &[Similarity]| {
            found.iter().all(|known| known.apart(&fit.similarity) > 2.0 * FINE)
        };
        let rough = surfels.judge(&guess, &few, ROUGH, within);
        if rough.overlap < ROUGHLY || budget.left() == 0 || found.len() > MOST {
            continue;
        }
        let aligned = surfels.align(&guess, &few, ROUGH..FINE, ROUNDS, within);
        let aligned = surfels.judge(&aligned, &few, FINE, within);
        if aligned.overlap < ROUGHLY || !is_new(&aligned, &found) {
            continue;
        }
        // The search tree is not built for hosts without a candidate.
        let Some(target) = host.target(stop) else { break };
        let exact = target.align(&aligned.similarity, &judges, FINE..EXACT, ROUNDS, within);
        let exact = target.judge(&exact, &judges, EXACT, within);
        let same_size = (exact.similarity.scale - 1.0).abs() <= SAME_SIZE;
        if exact.overlap >= NEARLY_ALL
            && exact.rms <= LOOSEST
            && same_size
            && is_new(&exact, &found)
        {
            found.push(exact.similarity);
        }
    }
    found.remove(0);
    (!stop()).then_some(found)
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::shape::Shape;
    use crate::sample::Sample;

    fn count(mesh: &Mesh) -> usize {
        let host = PreparedHost::new(Shape::new(Surface::new(mesh)).unwrap());
        host.symmetries(&|| false).unwrap().len()
    }

    /// A torus whose tube is thicker in `points` places, with `around` times `across` vertices.
    pub(crate) fn crown(points: u32, [around, across]: [u32; 2]) -> Mesh {
        let turn = std::f64::consts::TAU;
        let at = |i: u32, j: u32| {
            let (u, v) =
                (turn * f64::from(i) / f64::from(around), turn * f64::from(j) / f64::from(across));
            let tube = 0.25 + 0.06 * (f64::from(points) * u).cos();
            let out = 1.0 + tube * v.cos();
            DVec3::new(out * u.cos(), out * u.sin(), tube * v.sin())
        };
        let positions = (0..around).flat_map(|i| (0..across).map(move |j| at(i, j))).collect();
        let vertex = |i: u32, j: u32| (i % around) * across + j % across;
        let triangles = (0..around)
            .flat_map(|i| (0..across).map(move |j| (i, j)))
            .flat_map(|(i, j)| {
                let [a, b, c, d] =
                    [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_crown_has_two_for_each_of_its_points_and_a_blob_has_none() {
        for points in [3, 5, 6] {
            let mesh = crown(points, [240, 40]);
            let turned = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(1.9);
            let moved = mesh.positions().iter().map(|p| turned * *p + DVec3::ONE).collect();
            let moved = Mesh::new(moved, mesh.triangles().to_vec()).unwrap();
            for mesh in [mesh, moved] {
                assert_eq!(count(&mesh), 2 * points as usize - 1, "{points}");
            }
        }
        assert_eq!(count(&Sample::Blob.mesh(4000).unwrap()), 0);
    }
}
