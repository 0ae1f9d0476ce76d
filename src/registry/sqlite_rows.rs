//! Converts records to `SQLite` rows and back.
//!
//! The values of a row are parsed, not trusted: a value that this version does not know is an error
//! that names the row and the column.

use std::fmt::Display;

use glam::DVec3;
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::RegistryError;
use super::record::{MarkSource, Record};
use crate::formats::Format;
use crate::relief::{Amplitude, Layers};
use crate::watermark::{BitCount, Frame, Strength};

pub(super) fn bad_row(id: &impl Display, column: &str) -> RegistryError {
    let reason = format!("column {column} holds a value that this version cannot read");
    RegistryError::BadRow { id: id.to_string(), reason }
}

pub(super) fn bytes32(bytes: &[u8]) -> Option<[u8; 32]> {
    bytes.try_into().ok()
}

pub(super) async fn insert_record(
    connection: &mut SqliteConnection,
    record: &Record,
) -> Result<(), RegistryError> {
    let quality = record.quality.as_ref().map(serde_json::to_string).transpose();
    let quality = quality.map_err(|_| bad_row(&record.id, "quality"))?;
    let existing = record.existing_marks.as_ref().map(serde_json::to_string).transpose();
    let existing = existing.map_err(|_| bad_row(&record.id, "existing_marks"))?;
    let whole = |count: u64, column| i64::try_from(count).map_err(|_| bad_row(&record.id, column));
    sqlx::query(
        "INSERT INTO watermarks (id, owner_id, recipient, label, method, scheme, strength, bits,
             key_id, salt, message, payload, centre_x, centre_y, centre_z, rho_min, rho_max,
             host_sha256, marked_sha256, marked_bytes, format, file_name, vertices, triangles,
             usable_bins, file_kept, host_kept, created_at, revoked_at, quality, existing_marks,
             host_geometry, layers, amplitude)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?,
             ?, ?)",
    )
    .bind(record.id.to_string())
    .bind(&record.owner_id)
    .bind(&record.recipient)
    .bind(&record.label)
    .bind(record.method.to_string())
    .bind(i64::from(record.scheme))
    .bind(record.strength.get())
    .bind(whole(record.bits.get() as u64, "bits")?)
    .bind(&record.key_id)
    .bind(record.salt.as_slice())
    .bind(record.message.as_slice())
    .bind(record.payload.as_deref())
    .bind(record.frame.centre.x)
    .bind(record.frame.centre.y)
    .bind(record.frame.centre.z)
    .bind(record.frame.rho_min)
    .bind(record.frame.rho_max)
    .bind(record.host_sha256.as_slice())
    .bind(record.marked_sha256.as_slice())
    .bind(whole(record.marked_bytes, "marked_bytes")?)
    .bind(record.format.extension())
    .bind(&record.file_name)
    .bind(whole(record.vertices, "vertices")?)
    .bind(whole(record.triangles, "triangles")?)
    .bind(i64::from(record.usable_bins))
    .bind(record.file_kept)
    .bind(record.host_kept)
    .bind(record.created_at.as_microsecond())
    .bind(record.revoked_at.map(Timestamp::as_microsecond))
    .bind(quality)
    .bind(existing)
    .bind(record.host_geometry.as_ref().map(<[u8; 32]>::as_slice))
    .bind(record.layers.name())
    .bind(record.amplitude.map(Amplitude::get))
    .execute(connection)
    .await?;
    Ok(())
}

/// The columns of a mark's source: id, owner, method, bits, key, salt, message.
pub(super) type SourceRow = (String, String, String, i64, String, Vec<u8>, Vec<u8>);

pub(super) fn source_from_row(row: SourceRow) -> Result<MarkSource, RegistryError> {
    let (id, owner_id, method, bits, key_id, salt, message) = row;
    let bits = u32::try_from(bits).ok().and_then(|bits| BitCount::new(bits).ok());
    Ok(MarkSource {
        owner_id,
        method: method.parse().map_err(|_| bad_row(&id, "method"))?,
        bits: bits.ok_or_else(|| bad_row(&id, "bits"))?,
        key_id,
        salt: bytes32(&salt).ok_or_else(|| bad_row(&id, "salt"))?,
        message,
        id: id.parse().map_err(|_| bad_row(&id, "id"))?,
    })
}

