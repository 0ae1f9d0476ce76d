//! Marked files on their way out: read in steps as the client takes them, never whole in memory.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::ops::Range;

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{StreamExt as _, TryStreamExt as _, stream};
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _};
use tokio_util::io::ReaderStream;
use tracing::error;
use uuid::Uuid;

use super::{Service, ServiceError};
use crate::blobs::StoredFile;
use crate::blobs::marked::{self, MarkedError};
use crate::jobs::Stop;
use crate::registry::Record;

/// Bytes per read of a temporary file.
const STEP: usize = 256 << 10;

/// Bytes of an answer, in the parts in which they are read.
pub type Parts = BoxStream<'static, io::Result<Bytes>>;

/// A marked file that exists and can be read.
#[derive(Debug)]
pub struct Content {
    id: Uuid,
    bytes: u64,
    source: Source,
}

#[derive(Debug)]
enum Source {
    /// In the blob store.
    Stored(StoredFile),
    /// In a nameless temporary file, for a marked file that is not kept.
    Spooled(File),
}

impl Content {
    /// Length of the whole file in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Begins to read a range of bytes. The first step is read before this function returns, so
    /// that a file that is damaged at the start of the range gives an error instead of an answer. A
    /// later failure is logged and ends the stream with an error.
    ///
    /// # Errors
    /// [`ServiceError::FileLost`].
    pub async fn begin(self, range: Range<u64>) -> Result<Parts, ServiceError> {
        let id = self.id;
        let mut parts: BoxStream<'static, Result<Bytes, String>> = match self.source {
            Source::Stored(file) => file.stream(range).map_err(|error| error.to_string()).boxed(),
            Source::Spooled(file) => {
                let mut file = tokio::fs::File::from_std(file);
                file.seek(SeekFrom::Start(range.start)).await?;
                let part = file.take(range.end.saturating_sub(range.start));
                let steps = ReaderStream::with_capacity(part, STEP);
                steps.map_err(|error| error.to_string()).boxed()
            }
        };
        let first = parts.try_next().await;
        let first = first.map_err(|reason| ServiceError::FileLost { id, reason })?;
        let rest = parts.map_err(move |reason| {
            error!(%id, reason, "a marked file cannot be read to its end; its answer is cut off");
            io::Error::other(reason)
        });
        Ok(stream::iter(first.map(Ok)).chain(rest).boxed())
    }
}

impl Service {
    /// Opens the marked file of a record in the store.
    ///
    /// # Errors
    /// [`ServiceError::FileNotKept`]; [`ServiceError::FileLost`] when the file should be in the
    /// store and is missing, or is another file.
    pub async fn content(&self, record: &Record) -> Result<Content, ServiceError> {
        let id = record.id;
        if !record.file_kept {
            return Err(ServiceError::FileNotKept(id));
        }
        let lost = |reason: String| ServiceError::FileLost { id, reason };
        let file = match self.blobs.open_file(id).await {
            Ok(file) => file.ok_or_else(|| lost("it is not in the store".to_owned()))?,
            Err(error) => return Err(lost(error.to_string())),
        };
        let same = file.sha256().is_none_or(|sha256| sha256 == record.marked_sha256);
        if !same || file.bytes() != record.marked_bytes {
            return Err(lost("another file is in its place".to_owned()));
        }
        Ok(Content { id, bytes: record.marked_bytes, source: Source::Stored(file) })
    }

    /// The record of a marked file that is kept and in the store. The file itself is not read.
    ///
    /// # Errors
    /// [`ServiceError::UnknownWatermark`], [`ServiceError::FileNotKept`],
    /// [`ServiceError::FileLost`].
    pub async fn kept_file(&self, id: Uuid) -> Result<Record, ServiceError> {
        let record = self.record(id).await?;
        if !record.file_kept {
            return Err(ServiceError::FileNotKept(id));
        }
        if !self.blobs.has_file(id).await? {
            let reason = "it is not in the store".to_owned();
            return Err(ServiceError::FileLost { id, reason });
        }
        Ok(record)
    }

    /// Writes a marked file that is not kept to a temporary file, so that a client that reads
    /// slowly does not hold the file in memory.
    pub(super) async fn spooled(&self, id: Uuid, marked: Bytes) -> Result<Content, ServiceError> {
        let directory = self.spool_directory.clone();
        let bytes = marked.len() as u64;
        let written = tokio::task::spawn_blocking(move || {
            let mut file = tempfile::tempfile_in(directory)?;
            file.write_all(&marked)?;
            file.rewind()?;
            Ok::<_, io::Error>(file)
        });
        let file = written.await.map_err(io::Error::other)??;
        Ok(Content { id, bytes, source: Source::Spooled(file) })
    }
}

/// Packs a marked file for the store.
pub(super) fn packed(marked: &[u8], sha256: &[u8; 32], stop: &Stop) -> Result<Bytes, ServiceError> {
    match marked::pack_until(marked, sha256, &|| stop.now()) {
        Err(MarkedError::Stopped) => Err(stop.reason().into()),
        packed => Ok(packed.map_err(|error| ServiceError::Internal(error.to_string()))?.into()),
    }
}
