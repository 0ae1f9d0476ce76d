//! The errors of the use cases, one variant per cause. Must not know about HTTP.

use std::time::Duration;

use jiff::Timestamp;
use uuid::Uuid;

use crate::blobs::BlobError;
use crate::blobs::geometry::GeometryError;
use crate::formats::{Format, FormatError};
use crate::jobs::JobError;
use crate::keys::KeyError;
use crate::marking::MarkError;
use crate::registry::RegistryError;
use crate::watermark::WatermarkError;

/// Why a request was refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// A parameter has a value that cannot be used.
    #[error("{parameter}: {reason}")]
    InvalidParameter {
        /// Its name in requests.
        parameter: &'static str,
        /// What is wrong, and which values are right.
        reason: String,
    },
    /// The file cannot be read as a mesh.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The format of the host is not among those that the caller accepts.
    #[error("the file is {}, which the caller does not take back", .0.extension())]
    FormatNotTaken(Format),
    /// The mesh cannot be marked or read.
    #[error(transparent)]
    Watermark(#[from] WatermarkError),
    /// The marked file did not read back. This is a bug, caught before anything was handed out.
    #[error("the marked file failed its check and was not handed out: {0}")]
    Check(String),
    /// The mesh has too few vertices for any layer. The text has the figures.
    #[error("{0}")]
    TooSmall(String),
    /// No mark stays within the distortion that the request allows. The text has the figures.
    #[error("max_distortion: {0}")]
    DistortionUnreachable(String),
    /// There is no such record.
    #[error("there is no watermark {0}; list the known ones with GET /v1/watermarks")]
    UnknownWatermark(Uuid),
    /// There is no such verification.
    #[error("there is no verification {0}")]
    UnknownVerification(Uuid),
    /// The record exists; its marked file was not kept.
    #[error(
        "the marked file of {0} was not kept; upload the host again with the same Idempotency-Key \
         and parameters to get the same bytes"
    )]
    FileNotKept(Uuid),
    /// The marked file should be in the store, and is missing or damaged.
    #[error(
        "the marked file of {id} was kept and cannot be read now ({reason}); tell the operator: \
         a backup of the data directory has it, and sending the host again with the same \
         Idempotency-Key and parameters makes it again"
    )]
    FileLost {
        /// The record.
        id: Uuid,
        /// What is wrong with the file.
        reason: String,
    },
    /// The idempotency key was used for another request.
    #[error(
        "this Idempotency-Key was used for another request (other parameters or another file); use \
         a new key"
    )]
    IdempotencyConflict,
    /// A request with this idempotency key is running.
    #[error("a request with this Idempotency-Key is being worked on; try again shortly")]
    IdempotencyInProgress,
    /// The idempotency key belongs to a mark that was revoked.
    #[error(
        "the Idempotency-Key {key:?} stands for the watermark {id}, which was revoked at {at}: its \
         file is not handed out again. To mark the file anew, send the request with another \
         Idempotency-Key"
    )]
    IdempotencyRevoked {
        /// The key.
        key: String,
        /// The record.
        id: Uuid,
        /// When it was revoked.
        at: Timestamp,
    },
    /// No mark that the request asks about can be searched for.
    #[error("there is nothing to compare the file with: {0}")]
    NothingToCompare(String),
    /// The marked file was not kept, and this version would mark the host differently.
    #[error(
        "the record {0} exists, but its marked file was not kept and cannot be made again; use a \
         new Idempotency-Key"
    )]
    CannotRemake(Uuid),
    /// The host already carries these marks, and the request rejects such hosts.
    #[error(
        "the file already carries a registered mark ({}); mark its original, or send \
         on_existing=warn to add a mark beside",
        listed(.0)
    )]
    AlreadyMarked(Vec<Uuid>),
    /// The pool did not run the job.
    #[error(transparent)]
    Job(#[from] JobError),
    /// Too many uploads are on their way, or too many bytes of them.
    #[error("{0}; try again shortly")]
    UploadsFull(String),
    /// The disk is full, or nearly full.
    #[error(
        "the disk of the service is full ({0}); nothing was registered; try again later, or tell \
         the operator"
    )]
    StorageFull(String),
    /// A bug or a fault of the machine. The text is for the log.
    #[error("{0}")]
    Internal(String),
}

/// The ids, separated by commas.
fn listed(ids: &[Uuid]) -> String {
    ids.iter().map(Uuid::to_string).collect::<Vec<_>>().join(", ")
}

impl ServiceError {
    /// The time after which the same request may succeed.
    #[must_use]
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Job(JobError::Busy { retry_after }) => Some(*retry_after),
            Self::Job(JobError::ShuttingDown | JobError::DeadlinePassed) => {
                Some(Duration::from_secs(10))
            }
            Self::UploadsFull(_) => Some(Duration::from_secs(5)),
            Self::StorageFull(_) => Some(Duration::from_mins(1)),
            Self::IdempotencyInProgress => Some(Duration::from_secs(1)),
            _ => None,
        }
    }
}

impl From<MarkError> for ServiceError {
    fn from(error: MarkError) -> Self {
        match error {
            MarkError::Format(error) => error.into(),
            MarkError::Watermark(WatermarkError::Cancelled) => JobError::DeadlinePassed.into(),
            MarkError::Watermark(error) => error.into(),
            MarkError::Check(reason) => Self::Check(reason),
            error @ MarkError::ReliefTooSmall { .. } => Self::TooSmall(error.to_string()),
            error @ MarkError::DistortionUnreachable { .. } => {
                Self::DistortionUnreachable(error.to_string())
            }
        }
    }
}

macro_rules! internal {
    ($($error:ty)*) => {$(
        impl From<$error> for ServiceError {
            fn from(error: $error) -> Self {
                Self::Internal(error.to_string())
            }
        }
    )*};
}
internal!(KeyError GeometryError);

macro_rules! disk_or_internal {
    ($($error:ty)*) => {$(
        impl From<$error> for ServiceError {
            fn from(error: $error) -> Self {
                if is_full(&error) {
                    return Self::StorageFull("it has no room left".to_owned());
                }
                Self::Internal(error.to_string())
            }
        }
    )*};
}
disk_or_internal!(BlobError std::io::Error);

impl From<RegistryError> for ServiceError {
    fn from(error: RegistryError) -> Self {
        if error.is_full() || is_full(&error) {
            return Self::StorageFull("the registry has no room left".to_owned());
        }
        Self::Internal(error.to_string())
    }
}

/// Whether an error, or one of its causes, says that the disk is full or that the user's quota is
/// used up.
fn is_full(error: &(dyn std::error::Error + 'static)) -> bool {
    use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.filter_map(|error| error.downcast_ref::<std::io::Error>()).any(|error| {
        matches!(error.kind(), StorageFull | QuotaExceeded | FileTooLarge)
            || error.get_ref().is_some_and(|inner| is_full(inner))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    #[test]
    fn a_full_disk_is_seen_through_its_wrappers() {
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        for error in [full(), io::Error::other(full()), io::Error::other(io::Error::other(full()))]
        {
            assert!(matches!(ServiceError::from(error), ServiceError::StorageFull(_)));
        }
        let other = io::Error::from(io::ErrorKind::PermissionDenied);
        assert!(matches!(ServiceError::from(other), ServiceError::Internal(_)));
    }
}