pub(super) fn record_from_row(row: &SqliteRow) -> Result<Record, RegistryError> {
    let id_text: String = row.try_get("id")?;
    let bad = |column| bad_row(&id_text, column);
    let unsigned = |column| u64::try_from(row.try_get::<i64, _>(column)?).map_err(|_| bad(column));
    let hash = |column| bytes32(&row.try_get::<Vec<u8>, _>(column)?).ok_or_else(|| bad(column));
    let time =
        |microseconds, column| Timestamp::from_microsecond(microseconds).map_err(|_| bad(column));
    let bits = u32::try_from(unsigned("bits")?).map_err(|_| bad("bits"))?;
    let format: String = row.try_get("format")?;
    let method: String = row.try_get("method")?;
    Ok(Record {
        id: id_text.parse().map_err(|_| bad("id"))?,
        owner_id: row.try_get("owner_id")?,
        recipient: row.try_get("recipient")?,
        label: row.try_get("label")?,
        method: method.parse().map_err(|_| bad("method"))?,
        scheme: u16::try_from(unsigned("scheme")?).map_err(|_| bad("scheme"))?,
        layers: layers(row, &id_text)?,
        amplitude: amplitude(row, &id_text)?,
        strength: Strength::new(row.try_get("strength")?).map_err(|_| bad("strength"))?,
        bits: BitCount::new(bits).map_err(|_| bad("bits"))?,
        key_id: row.try_get("key_id")?,
        salt: hash("salt")?,
        message: row.try_get("message")?,
        payload: row.try_get("payload")?,
        frame: Frame {
            centre: DVec3::new(
                row.try_get("centre_x")?,
                row.try_get("centre_y")?,
                row.try_get("centre_z")?,
            ),
            rho_min: row.try_get("rho_min")?,
            rho_max: row.try_get("rho_max")?,
        },
        host_sha256: hash("host_sha256")?,
        host_geometry: geometry(row, &id_text)?,
        marked_sha256: hash("marked_sha256")?,
        marked_bytes: unsigned("marked_bytes")?,
        format: format_from_name(&format).ok_or_else(|| bad("format"))?,
        file_name: row.try_get("file_name")?,
        vertices: unsigned("vertices")?,
        triangles: unsigned("triangles")?,
        usable_bins: u32::try_from(unsigned("usable_bins")?).map_err(|_| bad("usable_bins"))?,
        quality: json(row, "quality", &id_text)?,
        existing_marks: json(row, "existing_marks", &id_text)?,
        file_kept: row.try_get("file_kept")?,
        host_kept: row.try_get("host_kept")?,
        created_at: time(row.try_get("created_at")?, "created_at")?,
        revoked_at: row
            .try_get::<Option<i64>, _>("revoked_at")?
            .map(|at| time(at, "revoked_at"))
            .transpose()?,
    })
}

/// A value of a column that was added after the first release; none if the registry is read beside
/// a service of an earlier release that has not added the column.
fn added<'r, T: sqlx::Decode<'r, sqlx::Sqlite> + sqlx::Type<sqlx::Sqlite>>(
    row: &'r SqliteRow,
    column: &str,
) -> Result<Option<T>, RegistryError> {
    match row.try_get::<Option<T>, _>(column) {
        Err(sqlx::Error::ColumnNotFound(_)) => Ok(None),
        found => Ok(found?),
    }
}

fn layers(row: &SqliteRow, id: &str) -> Result<Layers, RegistryError> {
    let name = added::<String>(row, "layers")?;
    let parsed = name.as_deref().map_or(Ok(Layers::Blind), str::parse);
    parsed.map_err(|_| bad_row(&id, "layers"))
}

fn amplitude(row: &SqliteRow, id: &str) -> Result<Option<Amplitude>, RegistryError> {
    let share = added::<f64>(row, "amplitude")?;
    share.map(Amplitude::new).transpose().map_err(|_| bad_row(&id, "amplitude"))
}

fn geometry(row: &SqliteRow, id: &str) -> Result<Option<[u8; 32]>, RegistryError> {
    let bytes = added::<Vec<u8>>(row, "host_geometry")?;
    let key = |bytes: Vec<u8>| bytes32(&bytes).ok_or_else(|| bad_row(&id, "host_geometry"));
    bytes.map(key).transpose()
}

/// The JSON of a column that the first release did not have.
fn json<T: DeserializeOwned>(
    row: &SqliteRow,
    column: &str,
    id: &str,
) -> Result<Option<T>, RegistryError> {
    let text = added::<String>(row, column)?;
    text.as_deref().map(serde_json::from_str).transpose().map_err(|_| bad_row(&id, column))
}

fn format_from_name(name: &str) -> Option<Format> {
    Format::ALL.into_iter().find(|format| format.extension() == name)
}

#[cfg(test)]
pub(crate) fn sample_record() -> Record {
    Record {
        id: uuid::Uuid::now_v7(),
        owner_id: "acme".to_owned(),
        recipient: Some("studio \u{2764} 'quoted'".to_owned()),
        label: None,
        method: "qsp-mean".parse().unwrap(),
        scheme: 1,
        layers: Layers::Both,
        amplitude: Some(Amplitude::new(1.0 / 30_000.0).unwrap()),
        strength: Strength::new(0.1).unwrap(),
        bits: BitCount::new(64).unwrap(),
        key_id: "0a1b2c3d".to_owned(),
        salt: [5; 32],
        message: vec![1, 2, 3, 4, 5, 6, 7, 8],
        payload: Some(vec![1, 2]),
        // Decimal text would lose the last bits of these values.
        frame: Frame {
            centre: DVec3::new(0.1 + 0.2, -1.0e-300, 1.0 / 3.0),
            rho_min: f64::MIN_POSITIVE,
            rho_max: 1.7e308,
        },
        host_sha256: [1; 32],
        host_geometry: Some([3; 32]),
        marked_sha256: [2; 32],
        marked_bytes: 1 << 40,
        format: Format::Glb,
        file_name: Some("a.glb".to_owned()),
        vertices: 20_000,
        triangles: 40_000,
        usable_bins: 64,
        quality: Some(super::Quality {
            mrms: 0.1 + 0.2,
            hausdorff: 1.0 / 3.0,
            max_displacement: 1e-300,
            normal_deviation_degrees: 0.25,
            flipped: 1 << 40,
            method_used: "qsp-mean".to_owned(),
            more_decimals: Some(7),
        }),
        existing_marks: Some(vec![super::ExistingMark {
            watermark_id: uuid::Uuid::nil(),
            owner_id: "other".to_owned(),
            log10_fp: -1.0 / 3.0,
        }]),
        file_kept: true,
        host_kept: false,
        created_at: Timestamp::from_microsecond(1_790_000_000_123_456).unwrap(),
        revoked_at: None,
    }
}
