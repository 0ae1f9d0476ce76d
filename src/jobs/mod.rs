//! The worker pool: everything that computes runs here, off the event loop.
//!
//! A job is refused at once when too many wait ([`JobError::Busy`]), waits until a worker is free
//! and the memory it is reckoned to need fits the budget, and then runs on a blocking thread with
//! its permits inside: a client that hangs up, or a handler that is dropped, cannot make more jobs
//! run than there are workers. (With the permits on the async side, 12 jobs ran at once where 2
//! should.) A panic is contained to its job. Must not know what the jobs do.

mod stop;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

pub use stop::Stop;

/// One permit of the memory budget stands for this many bytes.
const MEMORY_UNIT: u64 = 1 << 20;

/// Why a job did not run to its end.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JobError {
    /// Too many jobs wait already.
    #[error("the service has as many jobs waiting as it takes; try again in {} s", retry_after.as_secs())]
    Busy {
        /// When to try again.
        retry_after: Duration,
    },
    /// The deadline passed before the job ended.
    #[error("the request took longer than it may")]
    DeadlinePassed,
    /// The service is going down.
    #[error("the service is shutting down")]
    ShuttingDown,
    /// The job panicked: a bug, contained.
    #[error("the job failed unexpectedly")]
    Panicked,
}

/// The pool. Cheap to clone; all clones are the same pool.
#[derive(Debug, Clone)]
pub struct Pool {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    slots: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    memory: Arc<Semaphore>,
    memory_units: u32,
    running: AtomicUsize,
    stopping: CancellationToken,
    jobs: TaskTracker,
}

/// A place among the jobs that wait or run; given back when dropped.
#[derive(Debug)]
pub struct Slot {
    _permit: OwnedSemaphorePermit,
}

impl Pool {
    /// A pool of `workers` that lets `queue` more jobs wait and whose jobs together are reckoned
    /// to need at most `memory_bytes`.
    #[must_use]
    pub fn new(workers: usize, queue: usize, memory_bytes: u64) -> Self {
        let memory_units = units(memory_bytes);
        let slots = workers.saturating_add(queue).min(Semaphore::MAX_PERMITS);
        let memory = usize::try_from(memory_units).unwrap_or(Semaphore::MAX_PERMITS);
        let shared = Shared {
            slots: Arc::new(Semaphore::new(slots)),
            workers: Arc::new(Semaphore::new(workers)),
            memory: Arc::new(Semaphore::new(memory)),
            memory_units,
            running: AtomicUsize::new(0),
            stopping: CancellationToken::new(),
            jobs: TaskTracker::new(),
        };
        Self { shared: Arc::new(shared) }
    }

    /// Whether a job that came now would be refused: asked before an upload is read, so that a
    /// busy service refuses before the bytes travel.
    ///
    /// # Errors
    /// [`JobError::Busy`] or [`JobError::ShuttingDown`].
    pub fn check(&self) -> Result<(), JobError> {
        if self.shared.stopping.is_cancelled() {
            return Err(JobError::ShuttingDown);
        }
        if self.shared.slots.available_permits() == 0 {
            return Err(self.busy());
        }
        Ok(())
    }

    /// Takes a place among the jobs that wait, or refuses at once.
    ///
    /// # Errors
    /// [`JobError::Busy`] or [`JobError::ShuttingDown`].
    pub fn admit(&self) -> Result<Slot, JobError> {
        self.check()?;
        self.shared
            .slots
            .clone()
            .try_acquire_owned()
            .map(|permit| Slot { _permit: permit })
            .map_err(|_| self.busy())
    }

    /// Runs a job, as soon as a worker is free and `memory_bytes` fit. A job that needs more than
    /// the whole budget runs alone.
    ///
    /// # Errors
    /// [`JobError::DeadlinePassed`], [`JobError::ShuttingDown`], [`JobError::Panicked`].
    pub async fn run<T: Send + 'static>(
        &self,
        slot: Slot,
        memory_bytes: u64,
        deadline: Instant,
        job: impl FnOnce(&Stop) -> T + Send + 'static,
    ) -> Result<T, JobError> {
        let shared = self.shared.clone();
        let stop = Stop::new(deadline, shared.stopping.clone());
        let wanted = units(memory_bytes).min(shared.memory_units);
        let permits = async {
            // Memory first: whoever waits for memory must not keep a worker idle.
            let memory = shared.memory.clone().acquire_many_owned(wanted).await;
            let worker = shared.workers.clone().acquire_owned().await;
            (memory, worker)
        };
        let (memory, worker) = tokio::select! {
            permits = permits => permits,
            () = tokio::time::sleep_until(deadline.into()) => return Err(JobError::DeadlinePassed),
            () = shared.stopping.cancelled() => return Err(JobError::ShuttingDown),
        };
        let (Ok(memory), Ok(worker)) = (memory, worker) else {
            return Err(JobError::ShuttingDown);
        };
        let counted = Running::new(shared.clone());
        let handle = self.shared.jobs.spawn_blocking(move || {
            let _held = (slot, memory, worker, counted);
            catch_unwind(AssertUnwindSafe(|| job(&stop)))
        });
        match handle.await {
            Ok(Ok(done)) => Ok(done),
            Ok(Err(_)) | Err(_) => Err(JobError::Panicked),
        }
    }

    /// Jobs that run now.
    #[must_use]
    pub fn running(&self) -> usize {
        self.shared.running.load(Ordering::Relaxed)
    }

    /// More jobs that would be taken now.
    #[must_use]
    pub fn free_slots(&self) -> usize {
        self.shared.slots.available_permits()
    }

    /// Takes no more jobs, gives those that run `grace` to end, then tells them to stop. Returns
    /// whether all of them ended by themselves.
    pub async fn drain(&self, grace: Duration) -> bool {
        self.shared.slots.close();
        self.shared.jobs.close();
        let ended = tokio::time::timeout(grace, self.shared.jobs.wait()).await.is_ok();
        self.shared.stopping.cancel();
        ended
    }

    fn busy(&self) -> JobError {
        if self.shared.slots.is_closed() {
            return JobError::ShuttingDown;
        }
        // Jobs take seconds; a guess from their number would be no better than this.
        JobError::Busy { retry_after: Duration::from_secs(5) }
    }
}

