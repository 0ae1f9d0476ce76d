//! Pages and counts of records, in `SQL`.
//!
//! Pages go by row number. All rows are written on one connection, so their numbers are in the
//! order of the commits, and a reader sees all commits up to some moment. So no row ever appears
//! below one that was read. A cursor names a record and not its row number, which `VACUUM` may
//! change.

use sqlx::sqlite::SqlitePool;

use super::RegistryError;
use super::record::{Counts, Cursor, Filter, Order, Page};
use super::sqlite_rows::record_from_row;

pub(super) async fn page(
    readers: &SqlitePool,
    filter: &Filter,
    order: Order,
    after: Option<Cursor>,
    limit: u32,
) -> Result<Page, RegistryError> {
    // Both queries see one snapshot.
    let mut reader = readers.begin().await?;
    let after_row = match after {
        None => None,
        Some(Cursor(id)) => {
            let row: Option<(i64,)> = sqlx::query_as("SELECT rowid FROM watermarks WHERE id = ?")
                .bind(id.to_string())
                .fetch_optional(&mut *reader)
                .await?;
            Some(row.ok_or(RegistryError::ForeignCursor)?.0)
        }
    };
    let mut query = sqlx::QueryBuilder::new("SELECT * FROM watermarks WHERE TRUE");
    if let Some(owner_id) = &filter.owner_id {
        query.push(" AND owner_id = ").push_bind(owner_id);
    }
    if let Some(recipient) = &filter.recipient {
        query.push(" AND recipient = ").push_bind(recipient);
    }
    let (beyond, direction) = match order {
        Order::Newest => ("<", "DESC"),
        Order::Oldest => (">", "ASC"),
    };
    if let Some(row) = after_row {
        query.push(format!(" AND rowid {beyond} ")).push_bind(row);
    }
    // One more than requested shows whether there is a next page.
    query.push(format!(" ORDER BY rowid {direction} LIMIT ")).push_bind(i64::from(limit) + 1);
    let rows = query.build().fetch_all(&mut *reader).await?;
    let asked = usize::try_from(limit).unwrap_or(usize::MAX);
    let more = rows.len() > asked;
    let records = rows.iter().take(asked).map(record_from_row).collect::<Result<Vec<_>, _>>()?;
    let last = records.last().map(|record| Cursor(record.id));
    Ok(Page {
        next: last.filter(|_| more),
        resume: last.or(after).filter(|_| order == Order::Oldest),
        records,
    })
}

pub(super) async fn counts(
    readers: &SqlitePool,
    owner_id: Option<&str>,
) -> Result<Counts, RegistryError> {
    let (all, revoked): (i64, i64) = sqlx::query_as(
        "SELECT count(*), count(revoked_at) FROM watermarks WHERE ?1 IS NULL OR owner_id = ?1",
    )
    .bind(owner_id)
    .fetch_one(readers)
    .await?;
    let count = |count: i64| u64::try_from(count).unwrap_or(0);
    Ok(Counts { live: count(all - revoked), revoked: count(revoked) })
}
