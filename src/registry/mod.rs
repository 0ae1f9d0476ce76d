//! The registry: which marks exist, and what is needed to recognise them.
//!
//! [`Registry`] is what the service needs of a database. [`Sqlite`] is the implementation that
//! needs nothing installed. This is the only module that knows SQL. It must not know about HTTP,
//! about files, or about keys: a record names its master key by id and holds its salt, nothing
//! more.

#[cfg(test)]
mod contract;
mod record;
mod sqlite;
mod sqlite_counts;
mod sqlite_pages;
mod sqlite_rows;
mod upkeep;

use async_trait::async_trait;
use uuid::Uuid;

pub use record::{
    Counts, Cursor, ExistingMark, Filter, HostSketch, IdempotencyEntry, MarkSource, Order, Page,
    Quality, Record, StoredVerification, Tally,
};
pub use sqlite::{Lock, Sqlite};
#[cfg(test)]
pub(crate) use sqlite_rows::sample_record;
pub use upkeep::{Identity, KeyUse, Survey};

/// Why the registry could not do what was requested.
#[derive(Debug, thiserror::Error)]
pub enum RegistryError {
    /// Another process has the data directory open.
    #[error(
        "the data directory {0} is in use by another quadmark process; stop that one first, or \
         choose another directory with --data (one process per data directory: each keeps its \
         own index of marks in memory)"
    )]
    InUse(String),
    /// The data directory cannot be used.
    #[error("the data directory {path} cannot be used: {source}")]
    Directory {
        /// The directory.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// There is no registry to read.
    #[error(
        "there is no registry in the directory {0}; name with --data the data directory of a \
         service (it holds registry.sqlite)"
    )]
    NoRegistry(String),
    /// The cursor was not given with a page of this registry.
    #[error("the cursor is not of this registry")]
    ForeignCursor,
    /// The idempotency key was used meanwhile, by a request that ran at the same time.
    #[error("the idempotency key was used by another request in the meantime")]
    IdempotencyTaken,
    /// A row that this version cannot read.
    #[error("registry row {id}: {reason}")]
    BadRow {
        /// The row.
        id: String,
        /// Which column, and why.
        reason: String,
    },
    /// The database refused or failed.
    #[error("registry: {0}")]
    Database(#[from] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("registry schema: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
}

impl RegistryError {
    /// Whether the database has no room: `SQLITE_FULL`.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let Self::Database(error) = self else { return false };
        let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code);
        code.as_deref() == Some("13")
    }
}

/// The functions that the service needs of a registry. Every function is one transaction.
#[async_trait]
pub trait Registry: Send + Sync {
    /// Registers a record together with its idempotency key, if it has one.
    async fn register(
        &self,
        record: &Record,
        idempotency: Option<&IdempotencyEntry>,
    ) -> Result<(), RegistryError>;

    /// One record, revoked or not.
    async fn record(&self, id: Uuid) -> Result<Option<Record>, RegistryError>;

    /// Those of these records that exist, revoked or not, ordered by id.
    async fn records(&self, ids: &[Uuid]) -> Result<Vec<Record>, RegistryError>;

    /// A page of records in the order of their registration, revoked ones included.
    ///
    /// # Errors
    /// [`RegistryError::ForeignCursor`] when the record that `after` names does not exist.
    async fn page(
        &self,
        filter: &Filter,
        order: Order,
        after: Option<Cursor>,
        limit: u32,
    ) -> Result<Page, RegistryError>;

    /// Number of records, of one owner if one is named.
    async fn counts(&self, owner_id: Option<&str>) -> Result<Counts, RegistryError>;

    /// At most `limit` ids greater than `after` of an owner's records that are not revoked, ordered
    /// by id.
    async fn live_ids(
        &self,
        owner_id: &str,
        after: Option<Uuid>,
        limit: u32,
    ) -> Result<Vec<Uuid>, RegistryError>;

    /// Number of the last row. Rows are numbered from 1 in the order of registration, perhaps with
    /// gaps.
    async fn last_row(&self) -> Result<i64, RegistryError>;

    /// The sources of the codewords of all records that are not revoked, of the rows from `after`
    /// (exclusive) to `last` (inclusive), in order.
    async fn mark_sources(&self, after: i64, last: i64) -> Result<Vec<MarkSource>, RegistryError>;

    /// Stores the sketch of a host's geometry, once per geometry.
    async fn keep_sketch(&self, geometry: &[u8; 32], sketch: &[u8]) -> Result<(), RegistryError>;

    /// Whether any record, revoked or not, uses the stored host of this geometry.
    async fn uses_host(&self, geometry: &[u8; 32]) -> Result<bool, RegistryError>;

    /// At most `limit` sketches that were stored after row `after`, in order.
    async fn sketches(&self, after: i64, limit: u32) -> Result<Vec<HostSketch>, RegistryError>;

    /// The records that are not revoked and whose host is kept, each with its host's geometry, of
    /// the rows from `after` (exclusive) to `last` (inclusive).
    async fn hosts(&self, after: i64, last: i64) -> Result<Vec<(Uuid, [u8; 32])>, RegistryError>;

    /// The descent of hosts: pairs of a host that carried a mark and the host of that mark, by
    /// their geometries.
    async fn host_parents(&self) -> Result<Vec<([u8; 32], [u8; 32])>, RegistryError>;

    /// Revokes a record, if it is not revoked already. Returns the record as it is then.
    async fn revoke(&self, id: Uuid, at: jiff::Timestamp) -> Result<Option<Record>, RegistryError>;

    /// Those of these ids that have a record, ordered: for the sweep of blobs that no record owns.
    async fn existing(&self, ids: &[Uuid]) -> Result<Vec<Uuid>, RegistryError>;

    /// The fingerprint and the record of an owner's idempotency key.
    async fn idempotency(
        &self,
        owner_id: &str,
        key: &str,
    ) -> Result<Option<IdempotencyEntry>, RegistryError>;

    /// Counts refused tries for an owner and a host, named by its geometry. The next record that is
    /// registered for the two takes the count over ([`Tally::refused_before`]).
    async fn refused(
        &self,
        geometry: &[u8; 32],
        owner_id: &str,
        tries: u32,
    ) -> Result<(), RegistryError>;

    /// The counts that a record's bound is charged for; zeros if the record does not exist.
    async fn tally(&self, id: Uuid) -> Result<Tally, RegistryError>;

    /// The number of this question about a record, from 1, or the number that it would get now.
    async fn question(&self, id: Uuid, question: &[u8; 32]) -> Result<u64, RegistryError>;

    /// Counts a question about each of these records, durably, unless it was counted before.
    /// Returns the number of the question for each record.
    async fn ask(
        &self,
        ids: &[Uuid],
        question: &[u8; 32],
    ) -> Result<Vec<(Uuid, u64)>, RegistryError>;

    /// Stores a verdict.
    async fn keep_verification(
        &self,
        verification: &StoredVerification,
    ) -> Result<(), RegistryError>;

    /// A verdict as it was answered.
    async fn verification(&self, id: Uuid) -> Result<Option<StoredVerification>, RegistryError>;

    /// The identity of the registry, with the number of changes that it has seen.
    async fn seen(&self) -> Result<Option<Identity>, RegistryError>;

    /// Whether the registry answers.
    async fn ping(&self) -> Result<(), RegistryError>;

    /// Closes all connections. What was written is on the disk.
    async fn close(&self);
}
