//! Sums that do not depend on the number of threads.
//!
//! Floating-point addition is not associative, so a parallel sum must fix its own tree. Blocks of a
//! constant size are summed in order, and the block sums are added in order.

use rayon::prelude::*;

use super::stop::{STEP, Stop, go_on, unstopped};

/// Items per block: large enough to hide the scheduling, small enough to balance.
const BLOCK: usize = 4096;

/// Blocks between two calls of `stop`.
const BLOCKS: usize = 4 * STEP / BLOCK;

/// `fold` over blocks of `items` in parallel, then `add` over the block sums in order.
pub fn ordered_sum<T: Sync, S: Send + Sync + Copy>(
    items: &[T],
    zero: S,
    fold: impl Fn(S, &T) -> S + Sync,
    add: impl Fn(S, S) -> S,
) -> S {
    unstopped(|stop| ordered_sum_until(items, zero, fold, add, stop))
}

/// As [`ordered_sum`]; `None` once `stop` answers `true`.
#[must_use]
pub fn ordered_sum_until<T: Sync, S: Send + Sync + Copy>(
    items: &[T],
    zero: S,
    fold: impl Fn(S, &T) -> S + Sync,
    add: impl Fn(S, S) -> S,
    stop: Stop<'_>,
) -> Option<S> {
    let mut blocks: Vec<S> = Vec::with_capacity(items.len().div_ceil(BLOCK));
    for step in items.chunks(BLOCKS * BLOCK) {
        go_on(stop)?;
        blocks.par_extend(step.par_chunks(BLOCK).map(|block| block.iter().fold(zero, &fold)));
    }
    Some(blocks.into_iter().fold(zero, add))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_is_the_same_on_one_and_on_many_threads() {
        let items: Vec<f64> = (0..100_000).map(|i| 1.0 / f64::from(i + 1)).collect();
        let sum = || ordered_sum(&items, 0.0, |s, x| s + x, |a, b| a + b);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(sum);
        let four = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap().install(sum);
        assert_eq!(one.to_bits(), four.to_bits());
    }
}
