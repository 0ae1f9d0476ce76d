//! Spin images (Johnson and Hebert 1999) over a ladder of radii: what the surface within a radius
//! looks like from a point on it, whatever the triangles.
//!
//! How large a fragment is within its host is unknown, so the host is described at many radii and
//! the suspect at few: those that look alike tell the scale.

use glam::DVec3;
use rayon::prelude::*;

use super::budget::Stop;
use super::scatter::Point;

/// Bins of the distance from the normal's line, and of the height along it.
const ACROSS: usize = 5;
const ALONG: usize = 8;

/// Entries of a spin image.
const BINS: usize = ACROSS * ALONG;

/// Fewer points within the radius say nothing.
const LEAST_POINTS: f32 = 8.0;

/// A point, its normal averaged over half of the radius, and what it sees.
#[derive(Debug, Clone, Copy)]
pub struct Spin {
    /// Where it is.
    pub position: DVec3,
    /// Its normal, of unit length.
    pub normal: DVec3,
    image: [f32; BINS],
}

impl Spin {
    /// How alike two images are: 1 at best (Bhattacharyya's coefficient).
    #[must_use]
    pub fn likeness(&self, other: &Self) -> f32 {
        self.image.iter().zip(&other.image).map(|(a, b)| a * b).sum()
    }
}

/// What each of `keys` sees of `points` within `radius`; keys that see too little are left out.
#[must_use]
pub fn spins(keys: &[Point], points: &[Point], radius: f64, stop: Stop) -> Vec<Spin> {
    let seen = |key| if stop() { None } else { spin(key, points, radius) };
    keys.par_iter().filter_map(seen).collect()
}

fn spin(key: &Point, points: &[Point], radius: f64) -> Option<Spin> {
    let position = key.position;
    let square = radius * radius;
    let mut normal = DVec3::ZERO;
    for p in points {
        if p.position.distance_squared(position) < 0.25 * square {
            normal += p.normal;
        }
    }
    let normal = normal.try_normalize()?;
    let mut image = [0.0_f32; BINS];
    for p in points {
        let d = p.position - position;
        let distance = d.length_squared();
        if distance < square {
            let height = d.dot(normal);
            let across = (distance - height * height).max(0.0).sqrt() / radius;
            let along = 0.5 + 0.5 * height / radius;
            image[bin(across, ACROSS) * ALONG + bin(along, ALONG)] += 1.0;
        }
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
    use crate::registration::scatter::scatter;
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
        let here = spins(&points[..300], &points, 0.2, &|| false);
        let there = spins(&moved[..300], &moved, 0.4, &|| false);
        for (k, spin) in here.iter().enumerate() {
            let best = there.iter().map(|s| spin.likeness(s)).fold(0.0, f32::max);
            assert!(spin.likeness(&there[k]) > 0.99, "{k}");
            assert!(best < 1.0 + 1e-5);
        }
        let far = here.iter().filter(|s| s.likeness(&here[0]) < 0.9).count();
        assert!(far > 100, "{far}");
    }
}
