//! The sweep at the start: blobs without a record go to quarantine, and what a crash left of
//! unfinished writes is removed.
//!
//! Nothing that was ever complete is deleted here before it has waited in quarantine, because the
//! fault may lie in the registry. The sweep runs only before requests are served: later, the blobs
//! of a record that is being registered would look like orphans.

use std::path::Path;

use jiff::{SignedDuration, Timestamp};
use tracing::{info, warn};
use uuid::Uuid;

use super::StartError;
use crate::blobs::{Blobs, Name};
use crate::config::Config;
use crate::keys::KeyRing;
use crate::registry::{Registry as _, Sqlite};

/// Ids per query to the registry.
const BATCH: usize = 4096;

/// What owns a blob, read from the blob's name.
enum Owner {
    /// A record.
    Record(Uuid),
    /// All records with this geometry.
    Geometry([u8; 32]),
}

/// The owner of a blob; `None` for a name of another form, which the service did not write and
/// leaves alone.
fn owner(blob: &Name) -> Option<Owner> {
    if let Ok(id) = blob.name.parse() {
        return Some(Owner::Record(id));
    }
    let mut key = [0; 32];
    let is_key = blob.directory == "hosts" && hex::decode_to_slice(&blob.name, &mut key).is_ok();
    is_key.then_some(Owner::Geometry(key))
}

/// All blobs that a service wrote.
pub(super) async fn blobs_of_ours(blobs: &Blobs) -> Result<Vec<Name>, StartError> {
    let names = blobs.names().await?;
    Ok(names.into_iter().filter(|name| owner(name).is_some()).collect())
}

/// The blobs of the service that no record owns.
pub(super) async fn orphans(blobs: &Blobs, registry: &Sqlite) -> Result<Vec<Name>, StartError> {
    let names = blobs_of_ours(blobs).await?;
    // Queried after the blobs were listed, so that a record that is registered meanwhile is found.
    let geometries = registry.geometries().await?;
    let mut orphans = Vec::new();
    for names in names.chunks(BATCH) {
        let id = |name: &Name| match owner(name) {
            Some(Owner::Record(id)) => Some(id),
            _ => None,
        };
        let ids: Vec<Uuid> = names.iter().filter_map(id).collect();
        let records = registry.existing(&ids).await?;
        let is_owned = |name: &&Name| match owner(name) {
            Some(Owner::Record(id)) => records.binary_search(&id).is_ok(),
            Some(Owner::Geometry(key)) => geometries.contains(&key),
            None => true,
        };
        orphans.extend(names.iter().filter(|name| !is_owned(name)).cloned());
    }
    Ok(orphans)
}

/// Name of a quarantine batch: the time of its sweep, to the second.
fn batch_of(at: Timestamp) -> String {
    at.strftime("%Y%m%dT%H%M%SZ").to_string()
}

fn time_of(batch: &str) -> Option<Timestamp> {
    let time = jiff::civil::DateTime::strptime("%Y%m%dT%H%M%SZ", batch).ok()?;
    Some(time.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp())
}

/// Moves orphans to quarantine and deletes the batches that have waited there for `days`.
pub(super) async fn quarantine(
    blobs: &Blobs,
    orphans: &[Name],
    data: &Path,
    days: u32,
) -> Result<(), StartError> {
    let now = Timestamp::now();
    if !orphans.is_empty() {
        let batch = batch_of(now);
        for orphan in orphans {
            blobs.quarantine(&batch, orphan).await?;
        }
        let place = data.join("blobs/quarantine").join(&batch);
        warn!(
            files = orphans.len(),
            place = %place.display(),
            days,
            "files without a record were moved to quarantine; they are deleted at a start after so \
             many days"
        );
    }
    let grace = SignedDuration::from_hours(i64::from(days) * 24);
    for batch in blobs.quarantined().await? {
        if time_of(&batch).is_some_and(|at| now.duration_since(at) > grace) {
            let files = blobs.delete_quarantined(&batch).await?;
            warn!(files, batch, "deleted files that had waited in quarantine for their time");
        }
    }
    Ok(())
}

