//! Spin images (Johnson and Hebert 1999) at a series of radii. A spin image describes the surface
//! within a radius around a point on it, whatever the triangles.
//!
//! The size of a fragment relative to its host is unknown. So the host is described at many radii
//! and the suspect at few, and the radii at which images are alike give the scale.

use glam::DVec3;
use rayon::prelude::*;

use super::samples::Point;
use crate::registration::budget::Stop;

/// Bins of the distance from the normal's line, and of the height along it.
const ACROSS: usize = 5;
const ALONG: usize = 8;

/// Entries of a spin image: a multiple of eight.
const BINS: usize = ACROSS * ALONG;

/// Least number of points within the radius: fewer say nothing.
const LEAST_POINTS: f32 = 8.0;

/// A point, its normal averaged over half of the radius, and its spin image.
#[derive(Debug, Clone, Copy)]
pub struct Spin {
    /// Where it is.
    pub position: DVec3,
    /// Its normal, of unit length.
    pub normal: DVec3,
    image: [f32; BINS],
}

impl Spin {
    /// The similarity of two images: 1 at best (Bhattacharyya's coefficient).
    #[must_use]
    pub fn likeness(&self, other: &Self) -> f32 {
        // Eight sums side by side: one instruction adds to all of them.
        let (a, b) = (self.image.as_chunks::<8>().0, other.image.as_chunks::<8>().0);
        let mut sums = [0.0_f32; 8];
        for (a, b) in a.iter().zip(b) {
            for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
                *sum += a * b;
            }
        }
        sums.iter().sum()
    }
}

/// Per radius, the spin images of `keys` made from `points`. Keys with too few points around them
/// are left out. `radii` descend, so a point beyond one radius is dropped for those after it.
#[must_use]
pub fn spins(keys: &[Point], points: &[Point], radii: &[f64], stop: Stop) -> Vec<Vec<Spin>> {
    let widest = radii.first().copied().unwrap_or(0.0);
    let of = |key: &Point| -> Vec<Option<Spin>> {
        let seen = points.iter().filter_map(|p| {
            let from = p.position - key.position;
            let distance = from.length_squared();
            (distance < widest * widest).then_some(Neighbour { from, normal: p.normal, distance })
        });
        let mut seen: Vec<Neighbour> = seen.collect();
        let spin = |&radius: &f64| {
            if stop() {
                return None;
            }
            seen.retain(|p| p.distance < radius * radius);
            spin(key.position, &seen, radius)
        };
        radii.iter().map(spin).collect()
    };
    let all: Vec<Vec<Option<Spin>>> = keys.par_iter().map(of).collect();
    let at = |k: usize| all.iter().filter_map(|of| of.get(k).copied().flatten()).collect();
    (0..radii.len()).map(at).collect()
}

/// A point relative to a key point.
struct Neighbour {
    from: DVec3,
    normal: DVec3,
    /// Squared.
    distance: f64,
}

fn spin(position: DVec3, seen: &[Neighbour], radius: f64) -> Option<Spin> {
    let square = radius * radius;
    let inner = seen.iter().filter(|p| p.distance < 0.25 * square);
    let normal = inner.map(|p| p.normal).sum::<DVec3>().try_normalize()?;
    let mut image = [0.0_f32; BINS];
    for p in seen {
        let height = p.from.dot(normal);
        let across = (p.distance - height * height).max(0.0).sqrt() / radius;
        let along = 0.5 + 0.5 * height / radius;
        image[bin(across, ACROSS) * ALONG + bin(along, ALONG)] += 1.0;
    }
    let total: f32 = image.iter().sum();
    for entry in &mut image {
        *entry = (*entry / total).sqrt();
    }
    (total >= LEAST_POINTS).then_some(Spin { position, normal, image })
}

/// Which of `count` bins a share from 0 to 1 falls into.
fn bin(share: f64, count: usize) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of a small count; NaN becomes 0"
    )]
    let bin = (share * count as f64) as usize;
    bin.min(count - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::by_surface::samples::scatter;
    use crate::registration::shape::Shape;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;

    #[test]
    fn a_point_looks_like_itself_in_another_place_and_size() {
        let shape = Shape::new(Surface::new(&Sample::Blob.mesh(3000).unwrap())).unwrap();
        let points = scatter(&shape, 4000);
        let place = awkward(2.0);
        let moved: Vec<Point> = points
            .iter()
            .map(|p| Point { position: place.apply(p.position), normal: place.turn(p.normal) })
            .collect();
        let [here, there] = [(&points, 0.2), (&moved, 0.4)].map(|(points, radius)| {
            spins(&points[..300], points, &[2.0 * radius, radius], &|| false).swap_remove(1)
        });
        for (k, spin) in here.iter().enumerate() {
            let best = there.iter().map(|s| spin.likeness(s)).fold(0.0, f32::max);
            assert!(spin.likeness(&there[k]) > 0.99, "{k}");
            assert!(best < 1.0 + 1e-5);
        }
        let far = here.iter().filter(|s| s.likeness(&here[0]) < 0.9).count();
        assert!(far > 100, "{far}");
    }
}
