//! The registry in one `SQLite` file: write-ahead log, one writer, a pool of readers.
//!
//! Writes go through a single connection and `BEGIN IMMEDIATE`. A plain `BEGIN` that reads first
//! and writes later failed in 217 of 400 concurrent transactions, `BEGIN IMMEDIATE` in none. Must
//! not be opened twice on one directory: each process has its own index of marks in memory.
//!
//! A write returns when it is on the disk, so that whatever is answered afterwards survives a power
//! cut.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;
use std::time::Duration;

use async_trait::async_trait;
use jiff::Timestamp;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use uuid::Uuid;

use super::record::{
    Counts, Cursor, Filter, HostSketch, IdempotencyEntry, MarkSource, Order, Page, Record,
    StoredVerification, Tally,
};
use super::sqlite_counts;
use super::sqlite_pages::{counts, page};
use super::sqlite_rows::{bad_row, bytes32, insert_record, record_from_row, source_from_row};
use super::{Identity, Registry, RegistryError};
use crate::durable::{create_directory, sync_directory};

const READERS: u32 = 4;

/// The `SQLite` registry of one data directory.
#[derive(Debug)]
pub struct Sqlite {
    pub(super) writer: SqlitePool,
    pub(super) readers: SqlitePool,
    /// Held for the life of the registry. A registry that is only read needs no lock.
    _lock: Option<Lock>,
}

/// A locked data directory. The system releases the lock when the process dies.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

impl Sqlite {
    /// Opens `registry.sqlite` in the data directory. Creates it, or brings its schema up to date,
    /// if needed.
    ///
    /// # Errors
    /// [`RegistryError::InUse`] when another process has it open; otherwise the error of the
    /// system.
    pub async fn open(data: &Path) -> Result<Self, RegistryError> {
        Self::open_locked(data, Lock::take(data)?).await
    }

    /// The same, for a data directory that is locked already.
    ///
    /// # Errors
    /// The error of the system.
    pub async fn open_locked(data: &Path, lock: Lock) -> Result<Self, RegistryError> {
        let options = SqliteConnectOptions::new()
            .filename(data.join("registry.sqlite"))
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            // NORMAL syncs the log at checkpoints only: a power cut would lose what was answered.
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(Duration::from_secs(10));
        let writer =
            SqlitePoolOptions::new().max_connections(1).connect_with(options.clone()).await?;
        sqlx::migrate!("migrations/sqlite").run(&writer).await?;
        sync_directory(data).map_err(|source| unusable(data, source))?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .connect_with(options.create_if_missing(false).read_only(true))
            .await?;
        Ok(Self { writer, readers, _lock: Some(lock) })
    }

    /// Whether the data directory has a registry.
    #[must_use]
    pub fn is_there(data: &Path) -> bool {
        data.join("registry.sqlite").exists()
    }

    /// Closes all connections of a registry that was opened for reading.
    pub async fn end(self) {
        self.close().await;
    }

    /// Opens an existing registry of a locked directory, to examine it before anything is changed.
    /// The database still rolls back what a crash left half done, which a connection that only
    /// reads could not.
    ///
    /// # Errors
    /// The error of the system.
    pub async fn open_to_look(data: &Path, _lock: &Lock) -> Result<Self, RegistryError> {
        let options = SqliteConnectOptions::new()
            .filename(data.join("registry.sqlite"))
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10));
        let readers = SqlitePoolOptions::new().max_connections(1).connect_with(options).await?;
        Ok(Self { writer: readers.clone(), readers, _lock: None })
    }

    /// Opens an existing registry for reading, also while a service has it open. Every function
    /// that writes fails.
    ///
    /// # Errors
    /// [`RegistryError`] when there is no registry of this version.
    pub async fn open_to_read(data: &Path) -> Result<Self, RegistryError> {
        let file = data.join("registry.sqlite");
        if !tokio::fs::try_exists(&file).await.unwrap_or(true) {
            return Err(RegistryError::NoRegistry(data.display().to_string()));
        }
        let options = SqliteConnectOptions::new()
            .filename(file)
            .read_only(true)
            .busy_timeout(Duration::from_secs(10));
        let readers = SqlitePoolOptions::new().max_connections(READERS).connect_with(options);
        let readers = readers.await?;
        Ok(Self { writer: readers.clone(), readers, _lock: None })
    }
}

fn unusable(data: &Path, source: std::io::Error) -> RegistryError {
    RegistryError::Directory { path: data.display().to_string(), source }
}

