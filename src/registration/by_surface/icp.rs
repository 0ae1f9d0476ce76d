//! Trimmed alignment of a suspect to its host's surface, from a rough similarity to a fine one:
//! iterated closest points with point-to-plane distances and scale (Chen and Medioni 1992; Du et
//! al. 2010 for the scale; Chetverikov et al. 2005 for the trimming).
//!
//! For suspects whose vertices are no longer the host's. Each round places points of the suspect,
//! drops those that are too far from the host or on a surface that faces elsewhere, and takes one
//! Newton step. The dropped points are additions to the host, or points that the hypothesis places
//! wrongly.

use glam::DVec3;
use rayon::prelude::*;

use super::gauss_newton::Equations;
use super::samples::Point;
use crate::mesh::powers::squared;
use crate::mesh::stop::{Stop, mapped};
use crate::mesh::surface::doubled_area;
use crate::mesh::tree::SearchTree;
use crate::registration::budget::WorkLimits;
use crate::registration::shape::Shape;
use crate::registration::similarity::Similarity;

/// Points whose normals differ by more than 60 degrees do not lie on the same surface.
const SAME_SIDE: f64 = 0.5;

/// The alignment has converged when a Newton step moves no point of the unit box by more than this.
const ARRIVED: f64 = 3e-7;

/// All triangles of a host's surface, searchable for closest points.
pub struct IcpTarget {
    normals: Vec<DVec3>,
    tree: SearchTree,
}

/// How well a suspect lies on its host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// From the suspect shape's coordinates to the host shape's.
    pub similarity: Similarity,
    /// Share of the suspect's points on the host's surface, within the last reach.
    pub overlap: f64,
    /// Root mean square of these points' distances, a share of the host's diagonal.
    pub rms: f64,
}

/// A point of the suspect that lies on the host.
#[derive(Debug, Clone, Copy)]
pub struct Touch {
    /// Where the similarity puts the suspect's point.
    pub placed: DVec3,
    /// The closest point of the host.
    pub closest: DVec3,
    /// The host's normal there.
    pub normal: DVec3,
}

/// Whether a suspect's point faces the same way as the host's `normal`. For a mirror image, the
/// opposite way counts too: its triangles may have been flipped or not.
#[must_use]
pub fn same_side(s: &Similarity, point: &Point, normal: DVec3) -> bool {
    let along = (s.rotation * point.normal).dot(normal);
    (if s.scale < 0.0 { along.abs() } else { along }) > SAME_SIDE
}

impl IcpTarget {
    /// Builds the search tree: takes about a second per million triangles. `None` if the surface
    /// cannot be searched, and once `stop` returns `true`.
    #[must_use]
    pub fn new(host: &Shape, stop: Stop<'_>) -> Option<Self> {
        let at = |v: u32| host.positions[v as usize];
        let normal = |_, t: &[u32; 3]| {
            let [a, b, c] = t.map(at);
            doubled_area(a, b, c).normalize_or_zero()
        };
        let normals = mapped(&host.triangles, stop, normal)?;
        // The box of a shape is centred at the origin, and its diagonal is 1.
        let bounds = (DVec3::splat(-0.5), 1.0);
        let (points, triangles) = (host.positions.clone(), host.triangles.clone());
        Some(Self { normals, tree: SearchTree::new(points, triangles, bounds, stop)? })
    }

    /// The triangle that is closest to `p` and its closest point, if that is within `reach`. Adds
    /// the tests of the search to `tests`.
    #[must_use]
    pub fn closest(&self, p: DVec3, reach: f64, tests: &mut u64) -> Option<(usize, DVec3)> {
        self.tree.closest(p, reach, tests)
    }
}

impl AlignmentTarget for IcpTarget {
    fn touch(&self, s: &Similarity, point: &Point, reach: f64, tests: &mut u64) -> Option<Touch> {
        let placed = s.apply(point.position);
        let (triangle, closest) = self.closest(placed, reach, tests)?;
        let normal = *self.normals.get(triangle)?;
        let near = placed.distance(closest) < reach;
        (near && same_side(s, point, normal)).then_some(Touch { placed, closest, normal })
    }
}

/// A host's surface that a suspect is aligned to.
pub trait AlignmentTarget: Sync {
    /// The closest point of the host, if it is within `reach` and faces the same way. Adds the
    /// tests of the search to `tests`.
    fn touch(&self, s: &Similarity, point: &Point, reach: f64, tests: &mut u64) -> Option<Touch>;

    /// The touches of all points that lie on the host.
    fn touches(
        &self,
        s: &Similarity,
        points: &[Point],
        reach: f64,
        within: WorkLimits<'_>,
    ) -> Vec<Touch> {
        let touch = |p: &Point| {
            let mut tests = 0;
            let touch = if (within.stop)() { None } else { self.touch(s, p, reach, &mut tests) };
            (touch, tests)
        };
        let all: Vec<(Option<Touch>, u64)> =
            points.par_iter().with_min_len(256).map(touch).collect();
        within.budget.spend(all.iter().map(|(_, tests)| tests).sum());
        all.into_iter().filter_map(|(touch, _)| touch).collect()
    }

