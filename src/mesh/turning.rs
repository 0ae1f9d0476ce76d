//! How far triangles turned when their corners moved.

use glam::DVec3;
use rayon::prelude::*;

use super::sum::ordered_sum;
use super::surface::{Surface, doubled_area};

/// How far the triangles of a surface turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turning {
    /// Mean angle between normals, weighted by the area before the move.
    pub mean_degrees: f64,
    /// Triangles that turned by more than 90 degrees.
    pub flipped: usize,
}

/// Compares the triangles' normals with the carriers at `moved` to those of the surface.
#[must_use]
pub fn turning(surface: &Surface, moved: &[DVec3]) -> Turning {
    let (turned, area, flipped) = ordered_sum(
        &surface.triangles,
        (0.0, 0.0, 0_usize),
        |(turned, area, flipped), t| {
            let [a, b, c] = t.map(|i| surface.positions[i as usize]);
            let before = doubled_area(a, b, c);
            let [a, b, c] = t.map(|i| moved[i as usize]);
            let after = doubled_area(a, b, c);
            let along = before.dot(after);
            // Not the arc cosine, which has no digits left for small angles.
            let angle = libm::atan2(before.cross(after).length(), along);
            let weight = before.length();
            (turned + weight * angle, area + weight, flipped + usize::from(along < 0.0))
        },
        |(t, a, f), (u, b, g)| (t + u, a + b, f + g),
    );
    let mean_degrees = if area > 0.0 { (turned / area).to_degrees() } else { 0.0 };
    Turning { mean_degrees, flipped }
}

/// Triangles whose normal turns by more than 90 degrees when the carriers move to `moved`,
/// ascending.
#[must_use]
pub fn flipped_triangles(surface: &Surface, moved: &[DVec3]) -> Vec<u32> {
    let count = u32::try_from(surface.triangles.len()).unwrap_or(u32::MAX);
    (0..count)
        .into_par_iter()
        .with_min_len(4096)
        .filter(|&t| is_flipped(surface, t, moved))
        .collect()
}

/// Whether one of them is.
#[must_use]
pub fn is_flipped(surface: &Surface, triangle: u32, moved: &[DVec3]) -> bool {
    let corners = surface.triangles[triangle as usize];
    let normal = |at: &[DVec3]| {
        let [a, b, c] = corners.map(|i| at[i as usize]);
        doubled_area(a, b, c)
    };
    normal(&surface.positions).dot(normal(moved)) < 0.0
}
