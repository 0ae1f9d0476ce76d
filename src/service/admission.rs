//! Admission of uploads: how many may arrive at once, and how much of the disk they may take
//! together.
//!
//! The length that an upload declares is reserved before its first byte. For an upload that
//! declares none, the reservation grows as the bytes arrive. Reserved bytes are released with the
//! upload's file, at the latest when its job ends.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::ServiceError;

/// Limits for all uploads together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Most uploads that arrive at once.
    pub(super) uploads: usize,
    /// Most bytes of all uploads that arrive or are being processed.
    pub(super) bytes: u64,
    /// Bytes of the disk that must stay free.
    pub(super) free_bytes: u64,
}

/// All uploads of a service. Cheap to clone; all clones share the same counts.
#[derive(Debug, Clone)]
pub(super) struct Uploads(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    limits: Limits,
    directory: PathBuf,
    taken: Mutex<Taken>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Taken {
    uploads: usize,
    reserved: u64,
    written: u64,
}

/// The reservation of one upload, released when it is dropped.
#[derive(Debug)]
pub struct Admission {
    uploads: Uploads,
    coming: bool,
    reserved: u64,
    written: u64,
}

impl Uploads {
    pub(super) fn new(limits: Limits, directory: &Path) -> Self {
        let directory = directory.to_owned();
        Self(Arc::new(Shared { limits, directory, taken: Mutex::default() }))
    }

    /// Refuses when less of the disk is free than must stay free.
    pub(super) fn check_disk(&self) -> Result<(), ServiceError> {
        self.check_room(0)
    }

    /// Admits an upload that declares so many bytes; 0 when it declares none.
    ///
    /// # Errors
    /// [`ServiceError::UploadsFull`], [`ServiceError::StorageFull`].
    pub(super) fn admit(&self, declared: u64) -> Result<Admission, ServiceError> {
        let limits = self.0.limits;
        let outstanding = self.change(|taken| {
            if taken.uploads >= limits.uploads {
                let most = limits.uploads;
                return Err(ServiceError::UploadsFull(format!("{most} uploads are on their way")));
            }
            taken.reserve(declared, limits.bytes)?;
            taken.uploads += 1;
            Ok(taken.reserved.saturating_sub(taken.written))
        })?;
        let uploads = self.clone();
        let admission = Admission { uploads, coming: true, reserved: declared, written: 0 };
        // Includes what others have reserved and not yet written.
        self.check_room(outstanding)?;
        Ok(admission)
    }

    fn check_room(&self, wanted: u64) -> Result<(), ServiceError> {
        let kept = self.0.limits.free_bytes;
        match free_bytes(&self.0.directory) {
            Some(free) if free < kept.saturating_add(wanted) => Err(ServiceError::StorageFull(
                format!("{free} bytes are free, {kept} must stay free (min_free_bytes)"),
            )),
            _ => Ok(()),
        }
    }

    fn change<T>(&self, change: impl FnOnce(&mut Taken) -> T) -> T {
        change(&mut self.0.taken.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Taken {
    fn reserve(&mut self, bytes: u64, most: u64) -> Result<(), ServiceError> {
        let reserved = self.reserved.saturating_add(bytes);
        if reserved > most {
            return Err(ServiceError::UploadsFull(format!(
                "uploads that are on their way take the {most} bytes that they may take together"
            )));
        }
        self.reserved = reserved;
        Ok(())
    }
}

impl Admission {
    /// Reserves room for so many more bytes before they are written. Runs on a blocking thread,
    /// because it queries the disk.
    ///
    /// # Errors
    /// [`ServiceError::UploadsFull`], [`ServiceError::StorageFull`].
    pub(super) fn grow(&mut self, bytes: u64) -> Result<(), ServiceError> {
        let written = self.written.saturating_add(bytes);
        let more = written.saturating_sub(self.reserved);
        let most = self.uploads.0.limits.bytes;
        self.uploads.change(|taken| {
            taken.reserve(more, most)?;
            taken.written = taken.written.saturating_add(bytes);
            Ok::<_, ServiceError>(())
        })?;
        self.reserved += more;
        self.written = written;
        self.uploads.check_room(bytes)
    }

    /// Ends the arrival: what was reserved beyond the written bytes is released.
    pub(super) fn arrived(&mut self) {
        let unused = self.reserved.saturating_sub(self.written);
        let coming = std::mem::take(&mut self.coming);
        self.reserved = self.written;
        self.uploads.change(|taken| {
            taken.reserved = taken.reserved.saturating_sub(unused);
            taken.uploads = taken.uploads.saturating_sub(usize::from(coming));
        });
    }
}

impl Drop for Admission {
    fn drop(&mut self) {
        self.uploads.change(|taken| {
            taken.reserved = taken.reserved.saturating_sub(self.reserved);
            taken.written = taken.written.saturating_sub(self.written);
            taken.uploads = taken.uploads.saturating_sub(usize::from(self.coming));
        });
    }
}

/// Free bytes of the disk of a directory for this process; `None` when the system does not report
/// them.
#[cfg(unix)]
fn free_bytes(directory: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(directory).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(not(unix))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uploads(uploads: usize, bytes: u64, free_bytes: u64) -> Uploads {
        Uploads::new(Limits { uploads, bytes, free_bytes }, &std::env::temp_dir())
    }

    fn taken(uploads: &Uploads) -> (usize, u64, u64) {
        uploads.change(|taken| (taken.uploads, taken.reserved, taken.written))
    }

    #[test]
    fn what_is_declared_is_reserved_and_given_back() {
        let uploads = uploads(2, 100, 0);
        let mut first = uploads.admit(60).unwrap();
        assert!(matches!(uploads.admit(41), Err(ServiceError::UploadsFull(_))));
        let mut second = uploads.admit(40).unwrap();
        assert!(matches!(uploads.admit(0), Err(ServiceError::UploadsFull(_))));
        first.grow(10).unwrap();
        assert!(second.grow(41).is_err());
        second.grow(40).unwrap();
        assert_eq!(taken(&uploads), (2, 100, 50));
        first.arrived();
        first.arrived();
        assert_eq!(taken(&uploads), (1, 50, 50));
        drop((first, second));
        assert_eq!(taken(&uploads), (0, 0, 0));
    }

    #[test]
    fn what_declares_nothing_grows_to_the_budget() {
        let uploads = uploads(2, 100, 0);
        let _other = uploads.admit(50).unwrap();
        let mut upload = uploads.admit(0).unwrap();
        upload.grow(30).unwrap();
        upload.grow(20).unwrap();
        assert!(matches!(upload.grow(1), Err(ServiceError::UploadsFull(_))));
        drop(upload);
        assert_eq!(taken(&uploads), (1, 50, 0));
    }

    #[cfg(unix)]
    #[test]
    fn a_full_disk_takes_nothing_and_keeps_no_place() {
        let free = free_bytes(&std::env::temp_dir()).unwrap();
        let uploads = uploads(2, u64::MAX, free / 2);
        assert!(uploads.check_disk().is_ok());
        assert!(matches!(uploads.admit(free), Err(ServiceError::StorageFull(_))));
        assert_eq!(taken(&uploads), (0, 0, 0));
        let kept = self::uploads(2, u64::MAX, u64::MAX);
        assert!(matches!(kept.check_disk(), Err(ServiceError::StorageFull(_))));
    }
}
