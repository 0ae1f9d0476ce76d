//! The carrier surface: welded points that a triangle with an area uses, and those triangles.

use glam::DVec3;

use super::Mesh;
use super::stop::{STEP, Stop, changed, chosen, go_on, unstopped};
use super::sum::ordered_sum_until;
use super::weld::weld_until;
use crate::mesh::powers::squared;

/// Marks a file vertex that is no carrier.
pub const NO_CARRIER: u32 = u32::MAX;

/// A triangle has no area when twice its area is at most this share of its longest edge squared. Exact
/// collinearity survives neither a rotation nor a conversion, so the test cannot be against zero. 1e-9
/// is far below any sliver that a modeller keeps on purpose.
const DEGENERATE: f64 = 1e-9;

/// Welded carriers and the triangles over them.
///
/// Points that no triangle with an area uses are absent. They carry nothing and must not set the radial
/// range (the Stanford bunny has 1,113 of them).
#[derive(Debug, Clone)]
pub struct Surface {
    /// Carrier positions, in order of first occurrence in the file.
    pub positions: Vec<DVec3>,
    /// Triangles with an area, as carrier indices.
    pub triangles: Vec<[u32; 3]>,
    /// Per file vertex its carrier, or [`NO_CARRIER`].
    pub carrier_of: Vec<u32>,
    /// Per carrier the first file vertex at its position.
    pub first_vertex: Vec<u32>,
}

/// Twice the area vector of a triangle: `(b - a) x (c - a)`.
#[must_use]
pub fn doubled_area(a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    (b - a).cross(c - a)
}

