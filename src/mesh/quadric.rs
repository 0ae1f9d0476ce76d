//! The quadric error metric of Garland and Heckbert (paper eq. 1-2) at a vertex of a mesh.

use glam::{DMat3, DVec3};

use super::surface::doubled_area;

/// The sum of squared distances to the planes of the triangles at one vertex.
///
/// All these planes pass through the vertex `v`, so `Q_v(x) = (x - v)^T A (x - v)` with
/// `A = sum_j n_j n_j^T`. This is eq. 2 with `b = -A v`, `c = v^T A v`, without the cancellation that
/// `b` and `c` cause far from the origin. `A` is kept as its six distinct entries.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quadric {
    xx: f64,
    yy: f64,
    zz: f64,
    xy: f64,
    xz: f64,
    yz: f64,
}

impl Quadric {
    /// The quadric of triangles given by their corners, all with an area and all sharing the vertex.
    /// Each plane counts once, whatever its triangle's area (eq. 2).
    #[must_use]
    pub fn of_triangles(triangles: impl Iterator<Item = [DVec3; 3]>) -> Self {
        triangles.fold(Self::default(), |mut q, [a, b, c]| {
            let n = doubled_area(a, b, c).normalize_or_zero();
            q.xx += n.x * n.x;
            q.yy += n.y * n.y;
            q.zz += n.z * n.z;
            q.xy += n.x * n.y;
            q.xz += n.x * n.z;
            q.yz += n.y * n.z;
            q
        })
    }

    /// `d^T A d` for the displacement `d = x - v`, in squared length units.
    #[must_use]
    pub fn at(&self, d: DVec3) -> f64 {
        self.xx * d.x * d.x
            + self.yy * d.y * d.y
            + self.zz * d.z * d.z
            + 2.0 * (self.xy * d.x * d.y + self.xz * d.x * d.z + self.yz * d.y * d.z)
    }

    /// `tr A`: the number of planes.
    #[must_use]
    pub fn trace(&self) -> f64 {
        self.xx + self.yy + self.zz
    }

    /// `A` as a full matrix.
    #[must_use]
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_cols_array(&[
            self.xx, self.xy, self.xz, self.xy, self.yy, self.yz, self.xz, self.yz, self.zz,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sum_of_squared_distances_to_the_planes() {
        let v = DVec3::new(5.0, -2.0, 1.0);
        let ring = [(1.0, 0.0, 0.2), (0.0, 1.0, -0.3), (-1.0, -1.0, 0.1)]
            .map(|(x, y, z)| v + DVec3::new(x, y, z));
        let triangles = [[v, ring[0], ring[1]], [ring[1], ring[2], v], [ring[2], ring[0], v]];
        let q = Quadric::of_triangles(triangles.into_iter());
        let x = DVec3::new(5.3, -2.2, 1.9);
        let direct: f64 = triangles
            .iter()
            .map(|&[a, b, c]| doubled_area(a, b, c).normalize().dot(x - v).powi(2))
            .sum();
        assert!((q.at(x - v) - direct).abs() < 1e-14);
        assert!((q.trace() - 3.0).abs() < 1e-14);
        assert!((q.matrix() * (x - v)).dot(x - v) - q.at(x - v) < 1e-14);
    }

    #[test]
    fn moving_within_a_flat_surface_costs_nothing() {
        let p = |x: f64, y: f64| DVec3::new(x, y, 3.0);
        let q = Quadric::of_triangles(
            [[p(0., 0.), p(1., 0.), p(0., 1.)], [p(0., 0.), p(0., 1.), p(-1., 0.)]].into_iter(),
        );
        assert!(q.at(DVec3::new(0.4, -0.3, 0.0)) < 1e-30);
        assert!((q.at(DVec3::new(0.0, 0.0, 0.5)) - 0.5).abs() < 1e-15);
    }
}
