//! The last digits of a registration: heights see half a degree and a thousandth of the size as long
//! waves over the host, and say how to take them back.

use glam::{DQuat, DVec3};

use super::heights::{Points, Work, heights_of};
use super::host::ReliefHost;
use super::regress::{median_size, regress};
use crate::mesh::surface::Surface;

/// Rounds at the most; two bring half a degree to a hundredth of that.
const ROUNDS: usize = 3;

/// Points on triangles that a round looks at.
const POINTS: usize = 12_000;

/// Least number of heights that a fit is made of.
const LEAST: usize = 200;

/// How far off a registration is usually: shares of the diagonal, of the size, and radians.
const EXPECTED: f64 = 5e-4;

/// A motion is kept where it brings the median height to this share of what it was, at least.
const CLOSER: f64 = 0.9;

/// Moves of the farthest point, as a share of the diagonal, below which nothing is moved any more: a
/// tenth of the heights that are read.
const SETTLED: f64 = 5e-6;

/// Moves beyond which a fit is not trusted: what is so far off was not registered.
const ASTRAY: f64 = 2e-2;

/// The carriers of a suspect, nearer to where they belong; `None` when stopped.
pub(super) fn refined(
    host: &ReliefHost,
    suspect: &Surface,
    positions: &[DVec3],
    mirrored: bool,
    work: &mut Work<'_>,
) -> Option<Vec<DVec3>> {
    let mut now = positions.to_vec();
    let mut before: Option<(f64, Vec<DVec3>)> = None;
    for round in 0..=ROUNDS {
        let points = Points::in_triangles(host, suspect, &now, mirrored, POINTS);
        let heights = heights_of(host, &points.all, work)?;
        let size = median_size(&heights.iter().map(|of| of.above).collect::<Vec<f64>>());
        if let Some((was, positions)) = before.take()
            && (heights.len() < LEAST || size > CLOSER * was)
        {
            // What does not bring the suspect closer is a turn that heights do not settle.
            return Some(positions);
        }
        if heights.len() < LEAST || round == ROUNDS {
            break;
        }
        let Some(motion) = regress(host, &heights, Some(EXPECTED)).similarity else { break };
        let [tx, ty, tz, rx, ry, rz, grown] = motion;
        // The term of a turn by w is `n . (w x arm) = -(n x arm) . w`.
        let (shift, turn) = (DVec3::new(tx, ty, tz), -DVec3::new(rx, ry, rz));
        let most = shift.length() + turn.length() + grown.abs();
        if most.is_nan() || most > ASTRAY {
            break;
        }
        // Of a small turn; exact to its square, which the next round sees.
        let half = -0.5 * turn;
        before = Some((size, now.clone()));
        let back = DQuat::from_xyzw(half.x, half.y, half.z, 1.0).normalize();
        let diagonal = host.field.diagonal();
        for p in &mut now {
            let arm = *p - host.centre - shift * diagonal;
            *p = host.centre + back * arm / (1.0 + grown);
        }
        if most <= SETTLED {
            break;
        }
    }
    Some(now)
}
