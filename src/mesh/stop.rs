//! Long passes in steps, so that a caller who does not wait any more is heard between them.
//!
//! A pass over millions of elements asks before each [`STEP`] of them; within a step it may use all
//! threads. What comes out does not depend on the steps. Must not know why a caller gives up.

use std::cmp::Ordering;
use std::sync::OnceLock;

use rayon::prelude::*;

/// Whether to give up. Once it answers `true` it always does.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Elements of one step. The dearest passes take a microsecond an element on one thread.
pub const STEP: usize = 1 << 16;

/// Elements that are sorted at once, in 20 to 60 ms on one thread. Fewer would be merged more often.
const SORTED: usize = 1 << 19;

/// Elements per task of a step, at least.
const TASK: usize = 1 << 10;

/// Elements per task that some are chosen from.
const CHOSEN: usize = 1 << 12;

/// For those who wait to the end.
#[must_use]
pub fn never() -> bool {
    false
}

/// `None` once it is time to give up.
#[must_use]
pub fn go_on(stop: Stop<'_>) -> Option<()> {
    (!stop()).then_some(())
}

/// What never stops has a result.
///
/// # Panics
/// Not where `run` gives up because of its argument alone.
#[must_use]
pub fn unstopped<T>(run: impl FnOnce(Stop<'_>) -> Option<T>) -> T {
    #[expect(clippy::expect_used, reason = "nobody stops it")]
    run(&never).expect("a pass that was not stopped ends")
}

/// What a cell holds, made at first need; `make` says `None` where it was stopped, and then nothing is
/// kept. Two that need it at once both make it: one that waited for the other could not be stopped.
#[must_use]
pub fn once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> Option<T>) -> Option<&T> {
    if cell.get().is_none() {
        // Another may have been quicker, with the same.
        let _ = cell.set(make()?);
    }
    cell.get()
}

/// What `of` makes of each item and its number, in order, by all threads.
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

/// What `of` makes of each number below `count`, in order, by all threads.
#[must_use]
pub fn counted<R: Send>(
    count: usize,
    stop: Stop<'_>,
    of: impl Fn(usize) -> R + Sync,
) -> Option<Vec<R>> {
    in_steps_of(STEP, count, stop, of)
}

/// The same in steps of so many numbers, for what takes longer.
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

/// Does something to each item and its number, by all threads. `None` once it was stopped; some items
/// are as they were then.
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

/// Those that `of` makes something of, in order, by all threads.
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
        // Plain loops over tasks: a parallel iterator that filters took three times as long.
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

/// The items in order, by all threads. Those that compare as equal must be equal: which of them comes
/// first is not said.
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
