//! What the exact tail gains over Chernoff's bound, and its cost.
//!
//! ```sh
//! cargo bench --bench bound
//! ```
//!
//! Weights are absolute values of normal deviates, capped at their median as `SoftBits` caps them.
//! They are whole multiples of 2^-12 of the cap, so that the true tail can be counted. Scores are
//! those whose Chernoff bound is 10^-3, 10^-6, 10^-9 and 10^-12. Per number of bins: the decades
//! gained over Chernoff (least, mean, most); the most that is lost to the grid; and, in multiples
//! of the time of one Chernoff bound, the times of one bound, of each further score of the same
//! weights, and of the sieve's least score.
#![expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a benchmark")]

use std::f64::consts::LOG10_2;
use std::hint::black_box;
use std::time::Instant;

use quadmark::attacks::random::Random;
use quadmark::watermark::{SoftBits, least_score, log10_chernoff, log10_tail};

const STEPS: f64 = 4096.0;
const TRIALS: usize = 20;
const BOUNDS: [f64; 4] = [-3.0, -6.0, -9.0, -12.0];

/// Weights in steps, half of them `STEPS`.
fn weights(bins: usize, random: &mut Random) -> Vec<f64> {
    let normal = |random: &mut Random| (0..12).map(|_| random.share()).sum::<f64>() - 6.0;
    let soft = SoftBits::weighted((0..bins).map(|_| normal(random)).collect());
    let sizes: Vec<f64> = soft.signed_weights().iter().map(|w| w.abs()).collect();
    let cap = sizes.iter().copied().fold(0.0, f64::max);
    sizes.iter().map(|w| (w / cap * STEPS).ceil()).collect()
}

/// log10 of the share of subsets whose sum is at most 0, 1, ... steps.
fn truth(weights: &[f64]) -> Vec<f64> {
    let total: f64 = weights.iter().sum();
    let limit = (0.5 * total) as usize;
    let mut counts = vec![0.0; limit + 1];
    counts[0] = 1.0;
    for k in weights.iter().map(|&w| w as usize) {
        for sum in (k..=limit).rev() {
            counts[sum] += counts[sum - k];
        }
    }
    let mut sum = 0.0;
    let below = |count: f64| {
        sum += count;
        sum.log10() - weights.len() as f64 * LOG10_2
    };
    counts.into_iter().map(below).collect()
}

/// The score with this Chernoff bound.
fn score(weights: &[f64], bound: f64) -> f64 {
    let (mut low, mut high) = (0.0, weights.iter().sum());
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if log10_chernoff(weights, middle) <= bound { high = middle } else { low = middle }
    }
    high
}

/// Time of one run, in nanoseconds.
fn time<T>(mut run: impl FnMut() -> T) -> f64 {
    const RUNS: u32 = 200;
    let start = Instant::now();
    for _ in 0..RUNS {
        black_box(run());
    }
    start.elapsed().as_nanos() as f64 / f64::from(RUNS)
}

fn main() {
    println!(
        "bins | gained: least mean most | lost to the grid | Chernoff ns | one, further, sieve"
    );
    let mut random = Random::new(18);
    for bins in [24, 32, 48, 64, 128, 256] {
        let (mut gained, mut lost, mut times) = (Vec::new(), 0.0_f64, [0.0; 4]);
        for _ in 0..TRIALS {
            let weights = weights(bins, &mut random);
            let total: f64 = weights.iter().sum();
            let truth = truth(&weights);
            for bound in BOUNDS {
                if log10_chernoff(&weights, total) > bound {
                    continue;
                }
                let t = score(&weights, bound);
                let tail = log10_tail(&weights, t);
                let exact = truth[(0.5 * (total - t)) as usize];
                assert!(tail >= exact, "{bins}: {tail} is below the truth {exact}");
                gained.push(log10_chernoff(&weights, t) - tail);
                lost = lost.max(tail - exact);
                let mut known = quadmark::watermark::Tail::new(&weights);
                known.log10_at(t);
                times[0] += time(|| log10_chernoff(black_box(&weights), t));
                times[1] += time(|| log10_tail(black_box(&weights), t));
                times[2] += time(|| known.log10_at(black_box(t)));
                times[3] += time(|| least_score(black_box(&weights), bound));
            }
        }
        gained.sort_unstable_by(f64::total_cmp);
        let count = gained.len() as f64;
        let mean = gained.iter().sum::<f64>() / count;
        let [chernoff, one, further, sieve] = times.map(|time| time / count);
        let [one, further, sieve] = [one, further, sieve].map(|time| time / chernoff);
        let (least, most) = (gained[0], gained[gained.len() - 1]);
        println!(
            "{bins:4} | {least:.2} {mean:.2} {most:.2} | {lost:.3} | {chernoff:.0} | {one:.1}, \
             {further:.1}, {sieve:.1}"
        );
    }
}
