//! The last digits of a registration. A remaining turn of half a degree, or a thousandth of the size,
//! appears in the heights as long waves over the host, from which it is fitted and undone.

use glam::{DQuat, DVec3};

use super::heights::{Points, Work, heights_of};
use super::host::ReliefHost;
use super::regress::{median_size, regress};
use crate::mesh::surface::Surface;

/// Largest number of rounds. Two rounds reduce half a degree to a hundredth of it.
const ROUNDS: usize = 3;

/// Points on triangles that a round uses.
const POINTS: usize = 12_000;

/// Least number of heights of a fit.
const LEAST: usize = 200;

/// The usual error of a registration: in shares of the diagonal, in shares of the size, and in radians.
const EXPECTED: f64 = 5e-4;

/// A motion is kept where it reduces the median height to at most this share.
const IMPROVEMENT: f64 = 0.9;

/// Motion of the farthest point, as a share of the diagonal, below which the rounds end: a tenth of the
/// heights that are read.
const LEAST_MOTION: f64 = 5e-6;

/// Motion beyond which a fit is not trusted: a suspect that is so far off was not registered.
const MOST_MOTION: f64 = 2e-2;

/// The carriers of a suspect after refinement; `None` when stopped.
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
            && (heights.len() < LEAST || size > IMPROVEMENT * was)
        {
            // A motion that does not bring the suspect closer is one that heights do not determine.
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
        if most.is_nan() || most > MOST_MOTION {
            break;
        }
        // The quaternion of a small turn, exact to the square of the turn; the next round fits the
        // rest.
        let half = -0.5 * turn;
        before = Some((size, now.clone()));
        let back = DQuat::from_xyzw(half.x, half.y, half.z, 1.0).normalize();
        let diagonal = host.field.diagonal();
        for p in &mut now {
            let arm = *p - host.centre - shift * diagonal;
            *p = host.centre + back * arm / (1.0 + grown);
        }
        if most <= LEAST_MOTION {
            break;
        }
    }
    Some(now)
}
