//! How far triangles turn when their corners move.

use glam::DVec3;

use super::stop::{Stop, chosen, unstopped};
use super::sum::ordered_sum_until;
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
    unstopped(|stop| turning_until(surface, moved, stop))
}

/// As [`turning`]; `None` once `stop` answers `true`.
#[must_use]
pub fn turning_until(surface: &Surface, moved: &[DVec3], stop: Stop<'_>) -> Option<Turning> {
    let (turned, area, flipped) = ordered_sum_until(
        &surface.triangles,
        (0.0, 0.0, 0_usize),
        |(turned, area, flipped), t| {
            let [a, b, c] = t.map(|i| surface.positions[i as usize]);
            let before = doubled_area(a, b, c);
            let [a, b, c] = t.map(|i| moved[i as usize]);
            let after = doubled_area(a, b, c);
            let along = before.dot(after);
            // Not the arc cosine, which loses all digits for small angles.
            let angle = libm::atan2(before.cross(after).length(), along);
            let weight = before.length();
            (turned + weight * angle, area + weight, flipped + usize::from(along < 0.0))
        },
        |(t, a, f), (u, b, g)| (t + u, a + b, f + g),
        stop,
    )?;
    let mean_degrees = if area > 0.0 { (turned / area).to_degrees() } else { 0.0 };
    Some(Turning { mean_degrees, flipped })
}

/// Triangles whose normal turns by more than 90 degrees when the carriers move to `moved`,
/// ascending.
#[must_use]
pub fn flipped_triangles(surface: &Surface, moved: &[DVec3]) -> Vec<u32> {
    unstopped(|stop| flipped_until(surface, moved, stop))
}

/// As [`flipped_triangles`]; `None` once `stop` answers `true`.
#[must_use]
pub fn flipped_until(surface: &Surface, moved: &[DVec3], stop: Stop<'_>) -> Option<Vec<u32>> {
    let number = |t: usize| u32::try_from(t).unwrap_or(u32::MAX);
    chosen(&surface.triangles, stop, |t, _| {
        let t = number(t);
        is_flipped(surface, t, moved).then_some(t)
    })
}

/// Whether the normal of one triangle turns by more than 90 degrees when the carriers move to `moved`.
#[must_use]
pub fn is_flipped(surface: &Surface, triangle: u32, moved: &[DVec3]) -> bool {
    let corners = surface.triangles[triangle as usize];
    let normal = |at: &[DVec3]| {
        let [a, b, c] = corners.map(|i| at[i as usize]);
        doubled_area(a, b, c)
    };
    normal(&surface.positions).dot(normal(moved)) < 0.0
}
