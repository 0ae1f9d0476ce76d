//! Chernoff's bound on the same tail: `P(D <= d) <= E exp(l (d - D))` for every `l > 0`, with `D` the
//! sum of the weights that disagree. It is smooth, and above the count by 0.8 to 1.1 decades away from
//! the ends (`cargo bench --bench bound`).

use std::f64::consts::{LN_2, LOG10_E};

use super::Tail;

/// Most Newton steps. Each adds at least about `1 / w` to `l`. After 40 such steps a weight's share of
/// the slope is lost in rounding.
const MOST_STEPS: usize = 100;

/// The remaining slope, as a share of the weights' sum, at which `l` is good enough. Every `l` gives a
/// bound.
const FLAT: f64 = 1e-13;

/// Size beyond which a product of factors between 1 and 2 is turned into a logarithm (2^512), before it
/// overflows.
const LARGE: f64 = 1.340_780_792_994_259_7e154;

/// `min over l > 0 of l d + sum ln((1 + exp(-l w)) / 2)`, for positive weights and `d > 0`.
///
/// The slope `d - sum w / (exp(l w) + 1)` grows with `l`, ever more slowly, so Newton's steps from zero
/// never pass its root.
pub(super) fn natural(weights: &[f64], d: f64) -> f64 {
    let total: f64 = weights.iter().sum();
    let (mut l, mut best) = (0.0, 0.0_f64);
    for _ in 0..MOST_STEPS {
        let (mut product, mut logarithms, mut slope, mut curvature) = (1.0, 0.0, d, 0.0);
        for &w in weights {
            let e = libm::exp(-l * w);
            let share = w * e / (1.0 + e);
            product *= 1.0 + e;
            if product > LARGE {
                logarithms += libm::log(product);
                product = 1.0;
            }
            slope -= share;
            curvature += share * w / (1.0 + e);
        }
        let sum = logarithms + libm::log(product);
        best = best.min(l * d + sum - weights.len() as f64 * LN_2);
        let next = l - slope / curvature;
        if slope >= -FLAT * total || !next.is_finite() {
            break;
        }
        l = next;
    }
    best
}

/// log10 of Chernoff's bound on `P(sum_i +/- w_i >= t)` with fair, independent signs; 0 where `t` is
/// not above zero.
#[must_use]
pub fn log10_chernoff(weights: &[f64], t: f64) -> f64 {
    let tail = Tail::new(weights);
    tail.d(t).map_or(0.0, |d| natural(&tail.weights, d) * LOG10_E)
}

/// The least score whose Chernoff bound is at most `log10_bound`, to within a part in a million on the
/// safe side: every score whose bound is lower is above it. `None` when there is no such score.
///
/// For scores of many weights, few of which are computed exactly.
#[must_use]
pub fn least_chernoff_score(weights: &[f64], log10_bound: f64) -> Option<f64> {
    let total: f64 = weights.iter().map(|w| w.abs()).sum();
    if log10_bound >= 0.0 || !total.is_finite() {
        return Some(0.0);
    }
    // The bound falls as the score grows.
    let (mut low, mut high) = (0.0, total);
    if log10_chernoff(weights, high) > log10_bound {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if log10_chernoff(weights, middle) > log10_bound { low = middle } else { high = middle }
    }
    Some(low)
}

/// Halvings of the interval of scores, which give a part in a million.
const HALVINGS: usize = 20;
