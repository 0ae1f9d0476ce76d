//! Counts and relations beside single records: refused tries, questions, and the descent of hosts.
//!
//! Counts are changed by single statements or within the caller's transaction, so that no count is
//! lost when many requests count at once.

use sqlx::sqlite::{SqliteConnection, SqlitePool};
use uuid::Uuid;

use super::RegistryError;
use super::record::{Record, Tally};
use super::sqlite_rows::{bad_row, bytes32};

fn whole(id: Uuid, count: i64) -> Result<u64, RegistryError> {
    u64::try_from(count).map_err(|_| bad_row(&id, "a count"))
}

/// Adds to the refused tries of a host and owner.
pub(super) async fn refused(
    writer: &SqlitePool,
    geometry: &[u8; 32],
    owner_id: &str,
    tries: u32,
) -> Result<(), RegistryError> {
    sqlx::query(
        "INSERT INTO tries (geometry, owner_id, refused) VALUES (?, ?, ?)
         ON CONFLICT DO UPDATE SET refused = refused + excluded.refused",
    )
    .bind(geometry.as_slice())
    .bind(owner_id)
    .bind(i64::from(tries))
    .execute(writer)
    .await?;
    Ok(())
}

/// Moves the refused tries of its host and owner to a record that was just inserted.
pub(super) async fn take_refused(
    connection: &mut SqliteConnection,
    record: &Record,
) -> Result<(), RegistryError> {
    let taken: Option<(i64,)> =
        sqlx::query_as("DELETE FROM tries WHERE geometry = ? AND owner_id = ? RETURNING refused")
            .bind(record.host_geometry.unwrap_or(record.host_sha256).as_slice())
            .bind(&record.owner_id)
            .fetch_optional(&mut *connection)
            .await?;
    if let Some((refused,)) = taken {
        sqlx::query("UPDATE watermarks SET refused_before = ? WHERE id = ?")
            .bind(refused)
            .bind(record.id.to_string())
            .execute(connection)
            .await?;
    }
    Ok(())
}

/// The counts that a record's bound is charged for.
pub(super) async fn tally(readers: &SqlitePool, id: Uuid) -> Result<Tally, RegistryError> {
    let row: Option<(i64, i64, i64, i64)> = sqlx::query_as(
        "SELECT own.refused_before,
             count(*), count(other.revoked_at),
             coalesce((SELECT max(nth) FROM questions WHERE watermark_id = own.id), 0)
         FROM watermarks own JOIN watermarks other
             ON coalesce(other.host_geometry, other.host_sha256)
                 = coalesce(own.host_geometry, own.host_sha256)
             AND other.owner_id = own.owner_id
         WHERE own.id = ? GROUP BY own.id",
    )
    .bind(id.to_string())
    .fetch_optional(readers)
    .await
    .or_else(nothing_counted)?;
    let Some((refused, all, revoked, asked)) = row else { return Ok(Tally::default()) };
    Ok(Tally {
        refused_before: whole(id, refused)?,
        siblings: whole(id, all - 1)?,
        revoked_siblings: whole(id, revoked)?.min(whole(id, all - 1)?),
        asked: whole(id, asked)?,
    })
}

/// Nothing is counted if the tables are missing, because the registry is of an earlier release.
fn nothing_counted<T>(error: sqlx::Error) -> Result<Option<T>, sqlx::Error> {
    let message = error.as_database_error().map(|error| error.message().to_owned());
    let is_older =
        message.is_some_and(|m| m.contains("no such table") || m.contains("no such column"));
    if is_older { Ok(None) } else { Err(error) }
}

/// The number of this question about a record, or the number that it would get now.
pub(super) async fn question(
    readers: &SqlitePool,
    id: Uuid,
    question: &[u8; 32],
) -> Result<u64, RegistryError> {
    let row: Option<(i64,)> = sqlx::query_as(
        "SELECT coalesce(
             (SELECT nth FROM questions WHERE watermark_id = ?1 AND question = ?2),
             (SELECT coalesce(max(nth), 0) + 1 FROM questions WHERE watermark_id = ?1)
         )",
    )
    .bind(id.to_string())
    .bind(question.as_slice())
    .fetch_optional(readers)
    .await
    .or_else(nothing_counted)?;
    row.map_or(Ok(1), |(nth,)| whole(id, nth))
}

/// Counts a question about each of these records, unless it was counted before. Returns the number
/// of the question for each record.
pub(super) async fn ask(
    writer: &SqlitePool,
    ids: &[Uuid],
    question: &[u8; 32],
) -> Result<Vec<(Uuid, u64)>, RegistryError> {
    let rows: Vec<(String, i64)> = sqlx::query_as(
        "INSERT INTO questions (watermark_id, question, nth)
             SELECT value, ?2,
                 1 + coalesce((SELECT max(nth) FROM questions WHERE watermark_id = value), 0)
             FROM json_each(?1) WHERE true
         ON CONFLICT DO UPDATE SET nth = nth RETURNING watermark_id, nth",
    )
    .bind(serde_json::json!(ids).to_string())
    .bind(question.as_slice())
    .fetch_all(writer)
    .await?;
    let row = |(id, asked): (String, i64)| {
        let id: Uuid = id.parse().map_err(|_| bad_row(&id, "watermark_id"))?;
        Ok((id, whole(id, asked)?))
    };
    rows.into_iter().map(row).collect()
}

/// Pairs of a host and a host whose mark it carried.
pub(super) async fn host_parents(
    readers: &SqlitePool,
) -> Result<Vec<([u8; 32], [u8; 32])>, RegistryError> {
    let rows: Vec<(Vec<u8>, Vec<u8>)> = sqlx::query_as(
        "SELECT DISTINCT own.host_geometry, older.host_geometry
         FROM watermarks own, json_each(own.existing_marks) mark
         JOIN watermarks older ON older.id = json_extract(mark.value, '$.watermark_id')
         WHERE own.host_geometry <> older.host_geometry",
    )
    .fetch_all(readers)
    .await
    .map(Some)
    .or_else(nothing_counted)?
    .unwrap_or_default();
    let row = |(host, parent): (Vec<u8>, Vec<u8>)| Some((bytes32(&host)?, bytes32(&parent)?));
    Ok(rows.into_iter().filter_map(row).collect())
}
