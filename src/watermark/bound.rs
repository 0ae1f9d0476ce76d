//! The false-positive bound of a score (method section 7), and its inverse.
//!
//! It needs no model of meshes. A codeword is drawn uniformly and independently of the suspect, so
//! whatever the suspect's bins say, each of their signs agrees with a fresh codeword with
//! probability one half: `P(T >= t) <= min_{s > 0} exp(sum_i ln cosh(s w_i) - s t)` (Chernoff).
//! Must not know where weights come from.

use std::f64::consts::{LN_2, LN_10, LOG10_2, LOG10_E};

/// `(sum_i ln cosh(s w_i), sum_i w_i tanh(s w_i))`: the logarithm of the moment-generating
/// function of the score at `s`, and its slope. `ln cosh x = x - ln 2 + ln(1 + exp(-2 x))`: one
/// exponential a weight, and one logarithm for the product of up to 256 factors below 2.
fn log_moment(weights: &[f64], s: f64) -> (f64, f64) {
    let start = (0.0, 1.0, 0.0);
    let (linear, product, slope) = weights.iter().fold(start, |(linear, product, slope), w| {
        let w = w.abs();
        let e = libm::exp(-2.0 * s * w);
        (linear + w, product * (1.0 + e), slope + w * (1.0 - e) / (1.0 + e))
    });
    (s * linear - weights.len() as f64 * LN_2 + libm::log(product), slope)
}

/// Sum and number of the weights that are not zero.
fn size(weights: &[f64]) -> (f64, f64) {
    let total = weights.iter().map(|w| w.abs()).sum();
    (total, weights.iter().filter(|&&w| w != 0.0).count() as f64)
}

/// `log10 min_{s > 0} exp(sum_i ln cosh(s w_i) - s t)`: the Chernoff bound on
/// `P(sum_i +/- w_i >= t)` with fair, independent signs. Weights enter by their size; zero
/// weights are erasures. At full agreement it is `-n log10 2`, the exact probability.
///
/// Every `s` gives a valid bound, so the minimum need not be found exactly.
#[must_use]
pub fn log10_chernoff(weights: &[f64], t: f64) -> f64 {
    let (total, count) = size(weights);
    if !(t > 0.0 && total > 0.0) {
        return 0.0;
    }
    let full = -count * LOG10_2;
    // The infimum lies at s = infinity; rounding may hide that t is the whole sum.
    if t >= total * (1.0 - 1e-12) {
        return full;
    }
    let slope = |s: f64| log_moment(weights, s).1 - t;
    // The slope grows from -t at 0 to total - t > 0: double, then bisect.
    let (mut low, mut high) = (0.0, weights.len() as f64 / total);
    for _ in 0..60 {
        if slope(high) > 0.0 {
            break;
        }
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..40 {
        let middle = f64::midpoint(low, high);
        if slope(middle) > 0.0 { high = middle } else { low = middle }
    }
    let s = f64::midpoint(low, high);
    ((log_moment(weights, s).0 - s * t) * LOG10_E).clamp(full, 0.0)
}

/// A score below which [`log10_chernoff`] is certainly above `log10_bound`: no record that scores
/// less can be reported. `None` when no score reaches that bound; 0 when any may.
///
/// The bound at the score `t(s) = sum_i w_i tanh(s w_i)` is `sum_i ln cosh(s w_i) - s t(s)`, which
/// falls as `s` grows: bisection on `s`, ended on the side of the smaller score.
#[must_use]
pub fn least_score(weights: &[f64], log10_bound: f64) -> Option<f64> {
    let (total, count) = size(weights);
    if log10_bound >= 0.0 {
        return Some(0.0);
    }
    // A little slack for the rounding of either side.
    let wanted = log10_bound * LN_10 * (1.0 - 1e-9);
    if total <= 0.0 || -count * LN_2 > wanted {
        return None;
    }
    let mean = total / weights.len() as f64;
    let reached = |s: f64| {
        let (value, t) = log_moment(weights, s);
        (value - s * t <= wanted, t)
    };
    let (mut low, mut high) = (0.0, 1.0 / mean);
    for _ in 0..8 {
        if reached(high).0 {
            break;
        }
        (low, high) = (high, 2.0 * high);
    }
    // What is left of the interval costs a few exact looks, more halvings cost more.
    for _ in 0..5 {
        let middle = f64::midpoint(low, high);
        if reached(middle).0 { high = middle } else { low = middle }
    }
    Some(reached(low).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uneven(n: u32) -> Vec<f64> {
        (0..n).map(|i| 0.2 + f64::from(i * 7 % 5)).collect()
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "no evidence is exactly zero")]
    fn full_agreement_is_two_to_the_minus_m_and_no_agreement_is_no_evidence() {
        for (n, weight) in [(64, 1.0), (16, 0.003), (256, 7.0)] {
            let weights = vec![weight; n];
            let full = log10_chernoff(&weights, weight * n as f64);
            assert!((full + n as f64 * LOG10_2).abs() < 1e-9);
            assert_eq!(log10_chernoff(&weights, 0.0), 0.0);
            assert_eq!(log10_chernoff(&weights, -3.0), 0.0);
        }
        assert_eq!(log10_chernoff(&[], 1.0), 0.0);
        assert_eq!(log10_chernoff(&[0.0; 4], 1.0), 0.0);
        assert_eq!(least_score(&[0.0; 4], -1.0), None);
    }

    #[test]
    fn the_bound_is_above_the_exact_tail_and_below_hoeffding() {
        // All 2^14 sign patterns of uneven weights.
        let weights = uneven(14);
        let total: f64 = weights.iter().sum();
        let energy: f64 = weights.iter().map(|w| w * w).sum();
        for share in [0.1, 0.3, 0.5, 0.8, 0.95, 1.0] {
            let t = share * total;
            let sums = (0..1_u32 << 14).map(|signs| -> f64 {
                weights
                    .iter()
                    .enumerate()
                    .map(|(i, w)| if signs >> i & 1 == 1 { *w } else { -w })
                    .sum()
            });
            let tail = sums.filter(|&s| s >= t - 1e-9).count() as f64 / f64::from(1 << 14);
            let bound = log10_chernoff(&weights, t);
            assert!(bound >= tail.log10() - 1e-9, "{share}: {bound} < {}", tail.log10());
            assert!(bound <= -t * t / (2.0 * energy) * LOG10_E + 1e-9, "{share}");
        }
    }

    #[test]
    fn the_least_score_misses_nothing_and_little_more() {
        for weights in [uneven(64), vec![0.4; 64], uneven(200), [uneven(30), vec![0.0; 9]].concat()]
        {
            let total: f64 = weights.iter().sum();
            for wanted in [-0.5, -3.0, -7.0, -8.9] {
                let least = least_score(&weights, wanted).unwrap();
                assert!(log10_chernoff(&weights, least) >= wanted, "{wanted}");
                assert!(log10_chernoff(&weights, least + 0.05 * total) < wanted, "{wanted}");
            }
        }
        assert_eq!(least_score(&[1.0; 16], -5.0), None, "16 bits say 4.8 decades");
    }
}
