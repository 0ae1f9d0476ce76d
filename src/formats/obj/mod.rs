//! Wavefront OBJ: which `v` lines there are, what surface they span, and where their coordinates
//! stand in the bytes.
//!
//! Reading order: `cursor` (logical lines and tokens), `number` (one coordinate), `corner` (one
//! face index), `fault` (what is wrong with a line), `chunk` (whole lines that are parsed
//! together), `parse` (all chunks, in parallel), `precision` (how a moved coordinate is rounded and
//! spelled), `layout` (patching the bytes).
//!
//! Must not know about watermarks or other formats. Never opens a file that an OBJ names (`mtllib`,
//! `call`, `maplib`).

mod chunk;
mod corner;
mod cursor;
mod fault;
mod layout;
mod number;
mod parse;
mod precision;
#[cfg(test)]
mod properties;

pub(super) use cursor::{Cursor, Statement};
pub(super) use layout::Layout;

use super::{FormatError, Limits, Stop};
use crate::mesh::Mesh;

/// Bytes that one task parses. Small enough to keep all cores busy on a file of a few megabytes,
/// large enough that starting a task costs nothing beside it.
const CHUNK_BYTES: usize = 1 << 20;

/// Reads every `v` line as a vertex, in file order, and every `f` line as a fan of triangles.
///
/// # Errors
/// [`FormatError::MalformedObj`] and [`FormatError::NonFiniteVertex`] with the physical line,
/// [`FormatError::TooLarge`] over a limit, [`FormatError::NoTriangles`] without a surface.
pub(super) fn read(
    bytes: &[u8],
    limits: &Limits,
    stop: Stop<'_>,
) -> Result<(Mesh, Layout), FormatError> {
    read_in_chunks(bytes, limits, CHUNK_BYTES, stop)
}

fn read_in_chunks(
    bytes: &[u8],
    limits: &Limits,
    chunk_bytes: usize,
    stop: Stop<'_>,
) -> Result<(Mesh, Layout), FormatError> {
    let parsed = parse::parse(bytes, limits, chunk_bytes, stop)?;
    let mesh = Mesh::new(parsed.positions, parsed.triangles)?;
    let layout = Layout::new(&mesh, parsed.offsets, parsed.fewest_decimals, bytes.len(), stop);
    Ok((mesh, layout.ok_or(FormatError::Cancelled)?))
}
