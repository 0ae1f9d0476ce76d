//! The worker pool: everything that computes runs here, off the event loop.
//!
//! A job is refused at once when too many wait ([`JobError::Busy`]). Otherwise it waits until a
//! worker is free and the memory that it is estimated to need fits the budget. It then runs on a
//! blocking thread and holds its permits there: a client that hangs up, or a handler that is
//! dropped, cannot make more jobs run than there are workers. With the permits on the async side,
//! 12 jobs ran at once where 2 should. A panic ends its own job only. Must not know what the jobs
//! do.
//!
//! A request with several jobs runs them in one [`Slot`]. It is refused before its first job or not
//! at all, it has one deadline, and draining waits for all of it.
//!
//! Memory is reserved from the size of an upload before the upload is read, and anew from what was
//! found in it ([`Allowance::need`]). No two jobs wait for each other's memory. The reservation of
//! a request is taken whole or not at all. What a later job needs beyond it comes from a separate
//! share of the budget, which is always requested after the first reservation.

mod slot;
mod stop;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

pub use slot::{Allowance, Slot};
pub use stop::Stop;

/// One permit of the memory budget stands for this many bytes.
const MEMORY_UNIT: u64 = 1 << 20;

/// Divisor of the memory budget: one part in so many is reserved for what later jobs of a request
/// need beyond their first reservation, which is the hosts that a suspect is compared with.
const LATER_SHARE: u64 = 8;

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
    /// The service is shutting down.
    #[error("the service is shutting down")]
    ShuttingDown,
    /// Nobody waits for the answer.
    #[error("the client hung up")]
    HungUp,
    /// The file needs more memory than all jobs together may have.
    #[error(
        "the file takes about {} MiB of memory to process, more than the service may use for all of \
         its work; send a smaller mesh, or raise memory_budget_bytes",
        bytes.div_ceil(MEMORY_UNIT)
    )]
    TooMuchMemory {
        /// The bytes that it needs.
        bytes: u64,
    },
    /// The job needs more memory than is free now, and is to be run again with that much.
    #[error("the job needs {bytes} bytes of memory")]
    Again {
        /// All bytes that it needs.
        bytes: u64,
    },
    /// The job panicked. This is a bug, contained in the job.
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
    memory: Share,
    later: Share,
    running: AtomicUsize,
    stopping: CancellationToken,
    jobs: TaskTracker,
}

/// A share of the memory budget.
#[derive(Debug)]
struct Share {
    free: Arc<Semaphore>,
    units: u32,
}

impl Share {
    fn new(bytes: u64) -> Self {
        let units = units(bytes);
        let permits = usize::try_from(units).unwrap_or(Semaphore::MAX_PERMITS);
        Self { free: Arc::new(Semaphore::new(permits)), units }
    }
}

/// The memory that is reserved for a job before it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// So many bytes, in place of what the request has reserved so far.
    Of(u64),
    /// What the request has reserved, and so many more bytes for this job alone.
    Beyond(u64),
}

impl Pool {
    /// A pool of `workers` that lets `queue` more jobs wait, and whose running jobs are estimated
    /// to need at most `memory_bytes` together.
    #[must_use]
    pub fn new(workers: usize, queue: usize, memory_bytes: u64) -> Self {
        let slots = workers.saturating_add(queue).min(Semaphore::MAX_PERMITS);
        let later = memory_bytes / LATER_SHARE;
        let shared = Shared {
            slots: Arc::new(Semaphore::new(slots)),
            workers: Arc::new(Semaphore::new(workers)),
            memory: Share::new(memory_bytes - later),
            later: Share::new(later),
            running: AtomicUsize::new(0),
            stopping: CancellationToken::new(),
            jobs: TaskTracker::new(),
        };
        Self { shared: Arc::new(shared) }
    }

    /// Whether a job that came now would be accepted. It is called before an upload is read, so
    /// that a busy service refuses before the bytes are sent.
    ///
    /// # Errors
    /// [`JobError::Busy`] or [`JobError::ShuttingDown`].
    pub fn check(&self) -> Result<(), JobError> {
        if self.shared.stopping.is_cancelled() || self.shared.slots.is_closed() {
            return Err(JobError::ShuttingDown);
        }
        if self.shared.slots.available_permits() == 0 {
            return Err(self.busy());
        }
        Ok(())
    }

    /// Takes a slot among the waiting jobs, or refuses at once. All jobs in the slot end by
    /// `deadline`.
    ///
    /// # Errors
    /// [`JobError::Busy`] or [`JobError::ShuttingDown`].
    pub fn admit(&self, deadline: Instant) -> Result<Slot, JobError> {
        self.check()?;
        let place = self.shared.slots.clone().try_acquire_owned().map_err(|_| self.busy())?;
        let stop = Stop::new(deadline, self.shared.stopping.clone());
        Ok(Slot::new(place, self.shared.jobs.token(), stop))
    }

    /// Runs a job as soon as a worker is free and its memory fits. A job that needs more than the
    /// whole budget runs alone.
    ///
    /// # Errors
    /// [`JobError::DeadlinePassed`], [`JobError::ShuttingDown`], [`JobError::HungUp`],
    /// [`JobError::Panicked`].
    pub async fn run<T: Send + 'static>(
        &self,
        slot: &Slot,
        memory: Memory,
        job: impl FnOnce(&Allowance) -> T + Send + 'static,
    ) -> Result<T, JobError> {
        let shared = self.shared.clone();
        let (share, bytes) = match memory {
            Memory::Of(bytes) => {
                slot.held.memory().take();
                (&shared.memory, bytes)
            }
            Memory::Beyond(bytes) => (&shared.later, bytes),
        };
        let wanted = units(bytes).min(share.units);
        let permits = async {
            // Memory comes first: a job that waits for memory must not keep a worker idle.
            let memory = share.free.clone().acquire_many_owned(wanted).await;
            let worker = shared.workers.clone().acquire_owned().await;
            (memory, worker)
        };
        let (reserved, worker) = tokio::select! {
            permits = permits => permits,
            reason = slot.stop.wait() => return Err(reason),
        };
        let (Ok(reserved), Ok(worker)) = (reserved, worker) else {
            return Err(JobError::ShuttingDown);
        };
        let mut beyond = None;
        match memory {
            Memory::Of(_) => *slot.held.memory() = Some(reserved),
            Memory::Beyond(_) => beyond = Some(reserved),
        }
        let allowance = Allowance {
            stop: slot.stop.clone(),
            held: slot.held.clone(),
            budget: shared.memory.free.clone(),
            budget_units: shared.memory.units,
        };
        let counted = Running::new(shared.clone());
        let handle = tokio::task::spawn_blocking(move || {
            let _held = (beyond, worker, counted);
            catch_unwind(AssertUnwindSafe(|| job(&allowance)))
        });
        match handle.await {
            Ok(Ok(done)) => Ok(done),
            Ok(Err(_)) | Err(_) => Err(JobError::Panicked),
        }
    }

    /// Number of jobs that run now.
    #[must_use]
    pub fn running(&self) -> usize {
        self.shared.running.load(Ordering::Relaxed)
    }

    /// Number of further jobs that would be accepted now.
    #[must_use]
    pub fn free_slots(&self) -> usize {
        self.shared.slots.available_permits()
    }

    /// Accepts no more requests, gives requests that have a slot `grace` to end, then tells their
    /// jobs to stop. Returns whether all of them ended by themselves.
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
        // Jobs take seconds; an estimate from their number would be no better than this.
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
