//! The original surface below a vertex that moves along it.
//!
//! The nearest point is searched by descent from the vertex's previous position, not over the whole
//! surface. That is faster, and the search never jumps to the other side of a thin wall.

use glam::DVec3;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::closest::nearest_in_triangle;
use crate::mesh::surface::Surface;

/// Largest number of vertices visited by one search. A search ends by itself, since the distance
/// decreases at each vertex. After one round of remeshing, two or three vertices are usual.
const MOST_STEPS: usize = 256;

/// A surface and the triangles around its vertices.
pub struct Ground<'a> {
    surface: &'a Surface,
    around: &'a Adjacency,
}

/// A point on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Its position.
    pub place: DVec3,
    /// The triangle that it lies on.
    pub triangle: u32,
}

impl<'a> Ground<'a> {
    pub fn new(surface: &'a Surface, around: &'a Adjacency) -> Self {
        Self { surface, around }
    }

    /// The point nearest to `point` that descent from `triangle` reaches.
    pub fn foot(&self, point: DVec3, triangle: u32) -> Foot {
        let (place, mut on) = self.nearest(point, triangle);
        let mut foot = Foot { place, triangle };
        let mut best = place.distance_squared(point);
        // The corner whose triangles were examined last.
        let mut at = u32::MAX;
        for _ in 0..MOST_STEPS {
            // If the nearest point lies inside a triangle, its neighbours are no nearer. All
            // triangles at a side or corner are around each of its ends. So once the triangles
            // around one end were examined, none of them is nearer.
            let corners = self.surface.triangles[foot.triangle as usize];
            let mut ends = corners.into_iter().zip(on).filter_map(|(end, on)| on.then_some(end));
            if on == [true; 3] || ends.clone().any(|end| end == at) {
                break;
            }
            let Some(next) = ends.next() else { break };
            at = next;
            for &triangle in self.around.around(at as usize) {
                let (place, spanned) = self.nearest(point, triangle);
                let squared = place.distance_squared(point);
                if squared < best {
                    (best, on) = (squared, spanned);
                    foot = Foot { place, triangle };
                }
            }
        }
        foot
    }

    fn nearest(&self, point: DVec3, triangle: u32) -> (DVec3, [bool; 3]) {
        let corners = self.surface.triangles[triangle as usize];
        nearest_in_triangle(point, corners.map(|v| self.surface.positions[v as usize]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::closest::Closest;
    use crate::sample::Sample;

    #[test]
    fn downhill_from_nearby_leads_to_the_nearest_place() {
        for sample in Sample::ALL {
            let surface = Surface::new(&sample.mesh(5_000).unwrap());
            let around = Adjacency::new(surface.positions.len(), &surface.triangles);
            let (ground, all) = (Ground::new(&surface, &around), Closest::new(&surface).unwrap());
            let mut same = 0;
            for (number, &[a, b, c]) in (0..).zip(&surface.triangles) {
                let start = ground.around.around(a as usize)[number % 2];
                let [p, q, r] = [a, b, c].map(|v| surface.positions[v as usize]);
                // Near the triangle's far end, off the surface.
                let normal = (q - p).cross(r - p).normalize();
                let point = q + 0.3 * (r - p) + 0.1 * p.distance(q) * normal;
                let foot = ground.foot(point, start);
                let nearest = all.point(point);
                assert!(all.distance(foot.place) < 1e-12);
                let excess = foot.place.distance(point) - nearest.distance(point);
                assert!(excess > -1e-12, "{sample}: {excess}");
                same += usize::from(excess < 1e-12);
            }
            // Descent ends elsewhere only in folds.
            let share = same as f64 / surface.triangles.len() as f64;
            assert!(share > 0.97, "{sample}: {share}");
        }
    }
}
