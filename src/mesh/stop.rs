//! Long passes in steps, so that a caller that does not wait any more can stop them between steps.
//!
//! A pass over millions of elements calls `stop` before each [`STEP`] of them; within a step it may use
//! all threads. The result does not depend on the steps. Must not know why a caller stops.

use std::cmp::Ordering;
use std::sync::OnceLock;

use rayon::prelude::*;

/// Whether to stop. Once it answers `true`, it always does.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Elements of one step. The most expensive passes take a microsecond per element on one thread.
pub const STEP: usize = 1 << 16;

/// Elements that are sorted at once, in 20 to 60 ms on one thread. Smaller runs would need more
/// merging.
const SORTED: usize = 1 << 19;

/// Least number of elements per task of a step.
const TASK: usize = 1 << 10;

/// Elements per task of [`chosen`].
const CHOSEN: usize = 1 << 12;

/// A stop that never stops.
#[must_use]
pub fn never() -> bool {
    false
}

/// `None` once `stop` answers `true`.
#[must_use]
pub fn go_on(stop: Stop<'_>) -> Option<()> {
    (!stop()).then_some(())
}

/// The result of a pass that is never stopped.
///
/// # Panics
/// When `run` returns `None` although its argument never answered `true`.
#[must_use]
pub fn unstopped<T>(run: impl FnOnce(Stop<'_>) -> Option<T>) -> T {
    #[expect(clippy::expect_used, reason = "nobody stops it")]
    run(&never).expect("a pass that was not stopped ends")
}

/// The content of a cell, made when it is first needed. `make` returns `None` where it was stopped, and
/// then nothing is kept. Two threads that need the content at once both make it, because a thread that
/// waited for the other could not be stopped.
#[must_use]
pub fn once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> Option<T>) -> Option<&T> {
    if cell.get().is_none() {
        // Another thread may have set the same content first.
        let _ = cell.set(make()?);
    }
    cell.get()
}

/// The values of `of` for each item and its number, in order, computed by all threads.
#[must_use]
pub fn mapped<T: Sync, R: Send>(
    items: &[T],
    stop: Stop<'_>,
    of: impl Fn(usize, &T) -> R + Sync,
) -> Option<Vec<R>> {
    let mut all = Vec::with_capacity(items.len());
    for (number, step) in items.chunks(STEP).enumerate() {
        go_on(stop)?;
        let start = number * STEP;
        let step = step.par_iter().enumerate().with_min_len(TASK);
        all.par_extend(step.map(|(place, item)| of(start + place, item)));
    }
    Some(all)
}

/// The values of `of` for each number below `count`, in order, computed by all threads.
#[must_use]
pub fn counted<R: Send>(
    count: usize,
    stop: Stop<'_>,
    of: impl Fn(usize) -> R + Sync,
) -> Option<Vec<R>> {
    in_steps_of(STEP, count, stop, of)
}

/// As [`counted`] in steps of `length` numbers, for values that take longer.
#[must_use]
pub fn in_steps_of<R: Send>(
    length: usize,
    count: usize,
    stop: Stop<'_>,
    of: impl Fn(usize) -> R + Sync,
) -> Option<Vec<R>> {
    let mut all = Vec::with_capacity(count);
    for start in (0..count).step_by(length) {
        go_on(stop)?;
        let step = (start..(start + length).min(count)).into_par_iter().with_min_len(TASK);
        all.par_extend(step.map(&of));
    }
    Some(all)
}

/// Calls `change` on each item with its number, by all threads. `None` once it was stopped; some items
/// are then unchanged.
pub fn changed<T: Send>(
    items: &mut [T],
    stop: Stop<'_>,
    change: impl Fn(usize, &mut T) + Sync,
) -> Option<()> {
    for (number, step) in items.chunks_mut(STEP).enumerate() {
        go_on(stop)?;
        let start = number * STEP;
        let step = step.par_iter_mut().enumerate().with_min_len(TASK);
        step.for_each(|(place, item)| change(start + place, item));
    }
    Some(())
}

/// The values of `of` that are not `None`, in order, computed by all threads.
#[must_use]
pub fn chosen<T: Sync, R: Send>(
    items: &[T],
    stop: Stop<'_>,
    of: impl Fn(usize, &T) -> Option<R> + Sync,
) -> Option<Vec<R>> {
    let mut all = Vec::with_capacity(items.len());
    for (number, step) in items.chunks(STEP).enumerate() {
        go_on(stop)?;
        let start = number * STEP;
        // Plain loops over tasks: a filtering parallel iterator took three times as long.
        let task = |(task, items): (usize, &[T])| {
            let mut chosen = Vec::with_capacity(items.len());
            let numbered = (start + task * CHOSEN..).zip(items);
            chosen.extend(numbered.filter_map(|(place, item)| of(place, item)));
            chosen
        };
        let tasks: Vec<Vec<R>> = step.par_chunks(CHOSEN).enumerate().map(task).collect();
        for mut chosen in tasks {
            all.append(&mut chosen);
        }
    }
    Some(all)
}

