//! Host geometries: one blob for each, however many records share it.
//!
//! `hosts/{key}` is named by a hash of its content ([`super::geometry::key`], hexadecimal), so
//! writing it twice writes the same. A registration holds its key from before its write until its
//! end. A failed registration removes the blob only if nobody else holds the key and no record uses
//! it, and no other registration can begin to hold the key meanwhile. The caller says which records
//! exist.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use bytes::Bytes;
use futures::TryStreamExt as _;
use object_store::path::Path as BlobPath;
use object_store::{ObjectStore as _, ObjectStoreExt as _};
use tokio::sync::Mutex;

use super::{BlobError, Blobs};

/// The key of a geometry.
pub type GeometryKey = [u8; 32];

const DIRECTORY: &str = "hosts";

/// Keys that running registrations hold, with the number of holds of each.
pub(super) type Held = Arc<Mutex<HashMap<GeometryKey, usize>>>;

fn path(key: &GeometryKey) -> BlobPath {
    BlobPath::from_iter([DIRECTORY.to_owned(), hex::encode(key)])
}

pub(super) fn key_of(path: &BlobPath) -> Option<GeometryKey> {
    let mut key = [0; 32];
    hex::decode_to_slice(path.filename()?, &mut key).ok()?;
    Some(key)
}

/// Ends one hold. Returns how many are left.
fn end(held: &mut HashMap<GeometryKey, usize>, key: &GeometryKey) -> usize {
    let left = held.get(key).map_or(0, |count| count.saturating_sub(1));
    if left == 0 {
        held.remove(key);
    } else {
        held.insert(*key, left);
    }
    left
}

impl Blobs {
    /// Holds a host: its blob, now or once written, stays until [`Blobs::release_host`].
    pub async fn hold_host(&self, key: &GeometryKey) {
        *self.held.lock().await.entry(*key).or_default() += 1;
    }

    /// Writes a host that is held, unless it is stored already.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn put_host(&self, key: &GeometryKey, packed: Bytes) -> Result<(), BlobError> {
        match self.store.head(&path(key)).await {
            Ok(_) => Ok(()),
            Err(object_store::Error::NotFound { .. }) => {
                self.store.put(&path(key), packed.into()).await?;
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Ends a hold after its record was registered: the blob stays.
    pub async fn keep_host(&self, key: &GeometryKey) {
        end(&mut *self.held.lock().await, key);
    }

    /// Ends a hold. If it was the last one and `is_used` says that no record uses the host, the
    /// blob is removed.
    ///
    /// # Errors
    /// [`BlobError::Store`], or the error of `is_used`. On the latter the blob stays.
    pub async fn release_host<E: From<BlobError>>(
        &self,
        key: &GeometryKey,
        is_used: impl Future<Output = Result<bool, E>>,
    ) -> Result<(), E> {
        // The lock is kept to the end: whoever holds the key next writes the blob anew.
        let mut held = self.held.lock().await;
        if end(&mut held, key) > 0 {
            return Ok(());
        }
        if is_used.await? { Ok(()) } else { Ok(self.remove_at(&path(key)).await?) }
    }

    /// The packed geometry of a host; `None` if it is missing.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn host(&self, key: &GeometryKey) -> Result<Option<Bytes>, BlobError> {
        match self.store.get(&path(key)).await {
            Ok(found) => Ok(Some(found.bytes().await?)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// The keys under which hosts are stored.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn host_keys(&self) -> Result<BTreeSet<GeometryKey>, BlobError> {
        let found = self.store.list(Some(&BlobPath::from(DIRECTORY)));
        let keys = found.try_filter_map(|blob| std::future::ready(Ok(key_of(&blob.location))));
        Ok(keys.try_collect().await?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: GeometryKey = [7; 32];

    fn used(is: bool) -> std::future::Ready<Result<bool, BlobError>> {
        std::future::ready(Ok(is))
    }

    #[tokio::test]
    async fn a_host_goes_with_the_last_that_needs_it() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(directory.path()).unwrap();
        let bytes = Bytes::from_static(b"geometry");
        // Two registrations at once; the first fails, the second may still succeed.
        for _ in 0..2 {
            blobs.hold_host(&KEY).await;
            blobs.put_host(&KEY, bytes.clone()).await.unwrap();
        }
        blobs.release_host(&KEY, used(false)).await.unwrap();
        assert_eq!(blobs.host(&KEY).await.unwrap().unwrap(), bytes);
        blobs.release_host(&KEY, used(true)).await.unwrap();
        assert_eq!(blobs.host_keys().await.unwrap(), BTreeSet::from([KEY]));
        // A third fails while the second's record uses the host, a fourth when no record uses it.
        for is in [true, false] {
            blobs.hold_host(&KEY).await;
            blobs.put_host(&KEY, bytes.clone()).await.unwrap();
            blobs.release_host(&KEY, used(is)).await.unwrap();
            assert_eq!(blobs.host(&KEY).await.unwrap().is_some(), is);
        }
        assert!(blobs.held.lock().await.is_empty());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn failing_beside_succeeding_never_takes_a_used_host_away() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::local(directory.path()).unwrap();
        let records = Arc::new(AtomicUsize::new(0));
        let mut tasks = tokio::task::JoinSet::new();
        for task in 0..64 {
            let (blobs, records) = (blobs.clone(), records.clone());
            tasks.spawn(async move {
                blobs.hold_host(&KEY).await;
                blobs.put_host(&KEY, Bytes::from_static(b"geometry")).await.unwrap();
                tokio::task::yield_now().await;
                if task % 8 == 7 {
                    assert!(blobs.host(&KEY).await.unwrap().is_some(), "registered without a host");
                    records.fetch_add(1, Ordering::SeqCst);
                }
                let is_used = async { used(records.load(Ordering::SeqCst) > 0).await };
                blobs.release_host(&KEY, is_used).await.unwrap();
                records.load(Ordering::SeqCst) == 0 || blobs.host(&KEY).await.unwrap().is_some()
            });
        }
        while let Some(done) = tasks.join_next().await {
            assert!(done.unwrap());
        }
        assert!(blobs.host(&KEY).await.unwrap().is_some());
    }
}
