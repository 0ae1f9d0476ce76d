//! The blob store: marked files, each under the id of its record, and host geometries, each stored
//! once.
//!
//! `files/{id}` is a marked file, compressed (see [`marked`]). `hosts/{key}` is the geometry of a
//! host (see [`geometry`] and `hosts`); older data directories have `hosts/{id}`. A blob is written
//! whole or not at all. Blobs are written before their record is registered, and removed when the
//! registration fails. The service finds at its start what a crash left between the two. Must not
//! know about HTTP, watermarks or records. No path contains a user's words: its parts are a
//! record's id or a hash.

pub mod geometry;
mod hosts;
pub mod marked;
mod quarantine;
mod stored;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use object_store::local::LocalFileSystem;
use object_store::path::Path as BlobPath;
use object_store::{ObjectStore, ObjectStoreExt};
use uuid::Uuid;

use crate::durable::create_directory;
use marked::MarkedError;
pub use stored::StoredFile;

pub use hosts::GeometryKey;
pub use quarantine::Name;

/// Why a blob could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The store refused or failed.
    #[error("blob store: {0}")]
    Store(#[from] object_store::Error),
    /// A stored marked file is not whole.
    #[error(transparent)]
    Marked(#[from] MarkedError),
    /// The thread that unpacks a file died.
    #[error("a stored file could not be unpacked")]
    Unpacking,
    /// There is no store.
    #[error("there is no directory {0}")]
    NoDirectory(String),
    /// The directory of the store cannot be created.
    #[error("the blob directory {path} cannot be created: {source}")]
    Directory {
        /// The directory.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
}

/// The kind of a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The marked file.
    File,
    /// The host's geometry, as it was stored before hosts were stored once per geometry.
    Host,
}

impl Kind {
    const ALL: [Self; 2] = [Self::File, Self::Host];

    fn directory(self) -> &'static str {
        match self {
            Self::File => "files",
            Self::Host => "hosts",
        }
    }

    fn path(self, id: Uuid) -> BlobPath {
        BlobPath::from_iter([self.directory().to_owned(), id.to_string()])
    }
}

/// The blob store.
#[derive(Debug, Clone)]
pub struct Blobs {
    store: Arc<dyn ObjectStore>,
    /// Its directory in the local file system.
    directory: Option<PathBuf>,
    held: hosts::Held,
}

impl Blobs {
    /// A store in a directory of the local file system, created if it is missing.
    ///
    /// # Errors
    /// [`BlobError`] when the directory cannot be created.
    pub fn local(directory: &Path) -> Result<Self, BlobError> {
        // The directories are created here and not with the first blob: of two writers at once, one
        // would not wait until the name of the directory that the other creates is on the disk.
        for kind in Kind::ALL {
            let inside = directory.join(kind.directory());
            create_directory(&inside).map_err(|source| BlobError::Directory {
                path: inside.display().to_string(),
                source,
            })?;
        }
        Self::over(directory)
    }

    /// Opens a store that exists; `None` if there is none. Nothing is created.
    ///
    /// # Errors
    /// [`BlobError::Store`] when the store cannot be used.
    pub fn there(directory: &Path) -> Result<Option<Self>, BlobError> {
        if directory.is_dir() { Self::over(directory).map(Some) } else { Ok(None) }
    }

    fn over(directory: &Path) -> Result<Self, BlobError> {
        let store = LocalFileSystem::new_with_prefix(directory)?.with_fsync(true);
        let held = hosts::Held::default();
        Ok(Self { store: Arc::new(store), directory: Some(directory.to_owned()), held })
    }

    /// Files of unfinished writes: running ones, or ones that a crash ended.
    #[must_use]
    pub fn staging(&self) -> Vec<PathBuf> {
        // The store's own listing hides such files. Their names are `{name}#{number}`.
        let is_staging = |path: &PathBuf| {
            let name = path.file_name().and_then(std::ffi::OsStr::to_str);
            let number = name.and_then(|name| name.rsplit_once('#')).map(|(_, number)| number);
            number.is_some_and(|it| !it.is_empty() && it.bytes().all(|b| b.is_ascii_digit()))
        };
        let Some(directory) = &self.directory else { return Vec::new() };
        let below = Kind::ALL.map(|kind| std::fs::read_dir(directory.join(kind.directory())));
        let entries = below.into_iter().filter_map(Result::ok).flatten().filter_map(Result::ok);
        entries.map(|entry| entry.path()).filter(is_staging).collect()
    }

    /// Removes these files and returns their number. Call it only while nothing is written.
    #[must_use]
    pub fn remove_staging(&self) -> usize {
        self.staging().iter().filter(|path| std::fs::remove_file(path).is_ok()).count()
    }

    /// Writes a blob, whole or not at all.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn put(&self, kind: Kind, id: Uuid, bytes: Bytes) -> Result<(), BlobError> {
        self.store.put(&kind.path(id), bytes.into()).await?;
        Ok(())
    }

    /// Reads a blob; `None` if there is none.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn get(&self, kind: Kind, id: Uuid) -> Result<Option<Bytes>, BlobError> {
        match self.store.get(&kind.path(id)).await {
            Ok(found) => Ok(Some(found.bytes().await?)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Removes the marked file of a record. A missing file is no error.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn remove(&self, id: Uuid) -> Result<(), BlobError> {
        self.remove_at(&Kind::File.path(id)).await
    }

    /// Removes a host that is stored under the id of its record.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn remove_own_host(&self, id: Uuid) -> Result<(), BlobError> {
        self.remove_at(&Kind::Host.path(id)).await
    }

    async fn remove_at(&self, path: &BlobPath) -> Result<(), BlobError> {
        match self.store.delete(path).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Number of blobs, without those in quarantine.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn count(&self) -> Result<usize, BlobError> {
        Ok(self.names().await?.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn written_read_removed() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let id = Uuid::now_v7();
        assert_eq!(blobs.get(Kind::File, id).await.unwrap(), None);
        blobs.put(Kind::File, id, Bytes::from_static(b"abc")).await.unwrap();
        assert_eq!(blobs.get(Kind::File, id).await.unwrap().unwrap(), "abc");
        assert_eq!(blobs.get(Kind::Host, id).await.unwrap(), None);
        assert_eq!(blobs.count().await.unwrap(), 1);
        blobs.remove(id).await.unwrap();
        blobs.remove(id).await.unwrap();
        assert_eq!(blobs.count().await.unwrap(), 0);
    }

    #[tokio::test]
    async fn unfinished_writes_are_found_and_removed() {
        let directory = tempfile::tempdir().unwrap();
        assert!(Blobs::there(&directory.path().join("blobs")).unwrap().is_none());
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let id = Uuid::now_v7();
        blobs.put(Kind::File, id, Bytes::from_static(b"abc")).await.unwrap();
        let file = directory.path().join(format!("blobs/files/{id}"));
        for suffix in ["#1", "#12"] {
            std::fs::write(format!("{}{suffix}", file.display()), "ab").unwrap();
        }
        std::fs::write(directory.path().join("blobs/hosts/notes#a"), "keep").unwrap();
        assert_eq!(blobs.count().await.unwrap(), 2);
        assert_eq!((blobs.remove_staging(), blobs.remove_staging()), (2, 0));
        assert_eq!(blobs.get(Kind::File, id).await.unwrap().unwrap(), "abc");
    }
}
