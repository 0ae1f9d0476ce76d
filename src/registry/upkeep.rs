//! Queries on a registry that the start of a service and `quadmark check` make, not requests. All
//! of them also work on a registry that is only read and has an older schema.

use std::collections::BTreeSet;

use sqlx::Row as _;
use uuid::Uuid;

use super::sqlite::{Sqlite, ids_from, is_older_schema};
use super::sqlite_rows::{bytes32, record_from_row};
use super::{Record, RegistryError};

/// What a registry holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Survey {
    /// Records, revoked ones included.
    pub records: u64,
    /// The master keys of the records, by their ids.
    pub keys: Vec<KeyUse>,
    /// The identity of the registry; none if its schema is from before identities.
    pub identity: Option<Identity>,
}

/// How many records need a master key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyUse {
    /// The key.
    pub key_id: String,
    /// Number of records that need it.
    pub records: u64,
    /// Number of those records that are not revoked. Without the key, their marks cannot be
    /// searched for.
    pub live: u64,
}

/// The identity of a registry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// A random id, drawn when the registry was made.
    pub id: String,
    /// How often it was written to.
    pub changes: u64,
}

fn count(number: i64) -> u64 {
    u64::try_from(number).unwrap_or(0)
}

/// The default if the table or the column does not exist yet.
fn if_there<T: Default>(found: Result<T, sqlx::Error>) -> Result<T, RegistryError> {
    match found {
        Err(error) if is_older_schema(&error) => Ok(T::default()),
        found => Ok(found?),
    }
}

