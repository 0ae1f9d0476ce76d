//! Least-distortion allocation: which vertices of a bin move, and how far, to bring the bin's statistic
//! to a target at the least total cost (method section 3, beyond the paper).
//!
//! Moving a vertex by `delta` costs about `delta^2 / g`, with `g` its compliance. Minimising the sum of
//! costs for a given statistic leaves one multiplier per bin:
//!
//! - mean: `delta = mu g`;
//! - variance, with `u = 2t - 1`: stationarity of `sum delta^2 / g - (kappa / 4) sum u'^2` gives
//!   `u' = u / (1 - kappa g)`.
//!
//! Each place is clipped to its own range. Both statistics grow monotonically with their multiplier, so
//! a bracketed secant finds the one scalar root per bin.

use crate::mesh::powers::squared;
use crate::mesh::stop::Stop;
use crate::watermark::Modulation;
use crate::watermark::bins::contribution;

/// The limits of the move of one vertex of a bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveLimits {
    /// Compliance, above zero, in any unit that the whole bin shares.
    pub compliance: f64,
    /// Least and greatest place it may take; the present place lies between them.
    pub range: (f64, f64),
}

/// Share of the bin's width that stays free at both edges. With less, a centre shift of 0.3 % of a bin
/// tips vertices over the edge (method section 3). A vertex that is already nearer to an edge may stay.
const EDGE: f64 = 0.08;

/// Share of the way to that edge that a vertex may go. With all of the way, vertices from all over the
/// bin would end on one sphere. With this share, vertices keep their order, and the triangles between
/// them keep their side.
const RANGE_SHARE: f64 = 0.9;

impl MoveLimits {
    /// A vertex at place `t`.
    #[must_use]
    pub fn new(compliance: f64, t: f64) -> Self {
        let (below, above) =
            (RANGE_SHARE * (t - EDGE).max(0.0), RANGE_SHARE * (1.0 - EDGE - t).max(0.0));
        Self { compliance: compliance.max(f64::MIN_POSITIVE), range: (t - below, t + above) }
    }
}

/// How close the statistic must come to its target.
const TOLERANCE: f64 = 1e-7;

/// Largest number of secant steps.
const MAX_STEPS: usize = 100;

/// The movable vertices of one bin: their places `t` and the limits of their moves.
#[derive(Debug, Clone, Copy)]
pub struct Allocation<'a> {
    /// Which statistic is moved.
    pub modulation: Modulation,
    /// Places before anything moves.
    pub places: &'a [f64],
    /// One entry per place.
    pub move_limits: &'a [MoveLimits],
}

/// A multiplier, and whether the statistic reaches its target there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// `mu` or `kappa`.
    pub multiplier: f64,
    /// False when every vertex is at the end of its range and the target is not reached.
    pub reached: bool,
}

