//! Work taken in order by all cores.
//!
//! Each worker takes the next piece when it has finished one, and has its own share of the threads.
//! So a run that is ended early has done the first pieces, not scattered ones. A worker that waits
//! for its own parallel sums does not begin another piece meanwhile, as it would in a common pool.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Results of `work` for the numbers from 0 up to `count`, in their order.
pub fn in_order<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = rayon::current_num_threads();
    let workers = threads.min(count).max(1);
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(count));
    let take = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return;
            }
            let result = work(number);
            if let Ok(mut done) = done.lock() {
                done.push((number, result));
            }
        }
    };
    let pool = |worker: usize| {
        let share = threads / workers + usize::from(worker < threads % workers);
        ThreadPoolBuilder::new().num_threads(share).build()
    };
    let pools: Result<Vec<ThreadPool>, _> = (0..workers).map(pool).collect();
    match pools {
        Ok(pools) => std::thread::scope(|scope| {
            for pool in &pools {
                scope.spawn(|| pool.install(take));
            }
        }),
        // No more threads can be started: this thread does the work.
        Err(_) => take(),
    }
    let mut done = done.into_inner().unwrap_or_default();
    done.sort_unstable_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn every_piece_is_done_once_and_the_first_ones_first() {
        for (threads, count) in [(1, 5), (3, 0), (3, 1), (3, 40), (4, 3)] {
            let begun = Mutex::new(Vec::new());
            let work = |number: usize| {
                begun.lock().unwrap().push(number);
                // Parallel work of its own, on its share of the threads.
                let sum: usize = (0..1000).into_par_iter().sum();
                (number, sum, rayon::current_num_threads())
            };
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let done = pool.install(|| in_order(count, work));
            assert_eq!(
                done.iter().map(|d| d.0).collect::<Vec<_>>(),
                (0..count).collect::<Vec<_>>()
            );
            let share = threads / threads.min(count).max(1);
            let fits = |own| own == share || own == share + 1;
            assert!(done.iter().all(|&(_, sum, own)| sum == 499_500 && fits(own)));
            let begun = begun.into_inner().unwrap();
            let late = begun.iter().enumerate().filter(|&(k, &n)| n > k + threads).count();
            assert_eq!(late, 0, "{begun:?}");
        }
    }
}
