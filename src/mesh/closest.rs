//! The closest point of a surface.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::{PointQuery, PointQueryWithLocation};
use parry3d_f64::shape::TriMesh;

use super::surface::Surface;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footpoint {
    /// Where it is.
    pub place: DVec3,
    /// The triangle that it lies on.
    pub triangle: u32,
    /// Its barycentric coordinates there.
    pub weights: [f64; 3],
}

/// A surface prepared for queries (a tree of bounding boxes).
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

    /// The same, and where on which triangle it lies.
    #[must_use]
    pub fn footpoint(&self, p: DVec3) -> Footpoint {
        let (found, (triangle, location)) =
            self.0.project_local_point_and_get_location(vector(p), false);
        // A point has no place inside a triangle only if it is inside a solid, which this is not.
        let weights = location.barycentric_coordinates().unwrap_or([1.0, 0.0, 0.0]);
        let place = DVec3::new(found.point.x, found.point.y, found.point.z);
        Footpoint { place, triangle, weights }
    }

    /// Its distance.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        self.point(p).distance(p)
    }
}
