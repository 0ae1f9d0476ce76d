//! The inside of a closed surface, from its winding numbers at the corners of a grid.

use glam::DVec3;
use rayon::prelude::*;

use super::Grid;
use crate::attacks::edges::Edges;
use crate::mesh::surface::Surface;

/// For each grid line along x, where the surface crosses it.
///
/// The winding number of a point is the signed number of crossings on a ray from the point. It is
/// exact wherever the surface is closed, even where parts touch, lie in each other or share edges.
/// There the normal at the closest point may belong to either part. This is the ray stabbing of
/// Nooruddin and Turk (*Simplification and repair of polygonal models using volumetric techniques*,
/// IEEE TVCG 9(2), 2003), with signs.
pub struct Winding {
    /// Line, x coordinate, and the signed number of crossings from there on; ascending.
    crossings: Vec<(u64, f64, i32)>,
}

/// Whether a surface is closed: along each edge, as many triangles run in one direction as in the
/// other.
pub fn is_closed(surface: &Surface, edges: &Edges) -> bool {
    let mut balance = vec![0_i32; edges.ends.len()];
    for (side, &edge) in edges.of_side.iter().enumerate() {
        let start = surface.triangles[side / 3][side % 3];
        balance[edge] += if start == edges.ends[edge][0] { 1 } else { -1 };
    }
    balance.iter().all(|&sum| sum == 0)
}

impl Winding {
    /// Finds the crossings of a surface that [`is_closed`].
    pub fn new(grid: &Grid, surface: &Surface) -> Self {
        let of = |triangle: &[u32; 3]| crossings(grid, surface, *triangle);
        let mut crossings: Vec<(u64, f64, i32)> =
            surface.triangles.par_iter().with_min_len(1024).flat_map_iter(of).collect();
        crossings.par_sort_unstable_by(|a, b| {
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2))
        });
        let mut beyond = 0;
        for at in (0..crossings.len()).rev() {
            if crossings.get(at + 1).is_none_or(|next| next.0 != crossings[at].0) {
                beyond = 0;
            }
            beyond += crossings[at].2;
            crossings[at].2 = beyond;
        }
        Self { crossings }
    }

    /// Whether the surface winds around a corner of the grid, that is, its winding number is not 0.
    pub fn is_inside(&self, grid: &Grid, corner: DVec3) -> bool {
        let line = grid.line_of(corner);
        let next = self
            .crossings
            .partition_point(|&(own, x, _)| own < line || (own == line && x <= corner.x));
        self.crossings.get(next).is_some_and(|&(own, _, beyond)| own == line && beyond != 0)
    }
}

/// Where a triangle crosses grid lines along x: +1 if its normal points towards +x, else -1.
fn crossings(grid: &Grid, surface: &Surface, triangle: [u32; 3]) -> Vec<(u64, f64, i32)> {
    let [a, b, c] = triangle.map(|v| surface.positions[v as usize]);
    let mut found = Vec::new();
    for corner in grid.lines_within(a.min(b).min(c), a.max(b).max(c)) {
        // The side of each edge on which the line passes. It is computed from the end with the
        // lower index, so that both triangles at an edge agree and no line slips through between
        // them.
        let side = |from: usize, to: usize| {
            let [i, j] = [triangle[from], triangle[to]];
            let turned = i > j;
            let [p, q] = [i.min(j), i.max(j)].map(|v| surface.positions[v as usize] - corner);
            let doubled = p.y * q.z - p.z * q.y;
            (if turned { -doubled } else { doubled }, (doubled > 0.0) != turned)
        };
        let [(w_c, left_c), (w_a, left_a), (w_b, left_b)] = [side(0, 1), side(1, 2), side(2, 0)];
        let sum = w_a + w_b + w_c;
        if left_a == left_b && left_b == left_c && sum != 0.0 {
            let x = (w_a * a.x + w_b * b.x + w_c * c.x) / sum;
            found.push((grid.line_of(corner), x, if left_a { 1 } else { -1 }));
        }
    }
    found
}
