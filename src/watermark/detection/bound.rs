//! The false-positive bound of a score (method sections 7 and 9): the tail of a sum of weights with
//! fair signs. The bound needs no model of meshes, because a codeword is drawn uniformly and
//! independently of the suspect. Whatever the suspect's bins read, each of their signs agrees with a
//! fresh codeword with probability one half. Must not know where weights come from.
//!
//! **The tail is a count.** Let `w_i > 0` be the sizes of the `n` nonzero weights and `W` their sum. A
//! score is `W - 2 D`, where `D` is the sum of the weights whose signs disagree. So
//! `P(score >= t) = P(D <= d)` with `d = (W - t) / 2`: the number of subsets of the weights whose sum
//! is at most `d`, divided by `2^n`.
//!
//! **Never below the tail.** For a grid `g > 0` let `k_i = floor(w_i / g)` and `K = floor(d / g)`. A
//! subset whose weights sum to at most `d` has `sum k_i <= sum w_i / g <= d / g`. The sum of the `k_i`
//! is whole, so it is at most `K`. So at least as many subsets of the `k_i` have a sum of at most `K`,
//! and these are counted, weight by weight. A weight below `g` has `k_i = 0`. Both of its signs are
//! counted, so its agreement is no evidence.
//!
//! **Monotone.** Grids are halved repeatedly. The grid for `d` is the coarsest that divides `d` into
//! more than [`STEPS`] `/ 2` steps per weight. With `g / 2` in place of `g`, `k_i` at least doubles, so
//! that `sum k_i' <= floor(2 d / g)` entails `sum k_i <= floor(d / g)`: a finer grid counts no more. On
//! one grid the count grows with `d`.
//!
//! **Never above Chernoff's bound.** The smaller of the two is taken, at the same `d`.
//!
//! **Rounding of floating point.** `W` is a rounded sum of the weights, and `t` may be one. In
//! whichever order `n` numbers are added, the sum is off by at most `(n - 1) u` of `W` with `u = 2^-53`
//! (to first order). So `d` is off by at most `(n + 1) u W`, also where `t` is compared with a rounded
//! score; [`Tail::d`] adds twice that. All weights are first multiplied by the power of two that brings
//! the largest to [1/2, 1), which is exact. A weight below 2^-200 then counts as zero, which is
//! rounding down. The largest weight, rounded down to 24 bits, is a whole number of grid steps.
//! Products of a step with whole numbers below 2^29 are therefore exact, and such products settle every
//! floor. Counts are sums of at most `n + STEPS n` rounded additions of nonnegative numbers, and so off
//! by less than 1e-11 of themselves; logarithms are off by less than that. [`MARGIN`] is added to every
//! result. No count can underflow. Above 2^1023, with more than a thousand weights, a count is
//! infinite, and Chernoff's bound is left. Of more than [`MOST_COUNTED`] weights nothing is counted.

mod chernoff;

use std::collections::BTreeMap;
use std::f64::consts::{LN_10, LOG10_2, LOG10_E};

pub use chernoff::{least_chernoff_score, log10_chernoff};

/// Most grid steps in `d`, per weight. A subset of `m` weights is counted as up to `m` steps smaller
/// than it is. This costs at most 0.03 decades for 64 capped random weights and 0.1 for 256
/// (`cargo bench --bench bound`). Twice the steps cost twice the time and save half of that.
const STEPS: usize = 48;

/// More weights than this are left to Chernoff's bound: the time of counting grows with their square,
/// and counts overflow soon after.
const MOST_COUNTED: usize = 1024;

/// What rounding may take from a logarithm: more than all errors named in the module's documentation.
const MARGIN: f64 = 1e-11;

/// Weights smaller than this share of the largest count as zero.
const NOTHING: f64 = 6.223_015_277_861_142e-61; // 2^-200

/// Steps in the largest weight when scores are sieved.
const SIEVE_STEPS: f64 = 16.0;

/// The bound as a function of the score, for several scores of the same weights. What is counted for
/// one score serves all scores on the same grid.
#[derive(Debug, Clone)]
pub struct Tail {
    /// Ascending, none zero, the largest in [1/2, 1).
    weights: Vec<f64>,
    /// Binary exponent of the power of two by which scores are multiplied.
    exponent: i32,
    total: f64,
    /// By number of halvings and then of steps: the number of subsets whose sum is at most that many
    /// steps.
    counts: BTreeMap<i32, Vec<f64>>,
}

impl Tail {
    /// Weights enter by their size; zeros are erasures. A weight that is not a finite number makes all
    /// bounds 1.
    #[must_use]
    pub fn new(weights: &[f64]) -> Self {
        let largest = weights.iter().map(|w| w.abs()).fold(0.0, f64::max);
        let exponent = -libm::frexp(largest).1;
        let sizes = weights.iter().map(|&w| libm::scalbn(w.abs(), exponent));
        let mut weights: Vec<f64> = sizes.filter(|&w| w.is_nan() || w >= NOTHING).collect();
        weights.sort_unstable_by(f64::total_cmp);
        let total = weights.iter().sum();
        Self { weights, exponent, total, counts: BTreeMap::new() }
    }

    /// An upper bound on `(W - t) / 2`; `None` where the bound of the probability is 1.
    fn d(&self, t: f64) -> Option<f64> {
        let t = libm::scalbn(t, self.exponent);
        let slack = (self.weights.len() as f64 + 2.0) * f64::EPSILON * self.total;
        let sound = t > 0.0 && self.total.is_finite() && self.total > 0.0;
        sound.then(|| (0.5 * (self.total - t)).max(0.0) + slack)
    }

