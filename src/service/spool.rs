//! Uploads on their way in: written to a nameless temporary file and hashed as they arrive.
//!
//! The file has no name, so neither a crash nor a client that hangs up leaves it behind. Writing
//! and hashing happen on blocking threads in steps of [`STEP`] bytes.

use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::Path;

use sha2::{Digest, Sha256};

use super::ServiceError;
use super::admission::Admission;

/// Bytes that are gathered before a blocking thread writes them.
const STEP: usize = 1 << 20;

/// A complete upload.
#[derive(Debug)]
pub struct Spooled {
    file: File,
    /// Its length in bytes.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: [u8; 32],
    /// The file name that the client gave, unchecked: for display, never for opening a file.
    pub name: Option<String>,
    /// The share of the disk budget that the upload holds until it is dropped.
    _admission: Admission,
}

impl Spooled {
    /// Reads all bytes. Call it on a blocking thread only.
    ///
    /// # Errors
    /// The error of the system.
    pub fn read(&self) -> io::Result<Vec<u8>> {
        let length = usize::try_from(self.bytes).map_err(io::Error::other)?;
        let mut bytes = Vec::with_capacity(length);
        let mut file = &self.file;
        file.rewind()?;
        file.read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// An upload that is still arriving.
pub struct Spool {
    sink: Sink,
    waiting: Vec<u8>,
}

struct Sink {
    admission: Admission,
    file: File,
    hash: Sha256,
    bytes: u64,
}

impl Spool {
    /// Begins an upload; `directory` is where its temporary file is created.
    ///
    /// # Errors
    /// The error of the system.
    pub(super) fn begin(directory: &Path, admission: Admission) -> io::Result<Self> {
        let file = tempfile::tempfile_in(directory)?;
        let sink = Sink { admission, file, hash: Sha256::new(), bytes: 0 };
        Ok(Self { sink, waiting: Vec::new() })
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// [`ServiceError::UploadsFull`], [`ServiceError::StorageFull`], or another error of the
    /// system.
    pub async fn write(mut self, chunk: &[u8]) -> Result<Self, ServiceError> {
        self.waiting.extend_from_slice(chunk);
        if self.waiting.len() >= STEP { self.flush().await } else { Ok(self) }
    }

    async fn flush(mut self) -> Result<Self, ServiceError> {
        tokio::task::spawn_blocking(move || {
            self.sink.admission.grow(self.waiting.len() as u64)?;
            self.sink.file.write_all(&self.waiting)?;
            self.sink.hash.update(&self.waiting);
            self.sink.bytes += self.waiting.len() as u64;
            self.waiting.clear();
            Ok(self)
        })
        .await
        .map_err(|error| ServiceError::Internal(format!("spooling an upload: {error}")))?
    }

    /// Ends the upload.
    ///
    /// # Errors
    /// As [`Spool::write`].
    pub async fn end(self, name: Option<String>) -> Result<Spooled, ServiceError> {
        let Sink { mut admission, file, hash, bytes } = self.flush().await?.sink;
        admission.arrived();
        let sha256 = hash.finalize().into();
        Ok(Spooled { file, bytes, sha256, name, _admission: admission })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::admission::{Limits, Uploads};

    #[tokio::test]
    async fn what_goes_in_comes_out() {
        let directory = tempfile::tempdir().unwrap();
        let limits = Limits { uploads: 1, bytes: 10 << 20, free_bytes: 0 };
        let uploads = Uploads::new(limits, directory.path());
        for length in [0, 1, STEP - 1, STEP, 3 * STEP + 5] {
            let bytes: Vec<u8> = (0..=255).cycle().take(length).collect();
            let mut spool = Spool::begin(directory.path(), uploads.admit(0).unwrap()).unwrap();
            for chunk in bytes.chunks(100_000) {
                spool = spool.write(chunk).await.unwrap();
            }
            let spooled = spool.end(None).await.unwrap();
            assert_eq!(spooled.bytes, length as u64);
            assert_eq!(spooled.sha256, <[u8; 32]>::from(Sha256::digest(&bytes)));
            assert!(spooled.read().unwrap() == bytes && spooled.read().unwrap() == bytes);
        }
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}
