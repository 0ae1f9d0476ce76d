//! When a job should give up: its deadline passed, or the service is going down.

use std::time::Instant;

use tokio_util::sync::CancellationToken;

/// Handed to every job, to be asked between stages.
#[derive(Debug, Clone)]
pub struct Stop {
    deadline: Instant,
    stopping: CancellationToken,
}

impl Stop {
    /// Stops at `deadline`, or when `stopping` is cancelled.
    #[must_use]
    pub fn new(deadline: Instant, stopping: CancellationToken) -> Self {
        Self { deadline, stopping }
    }

    /// Whether to give up now.
    #[must_use]
    pub fn now(&self) -> bool {
        self.stopping.is_cancelled() || Instant::now() >= self.deadline
    }
}
