//! The host's bytes with pieces of JSON text replaced, and with a new BIN chunk.
//!
//! Must not know what the pieces mean. The JSON chunk's padding absorbs what it can; the GLB's
//! lengths change only when it cannot.

use std::ops::Range;

use super::container::Container;
use super::write::read_back;
use crate::formats::FormatError;

/// A span of the file and what replaces it.
pub(super) type Splice = (Range<usize>, String);

/// The file with its splices, its JSON padding and lengths, and its BIN chunk if that changed.
pub(super) fn assemble(
    container: &Container,
    bytes: &[u8],
    new_bin: Option<&[u8]>,
    splices: &[Splice],
) -> Result<Vec<u8>, FormatError> {
    let grown: usize = splices.iter().map(|(_, text)| text.len()).sum();
    let mut out = Vec::with_capacity(bytes.len().saturating_add(grown).saturating_add(4));
    let mut from = 0;
    for (span, text) in splices {
        out.extend_from_slice(bytes.get(from..span.start).unwrap_or_default());
        out.extend_from_slice(text.as_bytes());
        from = span.end;
    }
    out.extend_from_slice(bytes.get(from..container.json.end).unwrap_or_default());
    let Some(chunk) = &container.json_chunk else {
        out.extend_from_slice(bytes.get(container.json.end..).unwrap_or_default());
        return Ok(out);
    };
    let padding = bytes.get(container.json.end..chunk.end).unwrap_or_default();
    if out.len() == container.json.end {
        out.extend_from_slice(padding);
    } else {
        // The chunk keeps its length while the text fits; beyond that, its length is a multiple of
        // four.
        let length = out.len().saturating_sub(chunk.start).next_multiple_of(4);
        let end = chunk.start.saturating_add(length.max(chunk.len()));
        out.resize(end, b' ');
        if end > chunk.end {
            let more = end - chunk.end;
            add_to_length(&mut out, 8, more)?;
            add_to_length(&mut out, 12, more)?;
        }
    }
    let shift = out.len().saturating_sub(chunk.end);
    out.extend_from_slice(bytes.get(chunk.end..).unwrap_or_default());
    if let (Some(new), Some(bin)) = (new_bin, &container.bin) {
        let place = bin.start.saturating_add(shift)..bin.end.saturating_add(shift);
        match out.get_mut(place) {
            Some(slot) if slot.len() == new.len() => slot.copy_from_slice(new),
            _ => return Err(read_back("the BIN chunk was not found again")),
        }
    }
    Ok(out)
}

/// Adds to one of the GLB's 32-bit lengths.
fn add_to_length(out: &mut [u8], at: usize, more: usize) -> Result<(), FormatError> {
    let slot = out.get_mut(at..).and_then(<[u8]>::first_chunk_mut::<4>);
    let slot = slot.ok_or_else(|| read_back("the GLB header was not found again"))?;
    let length = u32::try_from(more).ok().and_then(|m| u32::from_le_bytes(*slot).checked_add(m));
    let length = length.ok_or_else(|| FormatError::CannotPatch {
        path: "GLB header".to_owned(),
        reason: "with its new bounds the file would be longer than 4 GiB: split the asset"
            .to_owned(),
    })?;
    *slot = length.to_le_bytes();
    Ok(())
}
