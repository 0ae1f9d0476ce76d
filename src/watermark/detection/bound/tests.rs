use proptest::prelude::*;

use super::*;

/// What rounding to the safe side may cost.
const TIGHT: f64 = 1e-9;

fn uneven(n: u32) -> Vec<f64> {
    (0..n).map(|i| 0.2 + f64::from(i * 7 % 5)).collect()
}

/// The `k`-th number of a sequence in [0, 1).
fn spread(k: u32) -> f64 {
    (f64::from(k + 1) * 0.618_033_988_749_894_9).fract()
}

/// log10 of the share of sign patterns that score `t` or more, by enumeration. Scores are exact where
/// weights are whole numbers.
fn enumerated(weights: &[f64], t: f64) -> f64 {
    let patterns = 1_u32 << weights.len();
    let score = |signs: u32| -> f64 {
        let signed = weights.iter().enumerate();
        signed.map(|(i, w)| if signs >> i & 1 == 1 { *w } else { -w }).sum()
    };
    let reached = (0..patterns).filter(|&signs| score(signs) >= t).count();
    (reached as f64 / f64::from(patterns)).log10()
}

/// The bound is not below the true tail and not above Chernoff's bound.
fn assert_between(weights: &[f64], t: f64) {
    let (bound, truth) = (log10_tail(weights, t), enumerated(weights, t));
    assert!(bound >= truth, "{weights:?} {t}: {bound} < {truth}");
    let chernoff = log10_chernoff(weights, t);
    assert!(bound <= (chernoff + TIGHT).min(0.0), "{weights:?} {t}: {bound} > {chernoff}");
}

#[test]
#[expect(clippy::float_cmp, reason = "no evidence is exactly zero")]
fn full_agreement_is_two_to_the_minus_m_and_no_agreement_is_no_evidence() {
    for (n, weight) in [(64, 1.0), (16, 0.003), (256, 7.0), (64, 1e-300), (64, 1e300)] {
        let weights = vec![weight; n];
        let full = log10_tail(&weights, weight * n as f64);
        assert!((full + n as f64 * LOG10_2).abs() < TIGHT, "{n} {weight}: {full}");
        assert_eq!(log10_tail(&weights, 0.0), 0.0);
        assert_eq!(log10_tail(&weights, -3.0), 0.0);
    }
    assert_eq!(log10_tail(&[], 1.0), 0.0);
    assert_eq!(log10_tail(&[0.0; 4], 1.0), 0.0);
    assert_eq!(least_score(&[0.0; 4], -1.0), None);
}

#[test]
#[expect(clippy::float_cmp, reason = "no evidence is exactly zero")]
fn what_is_no_number_is_no_evidence() {
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(log10_tail(&[odd; 64], 1.0), 0.0, "{odd}");
        assert_eq!(log10_tail(&[1.0; 64], odd.abs() * f64::NAN), 0.0);
        assert_eq!(log10_chernoff(&[odd; 64], 1.0), 0.0, "{odd}");
    }
    // Too many weights to count: Chernoff's bound is left.
    let (bound, chernoff) =
        (log10_tail(&[1.0; 2000], 1000.0), log10_chernoff(&[1.0; 2000], 1000.0));
    assert!(bound < -100.0 && (bound - chernoff).abs() < TIGHT, "{bound} {chernoff}");
}

/// The counter-example of method section 9: half of the weights carry no information, and half of the
/// bits disagree.
#[test]
fn weights_that_could_have_disagreed_are_no_evidence() {
    for tiny in [1e-13, 1e-16, 1e-30, 1e-200, 1e-310, 0.0] {
        let weights: Vec<f64> = (0..64).map(|i| if i % 2 == 0 { 1.0 } else { tiny }).collect();
        let (mut binomial, mut sum) = (1.0, 0.0);
        for wrong in 0..=32_u32 {
            sum += binomial;
            binomial *= f64::from(32 - wrong) / f64::from(wrong + 1);
            let t = 32.0 + (32.0 - 2.0 * f64::from(wrong)) * tiny;
            let bound = log10_tail(&weights, t);
            let truth = libm::log10(sum) - 64.0 * LOG10_2;
            assert!(bound >= truth, "{tiny} {wrong}: {bound} {truth}");
            // Sums of 64 numbers are rounded by more than these weights contribute.
            let least = if tiny > 1e-15 { -64.0 } else { -32.0 };
            assert!(bound >= least * LOG10_2 - TIGHT, "{tiny} {wrong}: {bound}");
        }
    }
}

#[test]
fn small_numbers_of_weights_are_as_enumerated() {
    let mut cases: Vec<Vec<f64>> = vec![
        uneven(14),
        vec![1.0; 12],
        vec![3.0],
        (0..12).map(|k| 2_f64.powi(k)).collect(),
        (0..12).map(|k| 3_f64.powi(-2 * k)).collect(),
        (0..13).map(|k| if k < 2 { 1.0 } else { 0.01 }).collect(),
        (0..13).map(|k| if k < 9 { 1.0 } else { 1e-7 * f64::from(k) }).collect(),
        (0..12).map(|k| (0.1 + spread(k)).min(0.6)).collect(),
        vec![1.0, 1.0, 1.0, 1e-20, 1e-25, 0.0, 5e-324],
    ];
    cases.push(cases[0].iter().map(|w| w * 1e-290).collect());
    for weights in cases {
        let total: f64 = weights.iter().sum();
        for share in [1e-9, 0.05, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999, 1.0] {
            assert_between(&weights, share * total);
        }
        // The scores of sign patterns, where the count must include the pattern itself.
        for signs in 0..64_u32 {
            let sign = |i: usize| if signs >> (i % 6) & 1 == 1 { 1.0 } else { -1.0 };
            let t: f64 = weights.iter().enumerate().map(|(i, w)| sign(i) * w).sum();
            assert_between(&weights, t);
            // The same sum in reverse order.
            let t: f64 = weights.iter().enumerate().rev().map(|(i, w)| sign(i) * w).sum();
            assert_between(&weights, t);
        }
    }
}

