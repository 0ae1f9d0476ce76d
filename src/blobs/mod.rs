//! The blob store: marked files and host geometries, under the id of their record.
//!
//! `files/{id}` is the marked file (compressed, see [`marked`]), `hosts/{id}` the geometry of the
//! host (see [`geometry`]). Each write is whole or not there. Blobs are written before their record is
//! registered and removed when that fails; the service sweeps at the start what a crash left between
//! the two. Must not know about HTTP, watermarks or records; nothing here is named by a user: the
//! only path component is a record's id.

pub mod geometry;
pub mod marked;
mod stored;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::local::LocalFileSystem;
use object_store::path::Path as BlobPath;
use object_store::{ObjectStore, ObjectStoreExt};
use uuid::Uuid;

use crate::durable::create_directory;
use marked::MarkedError;
pub use stored::StoredFile;

/// Why a blob could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The store refused.
    #[error("blob store: {0}")]
    Store(#[from] object_store::Error),
    /// A marked file was stored and is not whole.
    #[error(transparent)]
    Marked(#[from] MarkedError),
    /// The thread that unpacks ended before it was done.
    #[error("a stored file could not be unpacked")]
    Unpacking,
    /// The directory of the store cannot be made.
    #[error("the blob directory {path} cannot be created: {source}")]
    Directory {
        /// The directory.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What a blob is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The marked file.
    File,
    /// The host's geometry.
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
}

impl Blobs {
    /// A store in a directory of the local file system, made if it is not there.
    ///
    /// # Errors
    /// [`BlobError`] when the directory cannot be made.
    pub fn local(directory: &Path) -> Result<Self, BlobError> {
        // Made here and not by the first blob: of two at once, one would not wait until the name of
        // the directory that the other makes is on the disk.
        for kind in Kind::ALL {
            let inside = directory.join(kind.directory());
            create_directory(&inside).map_err(|source| BlobError::Directory {
                path: inside.display().to_string(),
                source,
            })?;
        }
        let store = LocalFileSystem::new_with_prefix(directory)?.with_fsync(true);
        Ok(Self { store: Arc::new(store) })
    }

    /// Writes a blob, whole or not at all.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn put(&self, kind: Kind, id: Uuid, bytes: Bytes) -> Result<(), BlobError> {
        self.store.put(&kind.path(id), bytes.into()).await?;
        Ok(())
    }

    /// Reads a blob; `None` when there is none.
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

    /// Removes both blobs of a record; what is not there is no error.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn remove(&self, id: Uuid) -> Result<(), BlobError> {
        for kind in Kind::ALL {
            self.remove_at(&kind.path(id)).await?;
        }
        Ok(())
    }

    async fn remove_at(&self, path: &BlobPath) -> Result<(), BlobError> {
        match self.store.delete(path).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// The ids under which anything is stored.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn ids(&self) -> Result<BTreeSet<Uuid>, BlobError> {
        let mut ids = BTreeSet::new();
        for kind in Kind::ALL {
            let mut found = self.store.list(Some(&BlobPath::from(kind.directory())));
            while let Some(blob) = found.try_next().await? {
                // A name that is no id is not ours: leave it to whoever put it there.
                ids.extend(blob.location.filename().and_then(|name| name.parse::<Uuid>().ok()));
            }
        }
        Ok(ids)
    }

    /// How many blobs there are.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn count(&self) -> Result<usize, BlobError> {
        let found: Vec<_> = self.store.list(None).try_collect().await?;
        Ok(found.len())
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
    async fn ids_are_listed_once_and_other_names_not() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let ids = BTreeSet::from([Uuid::now_v7(), Uuid::now_v7()]);
        for &id in &ids {
            for kind in Kind::ALL {
                blobs.put(kind, id, Bytes::from_static(b"x")).await.unwrap();
            }
        }
        std::fs::write(directory.path().join("blobs/files/README"), "keep").unwrap();
        assert_eq!(blobs.ids().await.unwrap(), ids);
        assert_eq!(blobs.count().await.unwrap(), 5);
    }
}
