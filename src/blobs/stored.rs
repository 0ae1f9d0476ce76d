//! A marked file in the store, read in parts: the memory of a reader does not grow with the file.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use futures::{Stream, stream};
use object_store::path::Path as BlobPath;
use object_store::{ObjectStore, ObjectStoreExt};
use uuid::Uuid;

use super::marked::{Index, MarkedError, PREFIX_BYTES, is_packed};
use super::{BlobError, Blobs, Kind};

/// Bytes that are read first. The header of a file of 1.4 GB is no longer than this.
const HEAD_BYTES: u64 = 64 << 10;
/// Bytes per read of a file that was stored before the container existed.
const PLAIN_STEP: u64 = 256 << 10;

/// An opened marked file in the store. Its header was read and is whole.
#[derive(Debug)]
pub struct StoredFile {
    store: Arc<dyn ObjectStore>,
    path: BlobPath,
    layout: Layout,
}

#[derive(Debug, Clone)]
enum Layout {
    /// The plain file, stored by a release that had no container.
    Plain {
        bytes: u64,
    },
    Frames(Arc<Index>),
}

impl Blobs {
    /// Whether a marked file is in the store. The file is not read.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn has_file(&self, id: Uuid) -> Result<bool, BlobError> {
        match self.store.head(&Kind::File.path(id)).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Opens a marked file; `None` if there is none.
    ///
    /// # Errors
    /// [`BlobError`], also when its header is damaged.
    pub async fn open_file(&self, id: Uuid) -> Result<Option<StoredFile>, BlobError> {
        let (store, path) = (self.store.clone(), Kind::File.path(id));
        let bytes = match store.head(&path).await {
            Ok(found) => found.size,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        if bytes == 0 {
            return Err(MarkedError::Damaged("it is empty").into());
        }
        let mut head = store.get_range(&path, 0..bytes.min(HEAD_BYTES)).await?;
        if !is_packed(&head) {
            return Ok(Some(StoredFile { store, path, layout: Layout::Plain { bytes } }));
        }
        let prefix = head.get(..PREFIX_BYTES).unwrap_or(&head);
        let header = Index::header_bytes(prefix, bytes)?;
        if header > head.len() as u64 {
            head = store.get_range(&path, 0..header).await?;
        }
        let index = Index::read(&head, bytes)?;
        Ok(Some(StoredFile { store, path, layout: Layout::Frames(Arc::new(index)) }))
    }
}

impl StoredFile {
    /// Bytes of the marked file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        match &self.layout {
            Layout::Plain { bytes } => *bytes,
            Layout::Frames(index) => index.plain_bytes(),
        }
    }

    /// SHA-256 of the marked file when it was stored; `None` for a plain file.
    #[must_use]
    pub fn sha256(&self) -> Option<[u8; 32]> {
        match &self.layout {
            Layout::Plain { .. } => None,
            Layout::Frames(index) => Some(*index.sha256()),
        }
    }

    /// A range of the marked file, read as the caller takes it. Each frame is checked. A range that
    /// reaches beyond the file ends with the file.
    pub fn stream(
        self,
        range: Range<u64>,
    ) -> impl Stream<Item = Result<Bytes, BlobError>> + Send + 'static {
        let end = range.end.min(self.bytes());
        stream::try_unfold((self, range.start), move |(file, position)| async move {
            if position >= end {
                return Ok(None);
            }
            let bytes = file.step(position, end).await?;
            let next = position + bytes.len() as u64;
            Ok(Some((bytes, (file, next))))
        })
    }

    /// The bytes from `position`, at least one, and none at or after `end`.
    async fn step(&self, position: u64, end: u64) -> Result<Bytes, BlobError> {
        let bytes = match &self.layout {
            Layout::Plain { .. } => {
                let step = position..end.min(position.saturating_add(PLAIN_STEP));
                self.store.get_range(&self.path, step).await?
            }
            Layout::Frames(index) => {
                let missing = MarkedError::Damaged("there is no such frame");
                let found = index
                    .frame_at(position)
                    .and_then(|frame| Some((frame, index.stored(frame)?, index.plain(frame)?)));
                let (frame, stored, plain) = found.ok_or(missing)?;
                let stored = self.store.get_range(&self.path, stored).await?;
                let index = index.clone();
                let unpacked =
                    tokio::task::spawn_blocking(move || index.unpack(frame, stored.into()));
                let unpacked = unpacked.await.map_err(|_| BlobError::Unpacking)??;
                let from = usize::try_from(position - plain.start).unwrap_or(usize::MAX);
                let to = usize::try_from(end.min(plain.end) - plain.start).unwrap_or(usize::MAX);
                let unpacked = Bytes::from(unpacked);
                if from < to && to <= unpacked.len() {
                    unpacked.slice(from..to)
                } else {
                    Bytes::new()
                }
            }
        };
        if bytes.is_empty() {
            return Err(MarkedError::Damaged("it is cut off").into());
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::TryStreamExt as _;
    use sha2::{Digest, Sha256};

    use crate::blobs::marked;

    async fn read(blobs: &Blobs, id: Uuid, range: Range<u64>) -> Result<Vec<u8>, BlobError> {
        let file = blobs.open_file(id).await?.unwrap();
        let parts: Vec<Bytes> = file.stream(range).try_collect().await?;
        Ok(parts.concat())
    }

    #[tokio::test]
    async fn every_range_equals_the_slice_packed_or_plain() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let plain: Vec<u8> =
            (0..60_000).flat_map(|n| format!("v {n}.5 0 1\n").into_bytes()).collect();
        let packed = marked::pack(&plain, &Sha256::digest(&plain).into()).unwrap();
        let length = plain.len() as u64;
        let edges = [0, 1, 17, (256 << 10) - 1, 256 << 10, (256 << 10) + 1, length - 1, length];
        for bytes in [packed, plain.clone()] {
            let id = Uuid::now_v7();
            blobs.put(Kind::File, id, bytes.into()).await.unwrap();
            assert_eq!(blobs.open_file(id).await.unwrap().unwrap().bytes(), length);
            for start in edges {
                for end in edges.into_iter().filter(|&end| end >= start) {
                    let slice = usize::try_from(start).unwrap()..usize::try_from(end).unwrap();
                    let part = read(&blobs, id, start..end).await.unwrap();
                    assert!(part == plain[slice], "{start}..{end}");
                }
            }
            assert!(read(&blobs, id, 0..u64::MAX).await.unwrap() == plain);
        }
    }

    #[tokio::test]
    async fn missing_and_damaged_files_are_told_apart() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let id = Uuid::now_v7();
        assert!(blobs.open_file(id).await.unwrap().is_none());
        assert!(!blobs.has_file(id).await.unwrap());
        let plain = vec![b'v'; 1 << 20];
        let packed = marked::pack(&plain, &[0; 32]).unwrap();
        blobs.put(Kind::File, id, packed.clone().into()).await.unwrap();
        assert!(blobs.has_file(id).await.unwrap());
        let file = blobs.open_file(id).await.unwrap().unwrap();
        let path = directory.path().join("blobs/files").join(id.to_string());
        for kept in [0, 20, PREFIX_BYTES, packed.len() - 1] {
            std::fs::write(&path, &packed[..kept]).unwrap();
            assert!(blobs.open_file(id).await.is_err(), "{kept} bytes");
        }
        // The file is cut off while it is read.
        assert!(file.stream(0..1 << 20).try_collect::<Vec<_>>().await.is_err());
        std::fs::write(&path, &packed).unwrap();
        let file = blobs.open_file(id).await.unwrap().unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(file.stream(0..1 << 20).try_collect::<Vec<_>>().await.is_err());
    }
}