    /// log10 of a bound on the probability that fair, independent signs make these weights sum to
    /// `t` or more; 0 where `t` is not above zero.
    pub fn log10_at(&mut self, t: f64) -> f64 {
        let Some(d) = self.d(t) else { return 0.0 };
        let chernoff = chernoff::natural(&self.weights, d) * LOG10_E;
        let n = self.weights.len();
        if n > MOST_COUNTED {
            return (chernoff + MARGIN).min(0.0);
        }
        let limit = STEPS * n;
        let unit = unit(&self.weights);
        let mut halvings = libm::frexp(limit as f64 * unit / d).1;
        while d / step(unit, halvings) >= (limit + 1) as f64 {
            halvings -= 1;
        }
        let step = step(unit, halvings);
        let weights = &self.weights;
        let counts = self.counts.entry(halvings).or_insert_with(|| {
            let steps = |&w: &f64| floor(w, step, limit + 1);
            sums(&weights.iter().map(steps).collect::<Vec<usize>>(), limit)
        });
        let count = counts.get(floor(d, step, limit)).copied().unwrap_or(f64::INFINITY);
        let counted = libm::log10(count) - n as f64 * LOG10_2;
        (counted.min(chernoff) + MARGIN).min(0.0)
    }
}

/// log10 of a bound on `P(sum_i +/- w_i >= t)` with fair, independent signs: see [`Tail`].
#[must_use]
pub fn log10_tail(weights: &[f64], t: f64) -> f64 {
    Tail::new(weights).log10_at(t)
}

/// The largest of ascending weights, rounded down to 24 bits.
fn unit(weights: &[f64]) -> f64 {
    const BITS: f64 = 16_777_216.0;
    (weights.last().copied().unwrap_or(0.0) * BITS).floor() / BITS
}

fn step(unit: f64, halvings: i32) -> f64 {
    libm::scalbn(unit, -halvings)
}

/// `floor(x / step)`, at most `most`; exact where `step` has 24 bits and `most` is below 2^29.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to most")]
fn floor(x: f64, step: f64, most: usize) -> usize {
    let whole = (x / step).min(most as f64) as usize;
    if whole as f64 * step > x {
        whole - 1
    } else if whole < most && (whole + 1) as f64 * step <= x {
        whole + 1
    } else {
        whole
    }
}

/// How many subsets of `steps` have a sum of at most 0, 1, ... `limit`. Ascending steps cost least.
fn sums(steps: &[usize], limit: usize) -> Vec<f64> {
    let mut counts = vec![0.0; limit + 1];
    let mut next = counts.clone();
    counts[0] = 1.0;
    // The largest sum of the weights counted so far.
    let mut reach = 0;
    for &k in steps.iter().filter(|&&k| k <= limit) {
        let (old, most) = (reach, (reach + k).min(limit));
        next[..=most].copy_from_slice(&counts[..=most]);
        let shifted = &counts[..=old.min(most - k)];
        for (next, count) in next[k..].iter_mut().zip(shifted) {
            *next += count;
        }
        std::mem::swap(&mut counts, &mut next);
        reach = most;
    }
    let mut sum = 0.0;
    for count in &mut counts {
        sum += *count;
        *count = sum;
    }
    counts
}

/// A score below which every bound is above `log10_bound`, for every bound that is never below the true
/// tail, such as [`log10_tail`]. No record with a lower score can be reported. `None` when no score
/// reaches `log10_bound`; 0 when any score may.
///
/// Weights are rounded *up* to whole steps here. A subset whose rounded sum is at most `K` steps has a
/// true sum of at most `K` steps, so no fewer subsets of the weights than of the rounded weights are
/// within `K` steps. `K` is the largest for which the count of the rounded weights is no more than
/// `log10_bound` allows. A reported record has `d` below `K + 1` steps. Few steps suffice, because a
/// record that passes is scored exactly.
#[must_use]
pub fn least_score(weights: &[f64], log10_bound: f64) -> Option<f64> {
    let Tail { weights, exponent, total, .. } = Tail::new(weights);
    let n = weights.len() as f64;
    // Includes slack for the errors that [`MARGIN`] covers.
    let allowed = log10_bound + n * LOG10_2 + 10.0 * MARGIN;
    if log10_bound >= 0.0 || !total.is_finite() {
        return Some(0.0);
    }
    if allowed < 0.0 || total <= 0.0 {
        return None;
    }
    let allowed = libm::exp(allowed * LN_10);
    // Rounded up to 24 bits, so that the largest weight is a whole number of steps.
    let step = (unit(&weights) + f64::EPSILON * 268_435_456.0) / SIEVE_STEPS;
    let limit = floor(0.5 * total, step, 1 << 20);
    let up = |&w: &f64| floor(w, step, 1 << 20) + 1 - usize::from(is_whole(w, step));
    let counts = sums(&weights.iter().map(up).collect::<Vec<usize>>(), limit);
    let above = counts.partition_point(|&count| count <= allowed);
    let least = total - 2.0 * step * above as f64;
    let slack = 4.0 * (n + 2.0) * f64::EPSILON * total;
    Some(libm::scalbn((least - slack).max(0.0), -exponent))
}

fn is_whole(w: f64, step: f64) -> bool {
    floor(w, step, 1 << 20) as f64 * step >= w
}

#[cfg(test)]
mod tests;