fn has_area(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let longest =
        (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let doubled = doubled_area(a, b, c).length_squared();
    // A negated `<=` would accept NaN as an area: coordinates near the largest double overflow here.
    doubled > squared(DEGENERATE * longest)
}

/// The triangles with an area, with points as corners.
fn with_area(
    triangles: &[[u32; 3]],
    stop: Stop<'_>,
    point: impl Fn(u32) -> u32 + Sync,
    at: impl Fn(u32) -> DVec3 + Sync,
) -> Option<Vec<[u32; 3]>> {
    chosen(triangles, stop, |_, t| {
        let [a, b, c] = t.map(&point);
        let distinct = a != b && b != c && c != a;
        (distinct && has_area(at(a), at(b), at(c))).then_some([a, b, c])
    })
}

impl Surface {
    /// Welds positions, then drops triangles without area and unused points.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        unstopped(|stop| Self::new_until(mesh, stop))
    }

    /// As [`Self::new`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(mesh: &Mesh, stop: Stop<'_>) -> Option<Self> {
        let file = mesh.positions();
        let welded = weld_until(file, stop)?;
        let mut triangles = if welded.first_vertex.len() == file.len() {
            // No position is repeated: points are vertices, and no lookup is needed.
            with_area(mesh.triangles(), stop, |v| v, |p| file[p as usize])?
        } else {
            let at = |p: u32| file[welded.first_vertex[p as usize] as usize];
            with_area(mesh.triangles(), stop, |v| welded.point_of[v as usize], at)?
        };

        let mut carrier_of_point = vec![NO_CARRIER; welded.first_vertex.len()];
        for step in triangles.chunks(STEP) {
            go_on(stop)?;
            for &p in step.iter().flatten() {
                carrier_of_point[p as usize] = 0;
            }
        }
        let mut positions = Vec::with_capacity(welded.first_vertex.len());
        let mut first_vertex = Vec::with_capacity(welded.first_vertex.len());
        let mut next = 0;
        let steps = carrier_of_point.chunks_mut(STEP).zip(welded.first_vertex.chunks(STEP));
        for (carriers, firsts) in steps {
            go_on(stop)?;
            for (carrier, &first) in carriers.iter_mut().zip(firsts) {
                if *carrier != NO_CARRIER {
                    *carrier = next;
                    next += 1;
                    positions.push(file[first as usize]);
                    first_vertex.push(first);
                }
            }
        }
        if positions.len() != carrier_of_point.len() {
            let renamed = |t: [u32; 3]| t.map(|p| carrier_of_point[p as usize]);
            changed(&mut triangles, stop, |_, t| *t = renamed(*t))?;
        }
        let mut carrier_of = welded.point_of;
        changed(&mut carrier_of, stop, |_, p| *p = carrier_of_point[*p as usize])?;
        Some(Self { positions, triangles, carrier_of, first_vertex })
    }

    /// The area-weighted centre at the surface's own positions.
    #[must_use]
    pub fn centre(&self) -> DVec3 {
        self.centre_at(&self.positions)
    }

    /// As [`Self::centre`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn centre_until(&self, stop: Stop<'_>) -> Option<DVec3> {
        self.centre_at_until(&self.positions, stop)
    }

    /// The area-weighted centre with the carriers at `positions` (paper eq. 3, normalised by the sum of
    /// the weights). The printed division by area(O) gives three times too much, because each triangle
    /// is counted at three vertices.
    ///
    /// `sum_j a_j v_j / sum_j a_j`, with `a_j` the area of the triangles at `v_j`, equals the
    /// area-weighted mean of the triangles' centroids. This form needs no per-vertex areas.
    #[must_use]
    pub fn centre_at(&self, positions: &[DVec3]) -> DVec3 {
        unstopped(|stop| self.centre_at_until(positions, stop))
    }

    /// As [`Self::centre_at`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn centre_at_until(&self, positions: &[DVec3], stop: Stop<'_>) -> Option<DVec3> {
        // Relative to one corner, so that a mesh far from the origin keeps its digits.
        let origin = positions.first().copied().unwrap_or(DVec3::ZERO);
        let (moment, area) = ordered_sum_until(
            &self.triangles,
            (DVec3::ZERO, 0.0),
            |(moment, area), t| {
                let [a, b, c] = t.map(|i| positions[i as usize] - origin);
                let doubled = doubled_area(a, b, c).length();
                (moment + doubled * (a + b + c), area + doubled)
            },
            |(m, a), (n, b)| (m + n, a + b),
            stop,
        )?;
        Some(if area > 0.0 { origin + moment / (3.0 * area) } else { origin })
    }

    /// Length of the diagonal of the carriers' bounding box: the unit of every relative distance.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        let (low, high) = self
            .positions
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| {
                (low.min(p), high.max(p))
            });
        if self.positions.is_empty() { 0.0 } else { (high - low).length() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square_with_stray_points() -> Mesh {
        let p = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        Mesh::new(
            vec![
                p(9.0, 9.0), // used by nothing
                p(0.0, 0.0),
                p(2.0, 0.0),
                p(2.0, 2.0),
                p(2.0, 2.0), // seam copy of 3
                p(0.0, 2.0),
                p(0.0, 0.0), // seam copy of 1
                p(7.0, 7.0), // used by area-less triangles only
            ],
            vec![[1, 2, 3], [6, 4, 5], [7, 7, 7], [1, 3, 4]],
        )
        .unwrap()
    }

    #[test]
    fn seams_are_welded_and_strays_are_absent() {
        let surface = Surface::new(&square_with_stray_points());
        assert_eq!(surface.positions.len(), 4);
        assert_eq!(surface.triangles, vec![[0, 1, 2], [0, 2, 3]]);
        let none = NO_CARRIER;
        assert_eq!(surface.carrier_of, vec![none, 0, 1, 2, 2, 3, 0, none]);
    }

    #[test]
    fn the_centre_is_the_centroid_of_the_area_wherever_the_mesh_lies() {
        let near = Surface::new(&square_with_stray_points());
        assert!((near.centre() - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-15);
        let shift = DVec3::new(1e6, -3e6, 2e6);
        let moved: Vec<DVec3> = near.positions.iter().map(|&p| p + shift).collect();
        assert!((near.centre_at(&moved) - shift - near.centre()).length() < 1e-9);
    }

    #[test]
    fn a_collinear_triangle_has_no_area_even_after_a_rotation() {
        let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -0.7);
        let [a, b, c] = [0.0, 1.0, 3.0].map(|x| turn * DVec3::new(x, 2.0 * x, -x));
        assert!(!has_area(a, b, c));
        assert!(has_area(a, b, c + DVec3::new(0.0, 0.0, 1e-6)));
    }
}