impl Allocation<'_> {
    /// The multiplier at which the bin's statistic reaches `target`, or the one at which the statistic
    /// comes as near as the ranges allow.
    ///
    /// Calls `stop` before each pass over the vertices. The result must be discarded once `stop`
    /// answers `true`.
    #[must_use]
    pub fn solve(&self, target: f64, stop: Stop<'_>) -> Solution {
        // NaN ends the search.
        let statistic = |m| if stop() { f64::NAN } else { self.statistic(m) };
        let (multiplier, reached) = solve(statistic, target, self.guess(target));
        Solution { multiplier, reached }
    }

    /// The bin's statistic at a multiplier.
    #[must_use]
    pub fn statistic(&self, multiplier: f64) -> f64 {
        let all = self.places.iter().zip(self.move_limits);
        let sum: f64 = all
            .map(|(&t, freedom)| contribution(self.modulation, self.moved(multiplier, t, freedom)))
            .sum();
        sum / self.places.len().max(1) as f64
    }

    /// The places at a multiplier.
    pub fn apply(&self, multiplier: f64, places: &mut [f64]) {
        for ((to, &t), freedom) in places.iter_mut().zip(self.places).zip(self.move_limits) {
            *to = self.moved(multiplier, t, freedom);
        }
    }

    /// The price: the derivative of the least total cost by the bin's statistic at a multiplier. By the
    /// envelope theorem it is the multiplier itself, up to a factor that follows from the definitions
    /// above.
    #[must_use]
    pub fn price(&self, multiplier: f64) -> f64 {
        self.factor() * multiplier.abs()
    }

    /// The multiplier at a price, for a statistic that moves up or down.
    #[must_use]
    pub fn at_price(&self, price: f64, upward: bool) -> f64 {
        let multiplier = price / self.factor();
        if upward { multiplier } else { -multiplier }
    }

    /// The size of the multiplier that would suffice if no vertex met its limit: the slope of the
    /// statistic at rest is taken as constant.
    fn guess(&self, target: f64) -> f64 {
        let slope: f64 = match self.modulation {
            Modulation::Mean => self.move_limits.iter().map(|f| f.compliance).sum(),
            Modulation::Variance => {
                let all = self.places.iter().zip(self.move_limits);
                all.map(|(t, f)| 2.0 * squared(2.0 * t - 1.0) * f.compliance).sum()
            }
        };
        let count = self.places.len() as f64;
        let guess = (target - self.statistic(0.0)).abs() * count / slope;
        if guess.is_finite() && guess > 0.0 { guess } else { 1.0 }
    }

    fn factor(&self) -> f64 {
        let count = self.places.len().max(1) as f64;
        match self.modulation {
            Modulation::Mean => 2.0 * count,
            Modulation::Variance => 0.25 * count,
        }
    }

    fn moved(&self, multiplier: f64, t: f64, freedom: &MoveLimits) -> f64 {
        match self.modulation {
            Modulation::Mean => shifted(multiplier, t, freedom),
            Modulation::Variance => scaled(multiplier, t, freedom),
        }
    }
}

fn shifted(mu: f64, t: f64, freedom: &MoveLimits) -> f64 {
    let (low, high) = freedom.range;
    (t + mu * freedom.compliance).clamp(low, high)
}

fn scaled(kappa: f64, t: f64, freedom: &MoveLimits) -> f64 {
    let (low, high) = freedom.range;
    let u = 2.0 * t - 1.0;
    let left = 1.0 - kappa * freedom.compliance;
    // At and beyond the pole the vertex goes as far outward as it may.
    let wanted = if left > 0.0 { u / left } else { f64::INFINITY.copysign(u) };
    f64::midpoint(wanted, 1.0).clamp(low, high)
}

