//! The closest point of a surface.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;

use super::surface::Surface;

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

    /// Its distance.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        self.point(p).distance(p)
    }
}
