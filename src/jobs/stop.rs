//! When a job should give up: its deadline has passed, its client has hung up, or the service is
//! shutting down.

use std::time::Instant;

use tokio_util::sync::CancellationToken;

use super::JobError;

/// The stop signal that every job receives and queries between its steps.
#[derive(Debug, Clone)]
pub struct Stop {
    deadline: Instant,
    /// A child of `stopping`: one query answers for both.
    hung_up: CancellationToken,
    stopping: CancellationToken,
}

impl Stop {
    /// Stops at `deadline`, when `stopping` is cancelled, or when the client hangs up.
    #[must_use]
    pub fn new(deadline: Instant, stopping: CancellationToken) -> Self {
        Self { deadline, hung_up: stopping.child_token(), stopping }
    }

    /// Whether to give up now.
    #[must_use]
    pub fn now(&self) -> bool {
        self.hung_up.is_cancelled() || Instant::now() >= self.deadline
    }

    /// Why to give up.
    #[must_use]
    pub fn reason(&self) -> JobError {
        if self.stopping.is_cancelled() {
            JobError::ShuttingDown
        } else if self.hung_up.is_cancelled() {
            JobError::HungUp
        } else {
            JobError::DeadlinePassed
        }
    }

    /// Tells all jobs with this stop that their client hung up.
    pub(super) fn hang_up(&self) {
        self.hung_up.cancel();
    }

    /// Waits until there is a reason to give up.
    pub(super) async fn wait(&self) -> JobError {
        tokio::select! {
            () = tokio::time::sleep_until(self.deadline.into()) => {}
            () = self.hung_up.cancelled() => {}
        }
        self.reason()
    }
}