/// The multiplier at which a growing function reaches `target`: brackets by doubling from
/// `guess`, then the Illinois variant of regula falsi.
fn solve(statistic: impl Fn(f64) -> f64, target: f64, guess: f64) -> (f64, bool) {
    let error = |x: f64| statistic(x) - target;
    let at_rest = error(0.0);
    if at_rest.is_nan() || at_rest.abs() <= TOLERANCE {
        return (0.0, true);
    }
    let sign = -at_rest.signum();
    let (mut near, mut near_error) = (0.0, at_rest);
    let (mut far, mut far_error) = (0.0, at_rest);
    // Compliances differ by a factor of at most about 1 / lambda. Long before 2^40 times the guess,
    // every vertex is at its limit.
    for doubling in 0..40 {
        far = sign * guess * libm::exp2(f64::from(doubling));
        far_error = error(far);
        if far_error.is_nan() || far_error * sign >= 0.0 {
            break;
        }
        (near, near_error) = (far, far_error);
    }
    if far_error * sign < -TOLERANCE {
        return (far, false);
    }
    for _ in 0..MAX_STEPS {
        let x = (near * far_error - far * near_error) / (far_error - near_error);
        // Where the statistic jumps (at the variance's pole), halving still converges.
        let x = if x.is_finite() { x } else { f64::midpoint(near, far) };
        let found = error(x);
        if found.is_nan() || found.abs() <= TOLERANCE || (far - near).abs() <= 1e-14 * far.abs() {
            return (x, true);
        }
        if found * sign > 0.0 {
            (far, far_error) = (x, found);
            near_error *= 0.5;
        } else {
            (near, near_error) = (x, found);
            far_error *= 0.5;
        }
    }
    (f64::midpoint(near, far), true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::stop::never;

    fn bin(n: u32) -> (Vec<f64>, Vec<MoveLimits>) {
        let unit = |i: u32, step: f64| (f64::from(i) * step).fract();
        let places: Vec<f64> = (0..n).map(|i| unit(i, 0.754_877_666)).collect();
        let move_limits = (0..n)
            .zip(&places)
            .map(|(i, &t)| MoveLimits::new(0.01 + 100.0 * unit(i, 0.324_717_957).powi(4), t));
        let move_limits = move_limits.collect();
        (places, move_limits)
    }

    fn statistic(modulation: Modulation, places: &[f64]) -> f64 {
        places.iter().map(|&t| contribution(modulation, t)).sum::<f64>() / places.len() as f64
    }

    /// Solves and applies.
    fn allocate(
        modulation: Modulation,
        places: &mut [f64],
        move_limits: &[MoveLimits],
        target: f64,
    ) -> bool {
        let before = places.to_vec();
        let problem = Allocation { modulation, places: &before, move_limits };
        let solution = problem.solve(target, &never);
        problem.apply(solution.multiplier, places);
        solution.reached
    }

    #[test]
    fn the_price_is_the_derivative_of_the_cost() {
        for modulation in [Modulation::Mean, Modulation::Variance] {
            let (before, move_limits) = bin(300);
            let problem = Allocation { modulation, places: &before, move_limits: &move_limits };
            let cost = |multiplier: f64| -> f64 {
                let mut after = before.clone();
                problem.apply(multiplier, &mut after);
                let all = after.iter().zip(&before).zip(&move_limits);
                all.map(|((a, b), f)| (a - b) * (a - b) / f.compliance).sum()
            };
            let target = modulation.neutral() + 0.04;
            let [low, high] =
                [target - 1e-5, target + 1e-5].map(|t| problem.solve(t, &never).multiplier);
            let slope = (cost(high) - cost(low)) / 2e-5;
            let price = problem.price(problem.solve(target, &never).multiplier);
            assert!((slope / price - 1.0).abs() < 0.02, "{modulation}: {slope} {price}");
            let back = problem.at_price(price, true);
            assert!((problem.statistic(back) - target).abs() < 1e-6);
        }
    }

    #[test]
    fn the_target_is_reached_within_every_range() {
        for modulation in [Modulation::Mean, Modulation::Variance] {
            for shift in [-0.1, -0.02, 0.02, 0.1] {
                let (mut places, move_limits) = bin(400);
                let target = modulation.neutral() + shift;
                assert!(allocate(modulation, &mut places, &move_limits, target));
                assert!((statistic(modulation, &places) - target).abs() < 1e-7);
                for (t, freedom) in places.iter().zip(&move_limits) {
                    assert!((freedom.range.0..=freedom.range.1).contains(t));
                }
            }
        }
    }

    #[test]
    fn out_of_reach_every_vertex_goes_to_its_limit() {
        for modulation in [Modulation::Mean, Modulation::Variance] {
            let (mut places, move_limits) = bin(50);
            assert!(!allocate(modulation, &mut places, &move_limits, 0.999));
            let at_limit = places
                .iter()
                .zip(&move_limits)
                .filter(|(t, f)| (*t - f.range.0).abs() < 1e-6 || (*t - f.range.1).abs() < 1e-6);
            assert!(at_limit.count() >= 49); // u = 0 has no side to go to
        }
    }

    #[test]
    fn no_other_way_to_the_same_mean_is_cheaper() {
        let (before, move_limits) = bin(200);
        let mut places = before.clone();
        allocate(Modulation::Mean, &mut places, &move_limits, 0.58);
        let cost = |after: &[f64]| -> f64 {
            let all = after.iter().zip(&before).zip(&move_limits);
            all.map(|((a, b), f)| (a - b) * (a - b) / f.compliance).sum()
        };
        let best = cost(&places);
        // Shift a little weight between any two vertices that have room.
        for i in 0..200 {
            let j = (i * 37 + 11) % 200;
            for step in [1e-4, -1e-4] {
                let mut other = places.clone();
                other[i] += step;
                other[j] -= step;
                let inside = |k: usize| {
                    (move_limits[k].range.0..=move_limits[k].range.1).contains(&other[k])
                };
                if i != j && inside(i) && inside(j) {
                    assert!(cost(&other) >= best - 1e-9);
                }
            }
        }
    }
}