fn units(bytes: u64) -> u32 {
    u32::try_from(bytes.div_ceil(MEMORY_UNIT).max(1)).unwrap_or(u32::MAX)
}

struct Running(Arc<Shared>);

impl Running {
    fn new(shared: Arc<Shared>) -> Self {
        shared.running.fetch_add(1, Ordering::Relaxed);
        Self(shared)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.0.running.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;

    const LONG: Duration = Duration::from_secs(20);

    fn soon() -> Instant {
        Instant::now() + LONG
    }

    /// Runs `jobs` jobs of `bytes` each at once; the most that ever ran together.
    async fn most_at_once(pool: &Pool, jobs: usize, bytes: u64, hang_up: bool) -> u32 {
        let (now, most) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
        let mut tasks = tokio::task::JoinSet::new();
        for _ in 0..jobs {
            let (pool, now, most) = (pool.clone(), now.clone(), most.clone());
            tasks.spawn(async move {
                let slot = pool.admit().unwrap();
                let job = pool.run(slot, bytes, soon(), move |_| {
                    let running = now.fetch_add(1, Ordering::SeqCst) + 1;
                    most.fetch_max(running, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_millis(30));
                    now.fetch_sub(1, Ordering::SeqCst);
                });
                if hang_up {
                    let _ = tokio::time::timeout(Duration::from_millis(10), job).await;
                } else {
                    job.await.unwrap();
                }
            });
        }
        while tasks.join_next().await.is_some() {}
        pool.drain(LONG).await;
        most.load(Ordering::SeqCst)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn never_more_than_the_workers() {
        assert_eq!(most_at_once(&Pool::new(2, 20, 1 << 40), 12, 1, false).await, 2);
        assert!(most_at_once(&Pool::new(2, 20, 1 << 40), 12, 1, true).await <= 2);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn never_more_than_the_memory() {
        let budget = 100 << 20;
        assert_eq!(most_at_once(&Pool::new(8, 20, budget), 8, 50 << 20, false).await, 2);
        // More than the whole budget: alone, not never.
        assert_eq!(most_at_once(&Pool::new(8, 20, budget), 3, 1 << 50, false).await, 1);
    }

    #[tokio::test]
    async fn a_full_queue_refuses_at_once() {
        let pool = Pool::new(1, 1, 1 << 30);
        let first = pool.admit().unwrap();
        let _second = pool.admit().unwrap();
        assert!(matches!(pool.admit(), Err(JobError::Busy { .. })));
        assert!(matches!(pool.check(), Err(JobError::Busy { .. })));
        drop(first);
        pool.check().unwrap();
        pool.admit().unwrap();
    }

    #[tokio::test]
    async fn a_panic_is_contained() {
        let pool = Pool::new(1, 0, 1 << 30);
        for _ in 0..3 {
            let slot = pool.admit().unwrap();
            let ended = pool.run(slot, 1, soon(), |_| panic!("on purpose")).await;
            assert_eq!(ended, Err::<(), _>(JobError::Panicked));
        }
        assert_eq!(pool.run(pool.admit().unwrap(), 1, soon(), |_| 7).await, Ok(7));
        assert_eq!(pool.running(), 0);
    }

    #[tokio::test]
    async fn the_deadline_ends_waiting_and_tells_the_job() {
        let pool = Pool::new(1, 1, 1 << 30);
        let near = Instant::now() + Duration::from_millis(50);
        let (slow, late) = (pool.admit().unwrap(), pool.admit().unwrap());
        let slow = pool.run(slow, 1, near, |stop| {
            while !stop.now() {
                std::thread::sleep(Duration::from_millis(5));
            }
            std::thread::sleep(Duration::from_millis(50));
            stop.now()
        });
        let late = pool.run(late, 1, near, |_| ());
        let (slow, late) = tokio::join!(slow, late);
        assert_eq!(slow, Ok(true));
        assert_eq!(late, Err(JobError::DeadlinePassed));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn draining_waits_then_stops() {
        for (grace, ends) in [(LONG, true), (Duration::from_millis(20), false)] {
            let pool = Pool::new(1, 1, 1 << 30);
            let slot = pool.admit().unwrap();
            let running = tokio::spawn({
                let pool = pool.clone();
                async move {
                    pool.run(slot, 1, soon(), |stop| {
                        let start = Instant::now();
                        while !stop.now() && start.elapsed() < Duration::from_millis(200) {
                            std::thread::sleep(Duration::from_millis(5));
                        }
                    })
                    .await
                }
            });
            while pool.running() == 0 {
                tokio::task::yield_now().await;
            }
            assert_eq!(pool.drain(grace).await, ends);
            assert!(matches!(pool.admit(), Err(JobError::ShuttingDown)));
            running.await.unwrap().unwrap();
        }
    }
}
