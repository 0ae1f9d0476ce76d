//! The closest point of a surface.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::{PointQuery, PointQueryWithLocation};
use parry3d_f64::shape::{TriMesh, Triangle, TrianglePointLocation};

use super::surface::Surface;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footpoint {
    /// Its position.
    pub place: DVec3,
    /// The triangle that it lies on.
    pub triangle: u32,
    /// Its barycentric coordinates in that triangle.
    pub weights: [f64; 3],
}

/// A surface prepared for queries by a tree of bounding boxes.
pub struct Closest(TriMesh);

fn vector(p: DVec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

impl Closest {
    /// `None` when the surface has no triangle.
    #[must_use]
    pub fn new(surface: &Surface) -> Option<Self> {
        let points = surface.positions.iter().copied().map(vector).collect();
        TriMesh::new(points, surface.triangles.clone()).ok().map(Self)
    }

    /// The point of the surface that is closest to `p`.
    #[must_use]
    pub fn point(&self, p: DVec3) -> DVec3 {
        let found = self.0.project_local_point(vector(p), false).point;
        DVec3::new(found.x, found.y, found.z)
    }

    /// The closest point of the surface, and where on which triangle it lies.
    #[must_use]
    pub fn footpoint(&self, p: DVec3) -> Footpoint {
        let (found, (triangle, location)) =
            self.0.project_local_point_and_get_location(vector(p), false);
        // Barycentric coordinates are absent only inside a solid, which a surface is not.
        let weights = location.barycentric_coordinates().unwrap_or([1.0, 0.0, 0.0]);
        let place = DVec3::new(found.point.x, found.point.y, found.point.z);
        Footpoint { place, triangle, weights }
    }

    /// The distance of `p` to the surface.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        self.point(p).distance(p)
    }
}

/// The point of a triangle that is closest to `p`, and the corners that span the feature it lies on: a
/// corner, a side, or the whole triangle.
#[must_use]
pub fn nearest_in_triangle(p: DVec3, corners: [DVec3; 3]) -> (DVec3, [bool; 3]) {
    let [a, b, c] = corners.map(vector);
    let (found, location) =
        Triangle::new(a, b, c).project_local_point_and_get_location(vector(p), false);
    let spanning = match location {
        TrianglePointLocation::OnVertex(k) => [0, 1, 2].map(|corner| corner == k),
        // Sides are numbered by the corner that they begin at.
        TrianglePointLocation::OnEdge(k, _) => [0, 1, 2].map(|corner| corner != (k + 2) % 3),
        TrianglePointLocation::OnFace(..) | TrianglePointLocation::OnSolid => [true; 3],
    };
    (DVec3::new(found.point.x, found.point.y, found.point.z), spanning)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangles_corners_sides_and_face_are_told_apart() {
        let corners = [DVec3::ZERO, 4.0 * DVec3::X, 4.0 * DVec3::Y];
        for (p, place, spanning) in [
            ([-1.0, -1.0, 2.0], [0.0, 0.0, 0.0], [true, false, false]),
            ([6.0, -1.0, 0.0], [4.0, 0.0, 0.0], [false, true, false]),
            ([-1.0, 9.0, 1.0], [0.0, 4.0, 0.0], [false, false, true]),
            ([1.0, -2.0, 1.0], [1.0, 0.0, 0.0], [true, true, false]),
            ([3.0, 3.0, 0.0], [2.0, 2.0, 0.0], [false, true, true]),
            ([-3.0, 1.0, 0.0], [0.0, 1.0, 0.0], [true, false, true]),
            ([1.0, 1.0, -5.0], [1.0, 1.0, 0.0], [true, true, true]),
        ] {
            let (found, on) = nearest_in_triangle(DVec3::from_array(p), corners);
            assert!(found.distance(DVec3::from_array(place)) < 1e-12, "{p:?}: {found}");
            assert_eq!(on, spanning, "{p:?}");
        }
    }
}
