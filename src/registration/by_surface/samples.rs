//! Points spread evenly over a surface, whatever its triangles.

use glam::DVec3;

use crate::mesh::stop::{STEP, Stop, go_on, unstopped};
use crate::mesh::surface::doubled_area;
use crate::registration::shape::Shape;

/// Steps of the low-discrepancy sequence R2 of the plane, from the plastic number.
const PLASTIC: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// A point of the surface and the unit normal of the triangle that it lies in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Where it is.
    pub position: DVec3,
    /// The triangle's normal.
    pub normal: DVec3,
}

/// `count` points, one more or less, at equal steps of area in the order of the triangles.
#[must_use]
pub fn scatter(shape: &Shape, count: usize) -> Vec<Point> {
    unstopped(|stop| scatter_until(shape, count, stop))
}

/// Like [`scatter`]; `None` once `stop` returns `true`.
#[must_use]
pub fn scatter_until(shape: &Shape, count: usize, stop: Stop<'_>) -> Option<Vec<Point>> {
    let corners = |t: &[u32; 3]| t.map(|v| shape.positions[v as usize]);
    let area = |[a, b, c]: [DVec3; 3]| doubled_area(a, b, c);
    let mut total = 0.0;
    for step in shape.triangles.chunks(STEP) {
        go_on(stop)?;
        total = step.iter().fold(total, |sum, t| sum + area(corners(t)).length());
    }
    let step = total / count as f64;
    let mut points = Vec::with_capacity(count);
    if !(step > 0.0 && step.is_finite()) {
        return Some(points);
    }
    let (mut passed, mut number) = (0.0, 0.0_f64);
    for triangles in shape.triangles.chunks(STEP) {
        go_on(stop)?;
        for t in triangles {
            let [a, b, c] = corners(t);
            let doubled = area([a, b, c]);
            passed += doubled.length();
            while (number + 0.5) * step < passed && points.len() <= count {
                let [mut u, mut v] = PLASTIC.map(|p| (number * p).fract());
                // The far half of the unit square is folded back onto the triangle.
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                let position = a + (b - a) * u + (c - a) * v;
                points.push(Point { position, normal: doubled.normalize_or_zero() });
                number += 1.0;
            }
        }
    }
    Some(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::sample::Sample;

    #[test]
    fn points_are_as_many_as_asked_and_balance_at_the_centre() {
        let surface = Surface::new(&Sample::Blob.mesh(2000).unwrap());
        let centre = surface.centre();
        let shape = Shape::new(surface).unwrap();
        let points = scatter(&shape, 20_000);
        assert!(points.len().abs_diff(20_000) <= 1);
        let mean = points.iter().map(|p| p.position).sum::<DVec3>() / points.len() as f64;
        assert!(mean.distance(shape.unit.apply(centre)) < 1e-3);
        assert!(points.iter().all(|p| p.normal.is_normalized()));
        assert!(scatter(&shape, 0).is_empty());
    }
}
