//! The histogram mapping of Cho et al. 2007 and the paper (eq. 9-15): all places in a bin are raised to
//! one power, chosen so that the bin's statistic reaches its target.

use crate::mesh::stop::{STEP, Stop};
use crate::watermark::Modulation;

/// Range of `ln beta` that is searched. `beta = e^7` moves the mean of an even bin to 0.001 and
/// `beta = e^-7` to 0.999: further than any strength asks for.
const LN_BETA_RANGE: (f64, f64) = (-7.0, 7.0);

/// How close the statistic must come to its target: far below the smallest strength (0.01).
const TOLERANCE: f64 = 1e-8;

/// Largest number of steps; four to six are usual. A Newton step that leaves the bracket is replaced by
/// a bisection.
const MAX_STEPS: usize = 60;

/// Distances of places from the fixed point of the map count as at least this much, which keeps `ln`
/// finite.
const LEAST_PLACE: f64 = 1e-300;

/// Solves for the power and replaces `places`, the `t` of one bin's movable vertices in [0, 1), by the
/// mapped places, still in [0, 1).
///
/// Mean: `t' = t^beta`. Variance: `u' = sign(u) |u|^beta` with `u = 2t - 1`. Both statistics fall
/// monotonically in beta, because their derivative by `ln beta` is a sum of negative terms. The root is
/// therefore bracketed, and the bracket safeguards Newton's steps on `ln beta`. A target out of reach
/// of the bracket gives the nearest statistic within reach; places that are all next to 1, for example,
/// cannot move.
///
/// `logs` is scratch of the same length. The result must be discarded once `stop` answers `true`.
pub fn power_map(
    modulation: Modulation,
    places: &mut [f64],
    logs: &mut [f64],
    target: f64,
    stop: Stop<'_>,
) {
    let magnitude = |t: f64| match modulation {
        Modulation::Mean => t,
        Modulation::Variance => (2.0 * t - 1.0).abs(),
    };
    for (logs, places) in logs.chunks_mut(STEP).zip(places.chunks(STEP)) {
        if stop() {
            return;
        }
        for (log, &t) in logs.iter_mut().zip(places) {
            *log = libm::log(magnitude(t).max(LEAST_PLACE));
        }
    }
    let power = match modulation {
        Modulation::Mean => 1.0,
        Modulation::Variance => 2.0,
    };
    let beta = solve(logs, power, target, stop);
    let map = |t: &mut f64, log: f64| {
        let mapped = libm::exp(beta * log);
        *t = match modulation {
            Modulation::Mean => mapped,
            Modulation::Variance if *t < 0.5 => f64::midpoint(-mapped, 1.0),
            Modulation::Variance => f64::midpoint(mapped, 1.0),
        }
        // A power near zero rounds to 1, which belongs to the next bin.
        .clamp(0.0, 1.0 - f64::EPSILON);
    };
    for (places, logs) in places.chunks_mut(STEP).zip(logs.chunks(STEP)) {
        if stop() {
            return;
        }
        places.iter_mut().zip(logs).for_each(|(t, &log)| map(t, log));
    }
}

/// The beta with `mean(exp(power beta log_j)) = target`.
fn solve(logs: &[f64], power: f64, target: f64, stop: Stop<'_>) -> f64 {
    let (mut low, mut high) = LN_BETA_RANGE;
    // Even bin: mean is 1 / (1 + power beta).
    let guess = (1.0 / target.clamp(1e-3, 0.999) - 1.0) / power;
    let mut x = libm::log(guess).clamp(low, high);
    for _ in 0..MAX_STEPS {
        if stop() {
            break;
        }
        let (value, slope) = statistic_and_slope(logs, power * libm::exp(x));
        let error = value - target;
        if error.abs() <= TOLERANCE || high - low < 1e-14 {
            break;
        }
        // The statistic falls with beta: when it is too large, beta must grow.
        if error > 0.0 {
            low = x;
        } else {
            high = x;
        }
        let newton = x - error / slope;
        x = if newton > low && newton < high { newton } else { f64::midpoint(low, high) };
    }
    libm::exp(x)
}

/// The mean of `exp(k log_j)` and its derivative by `ln k`.
fn statistic_and_slope(logs: &[f64], k: f64) -> (f64, f64) {
    let (sum, slope) = logs.iter().fold((0.0, 0.0), |(sum, slope), &log| {
        let exponent = k * log;
        let mapped = libm::exp(exponent);
        (sum + mapped, slope + exponent * mapped)
    });
    let count = logs.len().max(1) as f64;
    (sum / count, slope / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::stop::never;
    use crate::watermark::bins::contribution;

    fn uneven(n: u32, exponent: f64) -> Vec<f64> {
        (0..n).map(|i| ((f64::from(i) + 0.5) / f64::from(n)).powf(exponent)).collect()
    }

    #[test]
    fn the_statistic_reaches_its_target_and_no_vertex_leaves_its_bin() {
        for modulation in [Modulation::Mean, Modulation::Variance] {
            for exponent in [0.3, 1.0, 2.5] {
                for shift in [-0.25, -0.1, -0.01, 0.01, 0.1, 0.25] {
                    let mut places = uneven(500, exponent);
                    let before = places.clone();
                    let target = modulation.neutral() + shift;
                    power_map(modulation, &mut places, &mut vec![0.0; 500], target, &never);
                    let reached =
                        places.iter().map(|&t| contribution(modulation, t)).sum::<f64>() / 500.0;
                    assert!((reached - target).abs() < 1e-6, "{modulation} {exponent} {shift}");
                    assert!(places.iter().all(|t| (0.0..1.0).contains(t)));
                    // Order is kept: the map is monotone.
                    assert!(
                        before
                            .windows(2)
                            .zip(places.windows(2))
                            .all(|(b, a)| b[0] <= b[1] && a[0] <= a[1])
                    );
                }
            }
        }
    }

    #[test]
    fn what_cannot_move_stays_finite() {
        for modulation in [Modulation::Mean, Modulation::Variance] {
            for stuck in [0.0, 0.5, 1.0 - f64::EPSILON] {
                let mut places = [stuck; 5];
                power_map(modulation, &mut places, &mut [0.0; 5], 0.6, &never);
                assert!(places.iter().all(|t| (0.0..1.0).contains(t)));
            }
            power_map(modulation, &mut [], &mut [], 0.6, &never);
        }
    }
}