/// Whole weights of few steps: nothing is rounded, and the count is the true tail.
#[test]
fn equal_weights_are_as_the_binomial_distribution_has_it() {
    for n in [24_u32, 64, 256] {
        let weights = vec![1.0; n as usize];
        let (mut binomial, mut sum) = (1.0, 0.0);
        for wrong in 0..n / 2 {
            sum += binomial;
            let truth = libm::log10(sum) - f64::from(n) * LOG10_2;
            let bound = log10_tail(&weights, f64::from(n - 2 * wrong));
            assert!(bound >= truth && bound <= truth + TIGHT, "{n} {wrong}: {bound} {truth}");
            let chernoff = log10_chernoff(&weights, f64::from(n - 2 * wrong));
            assert!(bound <= chernoff + TIGHT, "{n} {wrong}");
            binomial *= f64::from(n - wrong) / f64::from(wrong + 1);
        }
    }
}

#[test]
fn the_bound_falls_as_the_score_grows() {
    let capped: Vec<f64> = (0..64).map(|k| spread(k).min(0.5)).collect();
    let steep: Vec<f64> = (0..40).map(|k| 1.7_f64.powi(-k)).collect();
    for weights in [uneven(64), capped, steep, vec![0.3; 256]] {
        let total: f64 = weights.iter().sum();
        let mut tail = Tail::new(&weights);
        let mut before = 0.0;
        for k in 0..=2000 {
            let t = total * f64::from(k) / 2000.0;
            let bound = tail.log10_at(t);
            assert!(bound <= before + MARGIN, "{k}: {bound} after {before}");
            assert!((bound - log10_tail(&weights, t)).abs() < MARGIN, "{k}: it remembers");
            before = bound;
        }
        // Also where grids change: from full agreement outwards.
        let mut before = tail.log10_at(total);
        for k in 0..4000 {
            let bound = tail.log10_at(total * (1.0 - 1e-15 * 1.009_f64.powi(k)));
            assert!(bound + MARGIN >= before, "{k}: {bound} after {before}");
            before = bound;
        }
    }
}

#[test]
fn the_least_score_misses_nothing_and_little_more() {
    for weights in [uneven(64), vec![0.4; 64], uneven(200), [uneven(30), vec![0.0; 9]].concat()] {
        let total: f64 = weights.iter().sum();
        for wanted in [-0.5, -3.0, -7.0, -8.9] {
            let least = least_score(&weights, wanted).unwrap();
            // Just below the least score, not at it.
            assert!(log10_tail(&weights, least * (1.0 - 1e-12)) > wanted, "{wanted}");
            assert!(log10_tail(&weights, least + 0.08 * total) < wanted, "{wanted}: {least}");
        }
    }
    assert_eq!(least_score(&[1.0; 16], -5.0), None, "16 bits say 4.8 decades");
    assert!(least_score(&[1.0; 16], -16.0 * LOG10_2).is_some_and(|least| least > 13.9));
}

/// Weights of widely different sizes.
fn weights(most: usize) -> impl Strategy<Value = Vec<f64>> {
    let weight = prop_oneof![
        3 => 0.0..1.0_f64,
        2 => Just(0.5),
        2 => (-40.0..0.0_f64).prop_map(|e| 10_f64.powf(e)),
        1 => Just(0.0),
    ];
    (proptest::collection::vec(weight, 1..=most), -250.0..250.0_f64)
        .prop_map(|(weights, e)| weights.into_iter().map(|w| w * 10_f64.powf(e)).collect())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn it_is_never_below_the_truth_nor_above_chernoff(weights in weights(10), signs in any::<u32>()) {
        let signed = weights.iter().enumerate();
        let t = signed.map(|(i, w)| if signs >> i & 1 == 1 { *w } else { -w }).sum();
        assert_between(&weights, t);
    }

    #[test]
    fn it_falls_with_the_score_and_not_with_the_order_of_weights(
        mut weights in weights(80), one in 0.0..1.0_f64, other in 0.0..1.0_f64,
    ) {
        let total: f64 = weights.iter().sum();
        let bound = log10_tail(&weights, one.max(other) * total);
        prop_assert!(bound <= log10_tail(&weights, one.min(other) * total) + MARGIN);
        prop_assert!(bound <= log10_chernoff(&weights, one.max(other) * total) + TIGHT);
        weights.reverse();
        prop_assert!((bound - log10_tail(&weights, one.max(other) * total)).abs() <= MARGIN);
    }

    #[test]
    fn the_sieve_holds_nothing_back(
        weights in weights(80), signs in any::<u128>(), wanted in -15.0..0.0_f64,
    ) {
        let signed = weights.iter().enumerate();
        // Mostly agreement, so that many scores are near the requested bound.
        let agrees = |i: usize| signs >> i & 1 == 1 || signs >> (i + 40) & 3 != 0;
        let t: f64 = signed.map(|(i, w)| if agrees(i) { *w } else { -w }).sum();
        if log10_tail(&weights, t) <= wanted {
            prop_assert!(least_score(&weights, wanted).is_some_and(|least| least <= t));
        }
    }
}
