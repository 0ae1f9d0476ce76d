//! The quarantine: blobs without a record wait here before they are deleted.
//!
//! The paths are `quarantine/{batch}/files/{id}` and `.../hosts/{name}`. A batch is named by the
//! time of its sweep. Moving a blob back undoes the quarantine. Must not know who owns what, nor
//! how long a batch waits.

use std::collections::BTreeSet;

use futures::TryStreamExt as _;
use object_store::path::Path as BlobPath;
use object_store::{ObjectStore as _, ObjectStoreExt as _};

use super::{BlobError, Blobs};

pub(super) const DIRECTORY: &str = "quarantine";

/// The name of a blob, of whatever form.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Name {
    /// `files` or `hosts`.
    pub directory: String,
    /// Its name there.
    pub name: String,
}

impl std::fmt::Display for Name {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}/{}", self.directory, self.name)
    }
}

impl Blobs {
    /// The names of all blobs outside the quarantine.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn names(&self) -> Result<BTreeSet<Name>, BlobError> {
        let mut names = BTreeSet::new();
        for directory in ["files", "hosts"] {
            let mut found = self.store.list(Some(&BlobPath::from(directory)));
            while let Some(blob) = found.try_next().await? {
                let Some(name) = blob.location.filename() else { continue };
                names.insert(Name { directory: directory.to_owned(), name: name.to_owned() });
            }
        }
        Ok(names)
    }

    /// Moves a blob into a batch of the quarantine, durably.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn quarantine(&self, batch: &str, blob: &Name) -> Result<(), BlobError> {
        let parts = [blob.directory.as_str(), blob.name.as_str()];
        let from = BlobPath::from_iter(parts);
        let to = BlobPath::from_iter([&[DIRECTORY, batch], parts.as_slice()].concat());
        Ok(self.store.rename(&from, &to).await?)
    }

    /// The batches of the quarantine.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn quarantined(&self) -> Result<Vec<String>, BlobError> {
        let found = self.store.list_with_delimiter(Some(&BlobPath::from(DIRECTORY))).await?;
        let name = |path: &BlobPath| path.filename().map(str::to_owned);
        Ok(found.common_prefixes.iter().filter_map(name).collect())
    }

    /// Deletes a batch of the quarantine. Returns the number of its blobs.
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn delete_quarantined(&self, batch: &str) -> Result<usize, BlobError> {
        let prefix = BlobPath::from_iter([DIRECTORY, batch]);
        let found: Vec<_> = self.store.list(Some(&prefix)).try_collect().await?;
        for blob in &found {
            self.remove_at(&blob.location).await?;
        }
        // Without this the empty directories would be listed as a batch for ever. A directory that
        // is not empty holds a file that the service did not write.
        if let Some(directory) = &self.directory {
            let batch = directory.join(DIRECTORY).join(batch);
            for inside in ["files", "hosts", ""] {
                let _ = std::fs::remove_dir(batch.join(inside));
            }
        }
        Ok(found.len())
    }
}
