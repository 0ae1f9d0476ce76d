//! Evenly spread sample points on a surface: its vertices, points on its edges, points in its
//! triangles, as Metro samples them (Cignoni et al. 1998). Deterministic: points follow the edges and
//! triangles in order, at equal steps of length and area.

use glam::DVec3;

use super::surface::{Surface, doubled_area};

/// The reciprocals of the plastic number 1.3247 and of its square: the steps of the R2 low-discrepancy
/// sequence in the plane.
pub(super) const PLASTIC: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// All carriers, then `per_kind` points on edges and `per_kind` points in triangles.
#[must_use]
pub fn samples(surface: &Surface, per_kind: usize) -> Vec<DVec3> {
    let mut points = Vec::with_capacity(surface.positions.len() + 2 * per_kind);
    points.extend_from_slice(&surface.positions);
    on_edges(surface, per_kind, &mut points);
    in_triangles(&surface.positions, &surface.triangles, per_kind, |_, p| points.push(p));
    points
}

/// Each edge once, whatever the number of triangles at it.
fn unique_edges(surface: &Surface) -> Vec<[u32; 2]> {
    let sides = |&[a, b, c]: &[u32; 3]| [[a, b], [b, c], [c, a]].map(|[i, j]| [i.min(j), i.max(j)]);
    let mut edges: Vec<[u32; 2]> = surface.triangles.iter().flat_map(sides).collect();
    rayon::slice::ParallelSliceMut::par_sort_unstable(edges.as_mut_slice());
    edges.dedup();
    edges
}

fn on_edges(surface: &Surface, count: usize, points: &mut Vec<DVec3>) {
    let edges = unique_edges(surface);
    let ends = |edge: &[u32; 2]| edge.map(|i| surface.positions[i as usize]);
    let length = |edge: &[u32; 2]| {
        let [a, b] = ends(edge);
        (b - a).length()
    };
    spread(&edges, length, count, |edge, within, _| {
        let [a, b] = ends(edge);
        points.push(a + (b - a) * within);
    });
}

/// Hands out `count` points in triangles, evenly by area, each with its triangle.
pub fn in_triangles(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    count: usize,
    mut visit: impl FnMut(&[u32; 3], DVec3),
) {
    let corners = |t: &[u32; 3]| t.map(|i| positions[i as usize]);
    let area = |t: &[u32; 3]| {
        let [a, b, c] = corners(t);
        doubled_area(a, b, c).length()
    };
    spread(triangles, area, count, |t, _, number| {
        let [a, b, c] = corners(t);
        let [mut u, mut v] = PLASTIC.map(|step| (number * step).fract());
        // The far half of the unit square is folded back onto the triangle.
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        visit(t, a + (b - a) * u + (c - a) * v);
    });
}

/// Visits `count` points at equal steps of the items' summed `size`. The arguments of `visit` are the
/// item, the share of the item's size before the point, and the number of the point.
fn spread<T>(
    items: &[T],
    size: impl Fn(&T) -> f64,
    count: usize,
    mut visit: impl FnMut(&T, f64, f64),
) {
    let total: f64 = items.iter().map(&size).sum();
    if !(total > 0.0 && total.is_finite()) {
        return;
    }
    let step = total / count as f64;
    let (mut passed, mut next, mut number) = (0.0, 0.5 * step, 0.0);
    for item in items {
        let this = size(item);
        while next < passed + this {
            visit(item, (next - passed) / this, number);
            number += 1.0;
            next = (number + 0.5) * step;
        }
        passed += this;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;

    #[test]
    fn samples_lie_on_the_surface_and_are_as_many_as_asked() {
        let surface = Surface::new(&Sample::Blob.mesh(2000).unwrap());
        let points = samples(&surface, 5000);
        let expected = surface.positions.len() + 10_000;
        assert!(points.len().abs_diff(expected) <= 2);
        let target = crate::mesh::closest::Closest::new(&surface).unwrap();
        let back = crate::mesh::distortion::one_sided(&points, &target);
        assert!(back.1 < 1e-12);
    }

    #[test]
    fn the_mean_of_the_triangle_samples_is_the_centre() {
        let surface = Surface::new(&Sample::Blob.mesh(2000).unwrap());
        let mut points = Vec::new();
        let Surface { positions, triangles, .. } = &surface;
        in_triangles(positions, triangles, 200_000, |_, p| points.push(p));
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        assert!((mean - surface.centre()).length() < 1e-3);
    }
}
