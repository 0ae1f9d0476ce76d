//! Sweeping: at the start, what a crash left between blob and record is removed.

use uuid::Uuid;

use super::StartError;
use crate::blobs::Blobs;
use crate::registry::Registry;

/// Ids that the registry is asked about at once.
const BATCH: usize = 4096;

/// Removes blobs that no record owns. Returns under how many ids. Only before requests are
/// served: later it would take the blobs of a record that is being registered.
pub(super) async fn sweep(blobs: &Blobs, registry: &dyn Registry) -> Result<usize, StartError> {
    let mut removed = 0;
    let ids: Vec<Uuid> = blobs.ids().await?.into_iter().collect();
    for ids in ids.chunks(BATCH) {
        let owned = registry.existing(ids).await?;
        for &id in ids.iter().filter(|id| owned.binary_search(id).is_err()) {
            blobs.remove(id).await?;
            removed += 1;
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;
    use crate::blobs::Kind;
    use crate::registry::{Sqlite, sample_record};

    #[tokio::test]
    async fn sweeping_removes_only_orphans() {
        let directory = tempfile::tempdir().unwrap();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let record = sample_record();
        registry.register(&record, None).await.unwrap();
        for id in [record.id, Uuid::now_v7()] {
            for kind in [Kind::File, Kind::Host] {
                blobs.put(kind, id, Bytes::from_static(b"x")).await.unwrap();
            }
        }
        std::fs::write(directory.path().join("blobs/files/README"), "keep").unwrap();
        assert_eq!(sweep(&blobs, &registry).await.unwrap(), 1);
        assert!(blobs.get(Kind::File, record.id).await.unwrap().is_some());
        assert!(blobs.get(Kind::Host, record.id).await.unwrap().is_some());
        assert_eq!(blobs.count().await.unwrap(), 3);
    }
}
