//! How much margin each bin gets: cheap bins more, expensive bins less, the sum as requested.
//!
//! Where norms crowd, as on a cylinder of a gear or the flat end of a hammer, one or two of 64 bins
//! need all their vertices moved far. These bins would make nearly all of the distortion: 97 % on the
//! gear, 99 % on the hammer (measured). The budget therefore spans the whole mark. A bin's margin stops
//! where the price of its next unit reaches a multiple of what the median bin pays. The missing margin
//! is spread over the other bins.

use rayon::prelude::*;

use super::allocation::Allocation;
use crate::mesh::stop::Stop;

/// The price at which a bin's margin stops, as a multiple of what the median bin pays at full strength.
const PRICE_LIMIT: f64 = 2.0;

/// Bounds of a bin's margin, as multiples of the strength. The lower bound is two and a half times the
/// margin that counts as readable.
const RANGE: (f64, f64) = (0.25, 1.25);

/// The requested margin of each bin; the mean over the bins is `strength` as far as the bounds allow.
/// Where more than half of the bins that must move cannot reach `strength` at any price, every bin is
/// requested to come as near to it as it can. The result must be discarded once `stop` answers `true`.
#[must_use]
pub fn margins(
    allocations: &[Allocation<'_>],
    bits: &[bool],
    strength: f64,
    stop: Stop<'_>,
) -> Vec<f64> {
    let bins = allocations.par_iter().zip(bits).with_max_len(1);
    // A bin that cannot reach its target has an infinite price.
    let prices: Vec<f64> = bins
        .map(|(bin, &bit)| {
            let solution = bin.solve(statistic(bin, bit, strength), stop);
            let already = solution.multiplier == 0.0 || (solution.multiplier > 0.0) != bit;
            match (already, solution.reached) {
                (true, _) => 0.0,
                (false, true) => bin.price(solution.multiplier),
                (false, false) => f64::INFINITY,
            }
        })
        .collect();
    let mut paid: Vec<f64> = prices.iter().copied().filter(|&p| p > 0.0).collect();
    paid.sort_unstable_by(f64::total_cmp);
    let median = paid.get(paid.len() / 2).copied().unwrap_or(f64::INFINITY);
    if !median.is_finite() {
        return vec![strength; bits.len()];
    }
    let dearest = PRICE_LIMIT * median;
    let (least, most) = (RANGE.0 * strength, RANGE.1 * strength);
    let mut wanted: Vec<f64> = allocations
        .par_iter()
        .zip(bits)
        .zip(&prices)
        .with_max_len(1)
        .map(|((bin, &bit), &price)| {
            if price <= dearest || stop() {
                return strength;
            }
            let reached = bin.statistic(bin.at_price(dearest, bit)) - bin.modulation.neutral();
            (if bit { reached } else { -reached }).clamp(least, strength)
        })
        .collect();
    let missing: f64 = wanted.iter().map(|m| strength - m).sum();
    let cheap = prices.iter().filter(|&&p| p <= dearest).count();
    let more = (strength + missing / cheap.max(1) as f64).min(most);
    for (margin, &price) in wanted.iter_mut().zip(&prices) {
        if price <= dearest {
            *margin = more;
        }
    }
    wanted
}

fn statistic(bin: &Allocation<'_>, bit: bool, margin: f64) -> f64 {
    bin.modulation.neutral() + if bit { margin } else { -margin }
}
