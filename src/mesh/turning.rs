//! How far triangles turned when their corners moved.

use glam::DVec3;
use rayon::prelude::*;

use super::surface::{Surface, doubled_area};

/// Triangles whose normal turns by more than 90 degrees when the carriers move to `moved`,
/// ascending.
#[must_use]
pub fn flipped_triangles(surface: &Surface, moved: &[DVec3]) -> Vec<u32> {
    let normal = |t: &[u32; 3], at: &[DVec3]| {
        let [a, b, c] = t.map(|i| at[i as usize]);
        doubled_area(a, b, c)
    };
    surface
        .triangles
        .par_iter()
        .with_min_len(4096)
        .enumerate()
        .filter(|(_, t)| normal(t, &surface.positions).dot(normal(t, moved)) < 0.0)
        .filter_map(|(index, _)| u32::try_from(index).ok())
        .collect()
}