/// The items in ascending order, sorted by all threads. Items that compare as equal must be equal,
/// because their order is not defined.
#[must_use]
pub fn sorted<T: Copy + Send + Sync>(
    mut items: Vec<T>,
    stop: Stop<'_>,
    compare: impl Fn(&T, &T) -> Ordering + Sync,
) -> Option<Vec<T>> {
    for run in items.chunks_mut(SORTED) {
        go_on(stop)?;
        run.par_sort_unstable_by(&compare);
    }
    let mut length = SORTED;
    while length < items.len() {
        let mut merged = Vec::with_capacity(items.len());
        for pair in items.chunks(2 * length) {
            let (first, second) = pair.split_at(length.min(pair.len()));
            merge(first, second, &mut merged, stop, &compare)?;
        }
        items = merged;
        length *= 2;
    }
    Some(items)
}

fn merge<'a, T: Copy>(
    mut first: &'a [T],
    mut second: &'a [T],
    merged: &mut Vec<T>,
    stop: Stop<'_>,
    compare: &impl Fn(&T, &T) -> Ordering,
) -> Option<()> {
    while !first.is_empty() && !second.is_empty() {
        go_on(stop)?;
        for _ in 0..STEP {
            let (Some(a), Some(b)) = (first.first(), second.first()) else { break };
            let taken = if compare(b, a).is_lt() { &mut second } else { &mut first };
            if let Some((item, rest)) = taken.split_first() {
                merged.push(*item);
                *taken = rest;
            }
        }
    }
    merged.extend_from_slice(first);
    merged.extend_from_slice(second);
    Some(())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use super::*;

    const COUNT: usize = 5 * SORTED / 2 + 17;

    fn numbers() -> Vec<u64> {
        (0..COUNT as u64).map(|k| k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40).collect()
    }

    #[test]
    fn passes_in_steps_are_passes() {
        let items = numbers();
        let plain: Vec<u64> = items.iter().zip(0..).map(|(x, k)| x ^ k).collect();
        assert_eq!(mapped(&items, &never, |k, x| x ^ k as u64).unwrap(), plain);
        assert_eq!(counted(COUNT, &never, |k| items[k] ^ k as u64).unwrap(), plain);
        let mut inside = items.clone();
        changed(&mut inside, &never, |k, x| *x ^= k as u64).unwrap();
        assert_eq!(inside, plain);
        let even = |x: &u64| x.is_multiple_of(2).then_some(*x);
        let some: Vec<u64> = items.iter().filter_map(even).collect();
        assert_eq!(chosen(&items, &never, |_, x| even(x)).unwrap(), some);
    }

    #[test]
    fn sorting_in_steps_sorts() {
        for count in [0, 1, SORTED, SORTED + 1, 2 * SORTED, COUNT] {
            let items = numbers()[..count].to_vec();
            let mut plain = items.clone();
            plain.sort_unstable();
            assert_eq!(sorted(items, &never, Ord::cmp).unwrap(), plain, "{count}");
        }
    }

    #[test]
    fn a_stop_is_heard_at_each_question() {
        let items = numbers();
        let asked = AtomicUsize::new(0);
        let at = |last: usize| move |asked: &AtomicUsize| asked.fetch_add(1, Relaxed) >= last;
        let runs: [&dyn Fn(Stop<'_>) -> bool; 3] = [
            &|stop| mapped(&items, stop, |_, x| *x).is_none(),
            &|stop| chosen(&items, stop, |_, x| Some(*x)).is_none(),
            &|stop| sorted(items.clone(), stop, Ord::cmp).is_none(),
        ];
        for run in runs {
            asked.store(0, Relaxed);
            assert!(!run(&|| at(usize::MAX)(&asked)));
            let questions = asked.load(Relaxed);
            assert!(questions >= 3);
            for last in [0, questions / 2, questions - 1] {
                asked.store(0, Relaxed);
                assert!(run(&|| at(last)(&asked)), "{last} of {questions}");
                assert_eq!(asked.load(Relaxed), last + 1, "nothing is asked after the answer");
            }
        }
    }
}
