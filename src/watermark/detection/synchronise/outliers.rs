//! The body of a suspect: what is left without stray parts far from the rest.

use glam::DVec3;

use crate::mesh::stop::{Stop, chosen, go_on, mapped};
use crate::mesh::surface::Surface;
use crate::watermark::{Profile, Suspect};

/// At each end of the norms, one carrier in the first number may be stray, and at least the second
/// number.
const TAIL: (usize, usize) = (200, 64);

/// Width of a gap in the norms of that tail, as a share of the extent of the rest. Everything beyond
/// such a gap is stray. Sparse tips of the meshes measured leave gaps below 0.03.
const GAP: f64 = 0.1;

/// What is left of a suspect.
#[derive(Debug)]
pub struct Body {
    /// Its points.
    pub positions: Vec<DVec3>,
    /// Its area-weighted centre.
    pub centre: DVec3,
    /// The diagonal of its bounding box.
    pub diagonal: f64,
}

/// The suspect without what lies beyond a wide gap in its norms; `None` once `stop` answers `true`.
pub fn body(suspect: &Suspect, stop: Stop<'_>) -> Option<Body> {
    let surface = suspect.surface();
    let mut centre = suspect.frame().centre;
    let (mut low, mut high) = range(suspect.profile());
    let norms = suspect.profile().norms();
    if norms.first().is_some_and(|&rho| rho < low) || norms.last().is_some_and(|&rho| rho > high) {
        // The strays shifted the centre by which they were found, so the search is repeated about the
        // new centre.
        for _ in 0..2 {
            let near = |&p: &DVec3| (low..=high).contains(&(p - centre).length());
            let part = part(surface, near, stop)?;
            let centre_of_part = part.centre_until(stop)?;
            let profile = Profile::about_until(&part.positions, centre_of_part, stop)?;
            centre = profile.frame().centre;
            (low, high) = range(&profile);
        }
        let near = |&p: &DVec3| (low..=high).contains(&(p - centre).length());
        let part = part(surface, near, stop)?;
        let (centre, diagonal) = (part.centre_until(stop)?, part.diagonal());
        return Some(Body { positions: part.positions, centre, diagonal });
    }
    go_on(stop)?;
    Some(Body { positions: surface.positions.clone(), centre, diagonal: surface.diagonal() })
}

/// The points that are `near`, and the triangles all of whose corners are.
fn part(
    surface: &Surface,
    near: impl Fn(&DVec3) -> bool + Sync,
    stop: Stop<'_>,
) -> Option<Surface> {
    let kept = mapped(&surface.positions, stop, |_, p| near(p))?;
    let mut new = vec![u32::MAX; kept.len()];
    let mut positions = Vec::with_capacity(kept.len());
    for ((&p, &kept), new) in surface.positions.iter().zip(&kept).zip(&mut new) {
        if kept {
            *new = u32::try_from(positions.len()).unwrap_or(u32::MAX);
            positions.push(p);
        }
    }
    let triangles = chosen(&surface.triangles, stop, |_, t| {
        t.iter().all(|&v| kept[v as usize]).then(|| t.map(|v| new[v as usize]))
    })?;
    Some(Surface { positions, triangles, carrier_of: Vec::new(), first_vertex: Vec::new() })
}

/// The range of norms around the middle that no wide gap interrupts, within the tails.
fn range(profile: &Profile) -> (f64, f64) {
    let norms = profile.norms();
    let (Some(&first), Some(&last)) = (norms.first(), norms.last()) else { return (0.0, 0.0) };
    let tail = (norms.len() / TAIL.0).max(TAIL.1).min(norms.len() / 4);
    let (below, rest) = norms.split_at(tail);
    let (rest, above) = rest.split_at(rest.len() - tail);
    let (Some(&low), Some(&high)) = (rest.first(), rest.last()) else { return (first, last) };
    let gap = GAP * (high - low);
    let outward = |from: f64, next: f64| ((next - from).abs() <= gap).then_some(next);
    let high = above.iter().try_fold(high, |from, &next| outward(from, next).ok_or(from));
    let low = below.iter().rev().try_fold(low, |from, &next| outward(from, next).ok_or(from));
    let either = |end: Result<f64, f64>| end.unwrap_or_else(|end| end);
    (either(low), either(high))
}