    /// How well `points` of a suspect lie on the host where `similarity` puts them.
    fn judge(
        &self,
        similarity: &Similarity,
        points: &[Point],
        reach: f64,
        within: WorkLimits<'_>,
    ) -> Fit {
        let touches = self.touches(similarity, points, reach, within);
        let squares: f64 = touches.iter().map(|t| t.placed.distance_squared(t.closest)).sum();
        let count = touches.len() as f64;
        Fit {
            similarity: *similarity,
            overlap: count / points.len().max(1) as f64,
            rms: (squares / count.max(1.0)).sqrt(),
        }
    }

    /// Takes at most `rounds` Newton steps from `start`. The reach shrinks from `reaches.start` to
    /// `reaches.end`, both shares of the host's diagonal.
    fn align(
        &self,
        start: &Similarity,
        points: &[Point],
        reaches: std::ops::Range<f64>,
        rounds: u32,
        within: WorkLimits<'_>,
    ) -> Similarity {
        let mut now = *start;
        let shrink = libm::pow(reaches.end / reaches.start, 1.0 / f64::from(rounds.max(2) - 1));
        let mut reach = reaches.start;
        for _ in 0..rounds {
            let touches = self.touches(&now, points, reach, within);
            // The scale is held until the pose is about right: too few touching points pull it to
            // zero.
            let scaled = touches.len() * 4 > points.len();
            let cut = robust_cut(&touches, reach);
            let equations = touches.iter().fold(Equations::default(), |mut equations, t| {
                let share = (t.placed - t.closest).dot(t.normal).abs() / cut;
                if share < 1.0 {
                    let weight = squared(1.0 - share * share);
                    equations.add(t.closest, t.placed, t.normal, weight);
                }
                equations
            });
            let Some(next) = equations.improved(&now, scaled) else { break };
            if !(0.3..3.0).contains(&(next.scale / start.scale)) {
                break;
            }
            let arrived = next.apart(&now) < ARRIVED;
            now = next;
            if arrived && reach <= reaches.end {
                break;
            }
            reach = if arrived { reaches.end } else { (reach * shrink).max(reaches.end) };
        }
        now
    }
}

/// Distance off the surface beyond which a touch does not count: Tukey's 4.685 standard deviations,
/// estimated by the median.
fn robust_cut(touches: &[Touch], reach: f64) -> f64 {
    let mut distances: Vec<f64> =
        touches.iter().map(|t| (t.placed - t.closest).dot(t.normal).abs()).collect();
    let middle = distances.len() / 2;
    if distances.is_empty() {
        return reach;
    }
    let (_, &mut median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
    (median / 0.6745 * 4.685).clamp(1e-12, reach)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::budget::{Budget, WorkLimits};
    use crate::registration::by_surface::samples::scatter;
    use crate::sample::Sample;
    use glam::DQuat;

    fn shape(vertices: u32) -> Shape {
        Shape::new(Surface::new(&Sample::Blob.mesh(vertices).unwrap())).unwrap()
    }

    #[test]
    fn another_tessellation_comes_home_from_a_rough_guess() {
        let budget = Budget::new(u64::MAX);
        let within = WorkLimits { budget: &budget, stop: &|| false };
        let (host, suspect) = (shape(8000), shape(5000));
        let target = IcpTarget::new(&host, &crate::mesh::stop::never).unwrap();
        let points = scatter(&suspect, 4000);
        let truth = suspect.unit.inverse().then(&host.unit);
        let off = Similarity {
            scale: 1.04,
            rotation: DQuat::from_scaled_axis(DVec3::new(0.08, -0.05, 0.03)),
            translation: DVec3::new(0.01, 0.02, -0.01),
        };
        let found = target.align(&truth.then(&off), &points, 0.1..0.01, 25, within);
        let found = target.judge(&found, &points, 0.01, within);
        let error = found.similarity.apply(DVec3::ZERO).distance(truth.apply(DVec3::ZERO));
        assert!(error < 1e-4 && found.overlap > 0.99 && found.rms < 1e-3, "{error:e} {found:?}");
    }

    #[test]
    fn nothing_near_is_no_overlap() {
        let budget = Budget::new(u64::MAX);
        let within = WorkLimits { budget: &budget, stop: &|| false };
        let host = shape(1000);
        let away = Similarity { translation: DVec3::splat(5.0), ..Similarity::IDENTITY };
        let target = IcpTarget::new(&host, &crate::mesh::stop::never).unwrap();
        let points = scatter(&host, 500);
        let found = target.align(&away, &points, 0.1..0.01, 5, within);
        assert_eq!((target.judge(&found, &points, 0.1, within).overlap, found), (0.0, away));
    }
}
