//! A surface prepared for many searches for closest points, each with a limit of distance and of work.
//!
//! [`Closest`](super::closest::Closest) searches without limits. Here the work of a search is counted,
//! so that a caller can bound many searches on any surface, to the same result on every machine.

use std::cell::Cell;

use glam::DVec3;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::Triangle;
use rayon::prelude::*;

use super::stop::{Stop, go_on, mapped, sorted};

/// Largest number of tests of one search; a test visits a box or a triangle. The search then returns
/// the best found so far. A surface of overlapping slivers takes long to search, because every box of
/// its tree contains every point.
pub const MOST_TESTS: u64 = 10_000;

/// Largest number of triangles of a part.
const PART_TRIANGLES: usize = 1 << 15;

/// A tree of trees over triangles. A library builds each tree in one call of some 30 ms. One tree over
/// millions of triangles would take seconds, in which no stop is possible.
pub struct SearchTree {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<Part>,
    /// The tree over the boxes of the parts.
    whole: Bvh,
}

/// Triangles that lie near each other.
struct Part {
    tree: Bvh,
    triangles: Vec<u32>,
}

fn vector(p: DVec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

impl SearchTree {
    /// Builds the trees, in about a second per million triangles. `bounds` are the low corner and the
    /// side of a cube around the points. `None` where there is no triangle, and once `stop` answers
    /// `true`.
    #[must_use]
    pub fn new(
        points: Vec<DVec3>,
        triangles: Vec<[u32; 3]>,
        bounds: (DVec3, f64),
        stop: Stop<'_>,
    ) -> Option<Self> {
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        let boxed = |&triangle: &u32| -> Aabb {
            let [a, b, c] = corners(&triangles[triangle as usize]).map(vector);
            Triangle::new(a, b, c).local_aabb()
        };
        let part = |triangles: &[u32]| {
            go_on(stop)?;
            let boxes = triangles.iter().map(boxed).enumerate();
            let tree = Bvh::from_iter(BvhBuildStrategy::Binned, boxes);
            Some(Part { tree, triangles: triangles.to_vec() })
        };
        let order = nearby(&points, &triangles, bounds, stop)?;
        let parts: Option<Vec<Part>> = order.par_chunks(PART_TRIANGLES).map(part).collect();
        let parts = parts?;
        let boxes = parts.iter().map(|part| part.tree.root_aabb()).enumerate();
        let whole = Bvh::from_iter(BvhBuildStrategy::Binned, boxes);
        go_on(stop)?;
        (!parts.is_empty()).then_some(Self { points, triangles, parts, whole })
    }

    /// The points.
    #[must_use]
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The triangles over them.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The triangle that is closest to `p` and its closest point, if that is within `reach`. Adds the
    /// number of tests made to `tests`.
    #[must_use]
    pub fn closest(&self, p: DVec3, reach: f64, tests: &mut u64) -> Option<(usize, DVec3)> {
        let at = vector(p);
        let made = Cell::new(0_u64);
        let count = || {
            made.set(made.get() + 1);
            made.get() <= MOST_TESTS
        };
        let to_box = |node: &BvhNode, _| {
            if count() { node.aabb().distance_to_local_point(at, true) } else { f64::MAX }
        };
        let in_part = |part: &Part, reach: f64| {
            let to_triangle = |leaf: u32, _| {
                let corners = self.triangles[part.triangles[leaf as usize] as usize];
                let [a, b, c] = corners.map(|v| vector(self.points[v as usize]));
                count().then(|| {
                    let found = Triangle::new(a, b, c).project_local_point(at, false).point;
                    ((found - at).length(), found)
                })
            };
            let (leaf, (distance, found)) = part.tree.find_best(reach, to_box, to_triangle)?;
            Some((distance, (part.triangles[leaf as usize], found)))
        };
        let found = match self.parts.as_slice() {
            [only] => in_part(only, reach),
            parts => {
                let to_part = |part: u32, reach| in_part(&parts[part as usize], reach);
                self.whole.find_best(reach, to_box, to_part).map(|(_, found)| found)
            }
        };
        *tests += made.get();
        let (_, (triangle, found)) = found?;
        Some((usize::try_from(triangle).ok()?, DVec3::new(found.x, found.y, found.z)))
    }
}

/// The numbers of all triangles, ordered so that each [`PART_TRIANGLES`] of them lies together. One part keeps
/// the given order; several parts follow a Morton curve through cells of 1/1024 of the cube's side.
/// `None` once `stop` answers `true`.
fn nearby(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    (low, side): (DVec3, f64),
    stop: Stop<'_>,
) -> Option<Vec<u32>> {
    let number = |t: usize| u32::try_from(t).unwrap_or(u32::MAX);
    if triangles.len() <= PART_TRIANGLES {
        return Some((0..triangles.len()).map(number).collect());
    }
    let keyed = mapped(triangles, stop, |t, corners| {
        let [a, b, c] = corners.map(|v| points[v as usize]);
        (morton(((a + b + c) / 3.0 - low) / side), number(t))
    })?;
    let keyed = sorted(keyed, stop, Ord::cmp)?;
    Some(keyed.into_iter().map(|(_, t)| t).collect())
}

/// The position of a point of the unit cube on a Morton curve.
fn morton(p: DVec3) -> u32 {
    let spread = |x: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to 0 to 1023"
        )]
        let cell = (x * 1024.0).clamp(0.0, 1023.0) as u32;
        (0..10).fold(0, |bits, place| bits | ((cell >> place & 1) << (3 * place)))
    };
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}
