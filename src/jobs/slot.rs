//! A slot among the jobs that wait or run, for all jobs of one request.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::task::task_tracker::TaskTrackerToken;

use super::{JobError, Stop, units};

/// A slot among the jobs that wait or run. One request runs all of its jobs in it, one after the
/// other, so that it is not refused half-way. Dropping the slot tells a job that still runs to
/// stop, because its client hung up. The slot is free again once that job has ended too.
#[derive(Debug)]
pub struct Slot {
    pub(super) held: Arc<Held>,
    pub(super) stop: Stop,
}

/// What a slot and its running jobs share.
#[derive(Debug)]
pub(super) struct Held {
    _place: OwnedSemaphorePermit,
    /// Draining waits for this token.
    _counted: TaskTrackerToken,
    /// The memory that the request keeps from its first job to its last.
    memory: Mutex<Option<OwnedSemaphorePermit>>,
}

impl Slot {
    pub(super) fn new(place: OwnedSemaphorePermit, counted: TaskTrackerToken, stop: Stop) -> Self {
        let held = Held { _place: place, _counted: counted, memory: Mutex::new(None) };
        Self { held: Arc::new(held), stop }
    }

    /// Says when the jobs of the slot should give up.
    #[must_use]
    pub fn stop(&self) -> &Stop {
        &self.stop
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.stop.hang_up();
    }
}

impl Held {
    pub(super) fn memory(&self) -> MutexGuard<'_, Option<OwnedSemaphorePermit>> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a running job may use.
#[derive(Debug)]
pub struct Allowance {
    pub(super) stop: Stop,
    pub(super) held: Arc<Held>,
    pub(super) budget: Arc<Semaphore>,
    pub(super) budget_units: u32,
}

impl Allowance {
    /// Says when to give up.
    #[must_use]
    pub fn stop(&self) -> &Stop {
        &self.stop
    }

    /// Reserves memory anew, once the job knows how much it needs in all: releases a surplus, or
    /// takes more if that much is free.
    ///
    /// # Errors
    /// [`JobError::Again`] when it is not free: the job must release what it made, and is run again
    /// once so much is free. A job that waited while it held memory could wait for another job that
    /// does the same. [`JobError::TooMuchMemory`] when it is more than the whole budget.
    pub fn need(&self, bytes: u64) -> Result<(), JobError> {
        let wanted = units(bytes);
        if wanted > self.budget_units {
            return Err(JobError::TooMuchMemory { bytes });
        }
        let mut memory = self.held.memory();
        let held = memory
            .as_ref()
            .map_or(0, |permit| u32::try_from(permit.num_permits()).unwrap_or(u32::MAX));
        if wanted <= held {
            let surplus = usize::try_from(held - wanted).unwrap_or(0);
            drop(memory.as_mut().and_then(|permit| permit.split(surplus)));
            return Ok(());
        }
        let more = self.budget.clone().try_acquire_many_owned(wanted - held);
        let more = more.map_err(|_| JobError::Again { bytes })?;
        match memory.as_mut() {
            Some(permit) => permit.merge(more),
            None => *memory = Some(more),
        }
        Ok(())
    }
}
