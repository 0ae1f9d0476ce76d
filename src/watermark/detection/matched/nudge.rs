//! A small similarity that moves points onto others, with weights against outliers.
//!
//! For points that nearly coincide: each step linearises the rotation. Must not know marks.

use glam::{DMat3, DQuat, DVec3};

use super::{KNEE, median};
use crate::mesh::powers::{cubed, squared};
use crate::mesh::stop::Stop;

/// Rounds of reweighting.
const ROUNDS: usize = 3;

/// Share of the cube of its trace below which the determinant of an inertia tensor fixes no rotation.
const FLAT: f64 = 1e-12;

/// `x -> linear x + shift`, where `linear` turns and scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SmallSimilarity {
    linear: DMat3,
    shift: DVec3,
}

impl SmallSimilarity {
    /// The identity.
    pub(super) const NONE: Self = Self { linear: DMat3::IDENTITY, shift: DVec3::ZERO };

    /// The image of `p`.
    pub(super) fn apply(&self, p: DVec3) -> DVec3 {
        self.linear * p + self.shift
    }

    /// The similarity that takes the first points of the pairs to the second ones by weighted least
    /// squares, starting from `self`. The result must be discarded once `stop` answers `true`.
    pub(super) fn onto(mut self, pairs: &[(DVec3, DVec3)], stop: Stop<'_>) -> Self {
        for _ in 0..ROUNDS {
            if stop() {
                break;
            }
            let off = |&(from, to): &(DVec3, DVec3)| self.apply(from).distance(to);
            let off: Vec<f64> = pairs.iter().map(off).collect();
            let knee = KNEE * median(off.clone());
            if knee.is_nan() || knee <= 0.0 {
                break;
            }
            let weight = |off: f64| 1.0 / (1.0 + squared(off / knee));
            if stop() {
                break;
            }
            let weights: Vec<f64> = off.into_iter().map(weight).collect();
            let Some(next) = self.step(pairs, &weights) else { break };
            self = next;
        }
        self
    }

    /// One step of least squares. As in registration, the noise is in the first points, and the scale
    /// is therefore the square of the second points over the cross term.
    fn step(&self, pairs: &[(DVec3, DVec3)], weights: &[f64]) -> Option<Self> {
        let moved = || pairs.iter().zip(weights).map(|(&(a, b), &w)| (self.apply(a), b, w));
        let (mut sum, mut a_mean, mut b_mean) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for (a, b, w) in moved() {
            sum += w;
            a_mean += w * a;
            b_mean += w * b;
        }
        a_mean /= sum;
        b_mean /= sum;
        let (mut square, mut along, mut torque) = (0.0, 0.0, DVec3::ZERO);
        let mut inertia = DMat3::ZERO;
        for (a, b, w) in moved() {
            let (a, b) = (a - a_mean, b - b_mean);
            square += w * b.length_squared();
            along += w * a.dot(b);
            torque += w * a.cross(b);
            let outer = DMat3::from_cols(a * a.x, a * a.y, a * a.z);
            inertia += w * (DMat3::from_diagonal(DVec3::splat(a.length_squared())) - outer);
        }
        let trace = inertia.x_axis.x + inertia.y_axis.y + inertia.z_axis.z;
        if inertia.determinant() <= FLAT * cubed(trace) {
            return None;
        }
        let half = 0.5 * (inertia.inverse() * torque);
        let turn = DQuat::from_xyzw(half.x, half.y, half.z, 1.0).normalize();
        let linear = square / along * DMat3::from_quat(turn);
        let next =
            Self { linear: linear * self.linear, shift: linear * (self.shift - a_mean) + b_mean };
        let valid = along > 0.0 && next.linear.is_finite() && next.shift.is_finite();
        valid.then_some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points that fill a box, each after its image under the given similarity.
    fn pairs(turn: DVec3, scale: f64, shift: DVec3, wrong: usize) -> Vec<(DVec3, DVec3)> {
        let back = |p: DVec3| DQuat::from_scaled_axis(turn) * p * scale + shift;
        let at = |k: usize| {
            let t = k as f64;
            DVec3::new((t * 1.7).sin(), 2.0 * (t * 0.6).cos(), 0.5 * (t * 2.9).sin())
        };
        let from = |k: usize| back(if k % 10 < wrong { -at(k) } else { at(k) });
        (0..2000).map(|k| (from(k), at(k))).collect()
    }

    #[test]
    fn a_small_move_is_undone_and_outliers_hardly_count() {
        let table = [
            (DVec3::ZERO, 0.97, DVec3::ZERO),
            (DVec3::new(0.01, -0.02, 0.005), 1.03, DVec3::new(0.02, 0.01, -0.03)),
            (DVec3::new(0.0, 0.05, 0.0), 1.0, DVec3::ZERO),
        ];
        for (turn, scale, shift) in table {
            for (wrong, close) in [(0, 1e-5), (2, 1e-3)] {
                let pairs = pairs(turn, scale, shift, wrong);
                let found = SmallSimilarity::NONE.onto(&pairs, &crate::mesh::stop::never);
                let off = pairs.iter().map(|&(a, b)| found.apply(a).distance(b));
                let off = median(off.collect());
                assert!(off < close, "{turn} {scale} {wrong}: {off}");
            }
        }
    }

    #[test]
    fn what_fixes_no_similarity_is_left_alone() {
        let line = |k: u32| (DVec3::X * f64::from(k), DVec3::X * (f64::from(k) + 0.1));
        let table: [Vec<(DVec3, DVec3)>; 4] = [
            Vec::new(),
            vec![(DVec3::ONE, DVec3::ZERO); 5],
            (0..9).map(line).collect(),
            pairs(DVec3::ZERO, 1e300, DVec3::ZERO, 0),
        ];
        for pairs in table {
            let found = SmallSimilarity::NONE.onto(&pairs, &crate::mesh::stop::never);
            assert!(found.linear.is_finite() && found.shift.is_finite(), "{found:?}");
        }
    }
}