/// Removes what a crash left of blobs, uploads and key files that were being written. None of it
/// was ever complete.
pub(super) fn staging(config: &Config, blobs: &Blobs, uploads: &Path) {
    let mut removed = blobs.remove_staging() + remove_files(uploads);
    if config.master_key.is_none() {
        removed += KeyRing::remove_staging(&config.master_key_file);
    }
    if removed > 0 {
        info!(files = removed, "removed unfinished files, left by an earlier crash");
    }
}

/// Removes leftover uploads. Upload files have no name where the system supports that; elsewhere a
/// crash leaves them.
fn remove_files(directory: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(directory) else { return 0 };
    let is_file = |entry: &std::fs::DirEntry| entry.file_type().is_ok_and(|kind| kind.is_file());
    let files = entries.filter_map(Result::ok).filter(is_file);
    files.filter(|entry| std::fs::remove_file(entry.path()).is_ok()).count()
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;
    use crate::blobs::Kind;
    use crate::registry::{Record, sample_record};

    #[tokio::test]
    async fn orphans_wait_in_quarantine_and_others_stay() {
        let directory = tempfile::tempdir().unwrap();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        let blobs = Blobs::local(&directory.path().join("blobs")).unwrap();
        let record = Record { host_kept: true, host_geometry: Some([1; 32]), ..sample_record() };
        registry.register(&record, None).await.unwrap();
        registry.revoke(record.id, Timestamp::now()).await.unwrap();
        let stranger = Uuid::now_v7();
        for id in [record.id, stranger] {
            for kind in [Kind::File, Kind::Host] {
                blobs.put(kind, id, Bytes::from_static(b"x")).await.unwrap();
            }
        }
        for key in [[1; 32], [2; 32]] {
            blobs.put_host(&key, Bytes::from_static(b"y")).await.unwrap();
        }
        std::fs::write(directory.path().join("blobs/files/README"), "keep").unwrap();
        let found = orphans(&blobs, &registry).await.unwrap();
        let names: Vec<String> = found.iter().map(ToString::to_string).collect();
        let strange_host = format!("hosts/{}", hex::encode([2; 32]));
        let mut expected =
            vec![format!("files/{stranger}"), format!("hosts/{stranger}"), strange_host];
        expected.sort();
        assert_eq!(names, expected);
        quarantine(&blobs, &found, directory.path(), 30).await.unwrap();
        assert!(orphans(&blobs, &registry).await.unwrap().is_empty());
        assert!(blobs.get(Kind::File, record.id).await.unwrap().is_some());
        assert!(blobs.host(&[1; 32]).await.unwrap().is_some());
        let batches = blobs.quarantined().await.unwrap();
        let kept = directory.path().join("blobs/quarantine").join(&batches[0]);
        let file = kept.join(format!("files/{stranger}"));
        assert_eq!(std::fs::read(&file).unwrap(), b"x");
        // It is kept before its time.
        quarantine(&blobs, &[], directory.path(), 30).await.unwrap();
        assert!(file.exists());
        let long_ago = Timestamp::now() - SignedDuration::from_hours(31 * 24);
        let old = kept.with_file_name(batch_of(long_ago));
        std::fs::rename(&kept, &old).unwrap();
        quarantine(&blobs, &[], directory.path(), 32).await.unwrap();
        assert!(old.exists());
        quarantine(&blobs, &[], directory.path(), 30).await.unwrap();
        assert!(!old.exists());
        assert!(directory.path().join("blobs/files/README").exists());
    }

    #[test]
    fn batches_are_times() {
        let at = Timestamp::from_second(1_800_000_000).unwrap();
        assert_eq!(time_of(&batch_of(at)), Some(at));
        for name in ["", "mine", "20261324T000000Z"] {
            assert_eq!(time_of(name), None, "{name}");
        }
    }
}