impl Lock {
    /// Locks a data directory, and creates it if it is missing. It is readable by its owner alone,
    /// since it holds marked files and hosts.
    ///
    /// # Errors
    /// [`RegistryError::InUse`] when another process has the lock; otherwise the error of the
    /// system.
    pub fn take(data: &Path) -> Result<Self, RegistryError> {
        let failed = |source| unusable(data, source);
        create_directory(data).map_err(failed)?;
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(data.join("lock"))
            .map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(RegistryError::InUse(data.display().to_string())),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

pub(super) fn ids_from(rows: Vec<(String,)>) -> Result<Vec<Uuid>, RegistryError> {
    rows.into_iter().map(|(id,)| id.parse().map_err(|_| bad_row(&id, "id"))).collect()
}

/// The ids as `json_each` takes them, so that the text of a statement is the same for any number of
/// ids.
fn json_list(ids: &[Uuid]) -> String {
    serde_json::json!(ids).to_string()
}

#[async_trait]
impl Registry for Sqlite {
    async fn register(
        &self,
        record: &Record,
        idempotency: Option<&IdempotencyEntry>,
    ) -> Result<(), RegistryError> {
        let mut transaction = self.writer.begin_with("BEGIN IMMEDIATE").await?;
        insert_record(&mut transaction, record).await?;
        sqlite_counts::take_refused(&mut transaction, record).await?;
        if let Some(entry) = idempotency {
            let inserted = sqlx::query(
                "INSERT INTO idempotency (owner_id, key, fingerprint, watermark_id)
                 VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING",
            )
            .bind(&entry.owner_id)
            .bind(&entry.key)
            .bind(entry.fingerprint.as_slice())
            .bind(entry.watermark_id.to_string())
            .execute(&mut *transaction)
            .await?;
            if inserted.rows_affected() == 0 {
                return Err(RegistryError::IdempotencyTaken);
            }
        }
        transaction.commit().await?;
        Ok(())
    }

    async fn record(&self, id: Uuid) -> Result<Option<Record>, RegistryError> {
        let row = sqlx::query("SELECT * FROM watermarks WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.readers)
            .await?;
        row.as_ref().map(record_from_row).transpose()
    }

    async fn records(&self, ids: &[Uuid]) -> Result<Vec<Record>, RegistryError> {
        let rows = sqlx::query(
            "SELECT * FROM watermarks WHERE id IN (SELECT value FROM json_each(?)) ORDER BY id",
        )
        .bind(json_list(ids))
        .fetch_all(&self.readers)
        .await?;
        rows.iter().map(record_from_row).collect()
    }

    async fn page(
        &self,
        filter: &Filter,
        order: Order,
        after: Option<Cursor>,
        limit: u32,
    ) -> Result<Page, RegistryError> {
        page(&self.readers, filter, order, after, limit).await
    }

    async fn counts(&self, owner_id: Option<&str>) -> Result<Counts, RegistryError> {
        counts(&self.readers, owner_id).await
    }

    async fn live_ids(
        &self,
        owner_id: &str,
        after: Option<Uuid>,
        limit: u32,
    ) -> Result<Vec<Uuid>, RegistryError> {
        let rows: Vec<(String,)> = sqlx::query_as(
            "SELECT id FROM watermarks WHERE owner_id = ? AND id > ? AND revoked_at IS NULL
             ORDER BY id LIMIT ?",
        )
        .bind(owner_id)
        .bind(after.map_or_else(String::new, |id| id.to_string()))
        .bind(limit)
        .fetch_all(&self.readers)
        .await?;
        ids_from(rows)
    }

    async fn last_row(&self) -> Result<i64, RegistryError> {
        let (last,): (i64,) = sqlx::query_as("SELECT coalesce(max(rowid), 0) FROM watermarks")
            .fetch_one(&self.readers)
            .await?;
        Ok(last)
    }

    async fn mark_sources(&self, after: i64, last: i64) -> Result<Vec<MarkSource>, RegistryError> {
        let rows = sqlx::query_as(
            "SELECT id, owner_id, method, bits, key_id, salt, message FROM watermarks
             WHERE rowid > ? AND rowid <= ? AND revoked_at IS NULL ORDER BY rowid",
        )
        .bind(after)
        .bind(last)
        .fetch_all(&self.readers)
        .await?;
        rows.into_iter().map(source_from_row).collect()
    }

    async fn keep_sketch(&self, geometry: &[u8; 32], sketch: &[u8]) -> Result<(), RegistryError> {
        sqlx::query(
            "INSERT INTO geometries (geometry, sketch) VALUES (?, ?) ON CONFLICT DO NOTHING",
        )
        .bind(geometry.as_slice())
        .bind(sketch)
        .execute(&self.writer)
        .await?;
        Ok(())
    }

    async fn uses_host(&self, geometry: &[u8; 32]) -> Result<bool, RegistryError> {
        let (used,): (bool,) = sqlx::query_as(
            "SELECT EXISTS (SELECT 1 FROM watermarks WHERE host_geometry = ? AND host_kept)",
        )
        .bind(geometry.as_slice())
        .fetch_one(&self.readers)
        .await?;
        Ok(used)
    }

    async fn sketches(&self, after: i64, limit: u32) -> Result<Vec<HostSketch>, RegistryError> {
        let rows = sqlx::query_as(
            "SELECT rowid, geometry, sketch FROM geometries
             WHERE rowid > ? ORDER BY rowid LIMIT ?",
        )
        .bind(after)
        .bind(limit)
        .fetch_all(&self.readers)
        .await;
        let rows: Vec<(i64, Vec<u8>, Vec<u8>)> = match rows {
            // A service of an earlier release, beside which this one reads, has not made the table.
            Err(error) if is_older_schema(&error) => Vec::new(),
            rows => rows?,
        };
        let sketch = |(row, hash, sketch): (i64, Vec<u8>, Vec<u8>)| {
            let geometry = bytes32(&hash)?;
            Some(HostSketch { row, geometry, sketch })
        };
        Ok(rows.into_iter().filter_map(sketch).collect())
    }

    async fn hosts(&self, after: i64, last: i64) -> Result<Vec<(Uuid, [u8; 32])>, RegistryError> {
        let rows: Vec<(String, Vec<u8>)> = sqlx::query_as(
            "SELECT id, host_geometry FROM watermarks
             WHERE rowid > ? AND rowid <= ? AND revoked_at IS NULL AND host_kept
                 AND host_geometry IS NOT NULL
             ORDER BY rowid",
        )
        .bind(after)
        .bind(last)
        .fetch_all(&self.readers)
        .await
        .or_else(|error| if is_older_schema(&error) { Ok(Vec::new()) } else { Err(error) })?;
        let host = |(id, hash): (String, Vec<u8>)| {
            let bad = |column| bad_row(&id, column);
            Ok((
                id.parse().map_err(|_| bad("id"))?,
                bytes32(&hash).ok_or_else(|| bad("host_geometry"))?,
            ))
        };
        rows.into_iter().map(host).collect()
    }

    async fn host_parents(&self) -> Result<Vec<([u8; 32], [u8; 32])>, RegistryError> {
        sqlite_counts::host_parents(&self.readers).await
    }

    async fn revoke(&self, id: Uuid, at: Timestamp) -> Result<Option<Record>, RegistryError> {
        let row = sqlx::query(
            "UPDATE watermarks SET revoked_at = coalesce(revoked_at, ?) WHERE id = ? RETURNING *",
        )
        .bind(at.as_microsecond())
        .bind(id.to_string())
        .fetch_optional(&self.writer)
        .await?;
        row.as_ref().map(record_from_row).transpose()
    }

    async fn existing(&self, ids: &[Uuid]) -> Result<Vec<Uuid>, RegistryError> {
        let rows: Vec<(String,)> = sqlx::query_as(
            "SELECT id FROM watermarks WHERE id IN (SELECT value FROM json_each(?)) ORDER BY id",
        )
        .bind(json_list(ids))
        .fetch_all(&self.readers)
        .await?;
        ids_from(rows)
    }

    async fn idempotency(
        &self,
        owner_id: &str,
        key: &str,
    ) -> Result<Option<IdempotencyEntry>, RegistryError> {
        let row: Option<(Vec<u8>, String)> = sqlx::query_as(
            "SELECT fingerprint, watermark_id FROM idempotency WHERE owner_id = ? AND key = ?",
        )
        .bind(owner_id)
        .bind(key)
        .fetch_optional(&self.readers)
        .await?;
        row.map(|(fingerprint, id)| {
            Ok(IdempotencyEntry {
                owner_id: owner_id.to_owned(),
                key: key.to_owned(),
                fingerprint: bytes32(&fingerprint).ok_or_else(|| bad_row(&id, "fingerprint"))?,
                watermark_id: id.parse().map_err(|_| bad_row(&id, "watermark_id"))?,
            })
        })
        .transpose()
    }

    async fn refused(
        &self,
        geometry: &[u8; 32],
        owner_id: &str,
        tries: u32,
    ) -> Result<(), RegistryError> {
        sqlite_counts::refused(&self.writer, geometry, owner_id, tries).await
    }

    async fn tally(&self, id: Uuid) -> Result<Tally, RegistryError> {
        sqlite_counts::tally(&self.readers, id).await
    }

    async fn question(&self, id: Uuid, question: &[u8; 32]) -> Result<u64, RegistryError> {
        sqlite_counts::question(&self.readers, id, question).await
    }

    async fn ask(
        &self,
        ids: &[Uuid],
        question: &[u8; 32],
    ) -> Result<Vec<(Uuid, u64)>, RegistryError> {
        sqlite_counts::ask(&self.writer, ids, question).await
    }

    async fn keep_verification(
        &self,
        verification: &StoredVerification,
    ) -> Result<(), RegistryError> {
        sqlx::query("INSERT INTO verifications (id, created_at, answer) VALUES (?, ?, ?)")
            .bind(verification.id.to_string())
            .bind(verification.created_at.as_microsecond())
            .bind(verification.answer.to_string())
            .execute(&self.writer)
            .await?;
        Ok(())
    }

    async fn verification(&self, id: Uuid) -> Result<Option<StoredVerification>, RegistryError> {
        let row: Option<(i64, String)> =
            sqlx::query_as("SELECT created_at, answer FROM verifications WHERE id = ?")
                .bind(id.to_string())
                .fetch_optional(&self.readers)
                .await?;
        row.map(|(created_at, answer)| {
            Ok(StoredVerification {
                id,
                created_at: Timestamp::from_microsecond(created_at)
                    .map_err(|_| bad_row(&id, "created_at"))?,
                answer: serde_json::from_str(&answer).map_err(|_| bad_row(&id, "answer"))?,
            })
        })
        .transpose()
    }

    async fn seen(&self) -> Result<Option<Identity>, RegistryError> {
        self.identity().await
    }

    async fn ping(&self) -> Result<(), RegistryError> {
        sqlx::query("SELECT 1").execute(&self.readers).await?;
        Ok(())
    }

    async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

/// Whether a table or column is missing, because the registry is of an earlier release.
pub(super) fn is_older_schema(error: &sqlx::Error) -> bool {
    let missing = ["no such table", "no such column"];
    let says = |error: &dyn sqlx::error::DatabaseError| {
        missing.iter().any(|text| error.message().starts_with(text))
    };
    error.as_database_error().is_some_and(says)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::contract;
    use super::*;
    use crate::registry::sample_record;
    use crate::relief::Layers;

    #[cfg(unix)]
    #[tokio::test]
    async fn a_new_data_directory_is_its_owner_s_alone() {
        use std::os::unix::fs::PermissionsExt as _;
        let directory = tempfile::tempdir().unwrap();
        let data = directory.path().join("new/data");
        let _registry = Sqlite::open(&data).await.unwrap();
        let mode = std::fs::metadata(&data).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{mode:o}");
    }

    #[tokio::test]
    async fn it_keeps_the_contract() {
        let directory = tempfile::tempdir().unwrap();
        let mut count = 0;
        let mut fresh = || {
            count += 1;
            directory.path().join(count.to_string())
        };
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::pages_are_in_order_and_complete(&registry).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::pages_go_by_registration_whatever_ids_and_clocks_say(&registry).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::a_poller_misses_nothing(Arc::new(registry)).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::revoked_records_are_kept_but_not_live(&registry).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::a_taken_idempotency_key_registers_nothing(&registry).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::verdicts_are_kept(&registry).await;
        contract::many_records_at_once(&registry).await;
        contract::sketches_are_kept_once_per_host(&registry).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::many_writers_at_once(Arc::new(registry)).await;
        let registry = Sqlite::open(&fresh()).await.unwrap();
        contract::tries_and_questions_are_counted(Arc::new(registry)).await;
    }

    /// `VACUUM` may renumber rows; a cursor names a record, not a row.
    #[tokio::test]
    async fn cursors_survive_a_vacuum() {
        let directory = tempfile::tempdir().unwrap();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        let records: Vec<Record> = std::iter::repeat_with(sample_record).take(4).collect();
        for record in &records {
            registry.register(record, None).await.unwrap();
        }
        let page =
            async |order, after| registry.page(&Filter::default(), order, after, 3).await.unwrap();
        let seen = page(Order::Oldest, None).await;
        for id in [records[0].id, records[1].id] {
            sqlx::query("DELETE FROM watermarks WHERE id = ?")
                .bind(id.to_string())
                .execute(&registry.writer)
                .await
                .unwrap();
        }
        sqlx::query("VACUUM").execute(&registry.writer).await.unwrap();
        let rest = page(Order::Oldest, seen.next).await;
        assert_eq!(rest.records, records[3..]);
        let gone = Some(Cursor(records[0].id));
        let refused = registry.page(&Filter::default(), Order::Oldest, gone, 3).await;
        assert!(matches!(refused, Err(RegistryError::ForeignCursor)));
    }

    #[tokio::test]
    async fn records_survive_a_restart() {
        let directory = tempfile::tempdir().unwrap();
        let record = sample_record();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        registry.register(&record, None).await.unwrap();
        assert!(registry.register(&record, None).await.is_err(), "an id is given once");
        registry.close().await;
        drop(registry);
        let registry = Sqlite::open(directory.path()).await.unwrap();
        assert_eq!(registry.record(record.id).await.unwrap(), Some(record.clone()));
        assert_eq!(registry.existing(&[record.id]).await.unwrap(), [record.id]);
        assert_eq!(registry.record(Uuid::now_v7()).await.unwrap(), None);
        registry.ping().await.unwrap();
    }

    #[tokio::test]
    async fn a_registry_of_the_first_release_is_brought_up_to_date() {
        let directory = tempfile::tempdir().unwrap();
        let record = Record {
            quality: None,
            existing_marks: None,
            host_geometry: None,
            layers: Layers::Blind,
            amplitude: None,
            ..sample_record()
        };
        let registry = Sqlite::open(directory.path()).await.unwrap();
        registry.register(&record, None).await.unwrap();
        for statement in [
            "ALTER TABLE watermarks DROP COLUMN quality",
            "ALTER TABLE watermarks DROP COLUMN existing_marks",
            "ALTER TABLE watermarks DROP COLUMN layers",
            "ALTER TABLE watermarks DROP COLUMN amplitude",
            "DROP TRIGGER changes_registered",
            "DROP TRIGGER changes_revoked",
            "DROP TRIGGER changes_verified",
            "DROP TABLE identity",
            "DROP TABLE hosts",
            "DROP INDEX watermarks_by_owner_in_order",
            "DROP TABLE geometries",
            "DROP INDEX watermarks_by_geometry",
            "DROP INDEX watermarks_by_host",
            "ALTER TABLE watermarks DROP COLUMN host_geometry",
            "DROP TABLE tries",
            "DROP TABLE questions",
            "ALTER TABLE watermarks DROP COLUMN refused_before",
            "DELETE FROM _sqlx_migrations WHERE version > 1",
        ] {
            sqlx::query(statement).execute(&registry.writer).await.unwrap();
        }
        let reader = Sqlite::open_to_read(directory.path()).await.unwrap();
        assert_eq!(reader.record(record.id).await.unwrap(), Some(record.clone()));
        assert_eq!(reader.tally(record.id).await.unwrap(), Tally::default());
        reader.close().await;
        registry.close().await;
        drop(registry);
        let registry = Sqlite::open(directory.path()).await.unwrap();
        assert_eq!(registry.record(record.id).await.unwrap(), Some(record));
        registry.register(&sample_record(), None).await.unwrap();
    }

    #[tokio::test]
    async fn one_process_per_directory() {
        let directory = tempfile::tempdir().unwrap();
        let first = Sqlite::open(directory.path()).await.unwrap();
        let error = Sqlite::open(directory.path()).await.unwrap_err();
        assert!(matches!(error, RegistryError::InUse(_)), "{error}");
        drop(first);
        Sqlite::open(directory.path()).await.unwrap();
    }

    #[tokio::test]
    async fn reading_beside_a_writer() {
        let directory = tempfile::tempdir().unwrap();
        let nothing = Sqlite::open_to_read(directory.path()).await.unwrap_err();
        assert!(matches!(nothing, RegistryError::NoRegistry(_)), "{nothing}");
        let writer = Sqlite::open(directory.path()).await.unwrap();
        let reader = Sqlite::open_to_read(directory.path()).await.unwrap();
        let record = sample_record();
        writer.register(&record, None).await.unwrap();
        assert_eq!(reader.record(record.id).await.unwrap(), Some(record));
        assert!(reader.register(&sample_record(), None).await.is_err());
        writer.close().await;
        drop(writer);
        assert_eq!(reader.last_row().await.unwrap(), 1);
    }
}