impl Sqlite {
    /// What the registry holds.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    pub async fn survey(&self) -> Result<Survey, RegistryError> {
        let keys = sqlx::query_as(
            "SELECT key_id, count(*), count(*) FILTER (WHERE revoked_at IS NULL)
             FROM watermarks GROUP BY key_id ORDER BY key_id",
        );
        let keys: Vec<(String, i64, i64)> = if_there(keys.fetch_all(&self.readers).await)?;
        let keys: Vec<KeyUse> = keys
            .into_iter()
            .map(|(key_id, records, live)| KeyUse {
                key_id,
                records: count(records),
                live: count(live),
            })
            .collect();
        let records = keys.iter().map(|key| key.records).sum();
        Ok(Survey { records, keys, identity: self.identity().await? })
    }

    /// The identity of the registry.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    pub async fn identity(&self) -> Result<Option<Identity>, RegistryError> {
        let found = sqlx::query_as("SELECT id, changes FROM identity");
        let found: Option<(String, i64)> = if_there(found.fetch_optional(&self.readers).await)?;
        Ok(found.map(|(id, changes)| Identity { id, changes: count(changes) }))
    }

    /// The geometries that must be in the blob store: those of all records, revoked or not, whose
    /// host is kept.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    pub async fn geometries(&self) -> Result<BTreeSet<[u8; 32]>, RegistryError> {
        let found = sqlx::query_as(
            "SELECT DISTINCT host_geometry FROM watermarks
             WHERE host_geometry IS NOT NULL AND host_kept",
        );
        let found: Vec<(Vec<u8>,)> = if_there(found.fetch_all(&self.readers).await)?;
        Ok(found.iter().filter_map(|(geometry,)| bytes32(geometry)).collect())
    }

    /// Records whose host is stored under the record's id, from before hosts were stored once per
    /// geometry.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    pub async fn hosts_of_their_own(&self) -> Result<Vec<Uuid>, RegistryError> {
        let rows: Vec<(String,)> = sqlx::query_as(
            "SELECT id FROM watermarks WHERE host_geometry IS NULL AND host_kept ORDER BY rowid",
        )
        .fetch_all(&self.readers)
        .await?;
        ids_from(rows)
    }

    /// Notes that a record's host is now stored under its geometry, with the sketch that its file
    /// had.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    pub async fn adopt_host(&self, id: Uuid, geometry: &[u8; 32]) -> Result<(), RegistryError> {
        let mut transaction = self.writer.begin_with("BEGIN IMMEDIATE").await?;
        sqlx::query("UPDATE watermarks SET host_geometry = ? WHERE id = ?")
            .bind(geometry.as_slice())
            .bind(id.to_string())
            .execute(&mut *transaction)
            .await?;
        sqlx::query(
            "INSERT INTO geometries (geometry, sketch)
             SELECT watermarks.host_geometry, hosts.sketch FROM watermarks
             JOIN hosts ON hosts.host_sha256 = watermarks.host_sha256
             WHERE watermarks.id = ? ON CONFLICT DO NOTHING",
        )
        .bind(id.to_string())
        .execute(&mut *transaction)
        .await?;
        Ok(transaction.commit().await?)
    }

    /// At most `limit` records after row `after`, each with its row number. A record that cannot be
    /// read is an error of its own.
    ///
    /// # Errors
    /// [`RegistryError::Database`].
    #[allow(clippy::type_complexity, reason = "a row, and what it holds")]
    pub async fn rows(
        &self,
        after: i64,
        limit: u32,
    ) -> Result<Vec<(i64, Result<Record, RegistryError>)>, RegistryError> {
        let rows = sqlx::query(
            "SELECT rowid AS row_number, * FROM watermarks WHERE rowid > ? ORDER BY rowid LIMIT ?",
        )
        .bind(after)
        .bind(limit)
        .fetch_all(&self.readers)
        .await?;
        rows.iter().map(|row| Ok((row.try_get("row_number")?, record_from_row(row)))).collect()
    }

    /// The faults that the database itself finds in its file.
    ///
    /// # Errors
    /// [`RegistryError::Database`] when the database cannot run its checks.
    pub async fn integrity(&self) -> Result<Vec<String>, RegistryError> {
        let found: Vec<(String,)> =
            sqlx::query_as("PRAGMA integrity_check").fetch_all(&self.readers).await?;
        let mut faults: Vec<String> =
            found.into_iter().map(|(text,)| text).filter(|text| text != "ok").collect();
        let broken = sqlx::query("PRAGMA foreign_key_check").fetch_all(&self.readers).await?;
        for row in broken {
            let (table, target): (String, String) = (row.try_get(0)?, row.try_get(2)?);
            faults.push(format!("a row of {table} names a row of {target} that is not there"));
        }
        Ok(faults)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Registry as _, StoredVerification, sample_record};
    use super::*;

    #[tokio::test]
    async fn what_it_holds_and_how_often_it_was_written_to() {
        let directory = tempfile::tempdir().unwrap();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        let empty = registry.survey().await.unwrap();
        let identity = empty.identity.clone().unwrap();
        assert_eq!((empty.records, empty.keys.len(), identity.changes), (0, 0, 0));
        assert_eq!(identity.id.len(), 32);
        let of = |key: &str, last| Record { key_id: key.to_owned(), ..with_geometry(last) };
        let records = [of("aaaaaaaa", 1), of("aaaaaaaa", 1), of("bbbbbbbb", 2)];
        for record in &records {
            registry.register(record, None).await.unwrap();
        }
        registry.revoke(records[0].id, jiff::Timestamp::now()).await.unwrap();
        let verification = StoredVerification {
            id: Uuid::now_v7(),
            created_at: jiff::Timestamp::now(),
            answer: serde_json::json!({}),
        };
        registry.keep_verification(&verification).await.unwrap();
        let survey = registry.survey().await.unwrap();
        let key = |key: &str, records, live| KeyUse { key_id: key.to_owned(), records, live };
        assert_eq!(survey.keys, [key("aaaaaaaa", 2, 1), key("bbbbbbbb", 1, 1)]);
        assert_eq!(survey.identity, Some(Identity { id: identity.id, changes: 5 }));
        let expected = BTreeSet::from([[1; 32], [2; 32]]);
        assert_eq!(registry.geometries().await.unwrap(), expected, "revoked records count");
        assert!(registry.integrity().await.unwrap().is_empty());
        let rows = registry.rows(0, 2).await.unwrap();
        assert_eq!(rows.len(), 2);
        let rest = registry.rows(rows[1].0, 2).await.unwrap();
        assert_eq!(rest[0].1.as_ref().unwrap().id, records[2].id);
    }

    /// Measures the cost of a durable commit, beside that of a commit that a power cut may lose. If
    /// both are the same, the file system does not sync.
    #[tokio::test]
    #[ignore = "a measurement"]
    async fn what_a_commit_costs() {
        let directory = tempfile::tempdir_in(env!("CARGO_MANIFEST_DIR")).unwrap();
        let registry = Sqlite::open(directory.path()).await.unwrap();
        for mode in ["FULL", "NORMAL", "FULL", "NORMAL"] {
            let pragma = sqlx::AssertSqlSafe(format!("PRAGMA synchronous = {mode}"));
            sqlx::query(pragma).execute(&registry.writer).await.unwrap();
            let mut times = Vec::new();
            for _ in 0..400 {
                let record = sample_record();
                let start = std::time::Instant::now();
                registry.register(&record, None).await.unwrap();
                times.push(start.elapsed());
            }
            times.sort();
            println!("{mode}: median {:?}, 99th percentile {:?}", times[200], times[396]);
        }
    }

    fn with_geometry(last: u8) -> Record {
        Record { host_kept: true, host_geometry: Some([last; 32]), ..sample_record() }
    }
}
