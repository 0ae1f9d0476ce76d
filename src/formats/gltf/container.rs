//! The outermost layer: where the JSON text and the binary chunk stand in the file.
//!
//! Must not know what the JSON says. Chunks of unknown types are skipped and kept.

use std::ops::Range;

use super::malformed;
use crate::formats::{Format, FormatError};

const MAGIC: &[u8] = b"glTF";
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Where things stand in the file, as byte ranges of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Container {
    /// The JSON text without padding or byte order mark.
    pub(super) json: Range<usize>,
    /// The whole content of the JSON chunk, padding included; `None` for a `.gltf` file.
    pub(super) json_chunk: Option<Range<usize>>,
    /// The content of the BIN chunk.
    pub(super) bin: Option<Range<usize>>,
}

/// Splits a file into JSON text and BIN chunk.
pub(super) fn split(bytes: &[u8], format: Format) -> Result<Container, FormatError> {
    if format != Format::Glb {
        let start = if bytes.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
        let json = trim(bytes, start..bytes.len());
        return Ok(Container { json, json_chunk: None, bin: None });
    }
    if !bytes.starts_with(MAGIC) {
        return Err(malformed("GLB header", "the file does not start with glTF"));
    }
    let version = word(bytes, 4).ok_or_else(truncated)?;
    if version != 2 {
        return Err(malformed(
            "GLB header",
            format!("version {version} is not supported: export the asset as glTF 2.0"),
        ));
    }
    let total = word(bytes, 8).and_then(size).ok_or_else(truncated)?;
    // A file that was cut short must never be half-read: its declared length shows it.
    if total > bytes.len() {
        return Err(malformed(
            "GLB header",
            format!(
                "it declares {total} bytes, the file has {}: it was cut short, upload it again",
                bytes.len()
            ),
        ));
    }
    let (kind, json_chunk) = chunk(bytes, 12, total)?;
    if kind != JSON_CHUNK {
        return Err(malformed("GLB chunk", "the first chunk must be the JSON chunk"));
    }
    let mut bin = None;
    let mut at = json_chunk.end;
    while at < total {
        let (kind, content) = chunk(bytes, at, total)?;
        at = content.end;
        if kind == BIN_CHUNK && bin.is_none() {
            bin = Some(content);
        }
    }
    let json = trim(bytes, json_chunk.clone());
    Ok(Container { json, json_chunk: Some(json_chunk), bin })
}

fn truncated() -> FormatError {
    malformed("GLB header", "the header is cut short: upload the file again")
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}

fn size(word: u32) -> Option<usize> {
    usize::try_from(word).ok()
}

fn chunk(bytes: &[u8], at: usize, total: usize) -> Result<(u32, Range<usize>), FormatError> {
    let read = || {
        let length = size(word(bytes, at)?)?;
        let kind = word(bytes, at.checked_add(4)?)?;
        let start = at.checked_add(8)?;
        let end = start.checked_add(length)?;
        (end <= total).then_some((kind, start..end))
    };
    read().ok_or_else(|| malformed("GLB chunk", format!("the chunk at byte {at} is cut short")))
}

/// Without trailing padding: spaces by the specification, NUL bytes by some exporters.
fn trim(bytes: &[u8], range: Range<usize>) -> Range<usize> {
    let text = bytes.get(range.clone()).unwrap_or_default();
    let kept = text
        .iter()
        .rposition(|b| !matches!(b, b' ' | b'\n' | b'\r' | b'\t' | 0))
        .map_or(0, |last| last + 1);
    range.start..range.start + kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(u32, &[u8])], extra: &[u8]) -> Vec<u8> {
        let total = 12 + chunks.iter().map(|(_, c)| 8 + c.len()).sum::<usize>();
        let mut out = b"glTF\x02\0\0\0".to_vec();
        out.extend(u32::try_from(total).unwrap().to_le_bytes());
        for (kind, content) in chunks {
            out.extend(u32::try_from(content.len()).unwrap().to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(*content);
        }
        out.extend(extra);
        out
    }

    #[test]
    fn finds_json_and_bin_among_other_chunks() {
        type Row<'a> = (&'a [(u32, &'a [u8])], &'a [u8], &'a str, Option<&'a [u8]>);
        let cases: [Row; 5] = [
            (&[(JSON_CHUNK, b"{}")], b"", "{}", None),
            (&[(JSON_CHUNK, b"{}  ")], b"after", "{}", None),
            (&[(JSON_CHUNK, b"{}\0\0"), (BIN_CHUNK, b"abcd")], b"", "{}", Some(b"abcd")),
            (&[(JSON_CHUNK, b"{}"), (BIN_CHUNK, b""), (7, b"zzzz")], b"", "{}", Some(b"")),
            (&[(JSON_CHUNK, b"{}"), (7, b"zzzz"), (BIN_CHUNK, b"ab")], b"", "{}", Some(b"ab")),
        ];
        for (chunks, extra, json, bin) in cases {
            let file = glb(chunks, extra);
            let found = split(&file, Format::Glb).unwrap();
            assert_eq!(&file[found.json], json.as_bytes());
            assert_eq!(found.bin.map(|b| &file[b]), bin);
        }
    }

    #[test]
    fn every_truncation_is_an_error() {
        let file = glb(&[(JSON_CHUNK, b"{}  "), (BIN_CHUNK, b"abcdefgh"), (9, b"more")], b"");
        for length in 0..file.len() {
            assert!(split(&file[..length], Format::Glb).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn malformed_headers() {
        let good = glb(&[(JSON_CHUNK, b"{}  "), (BIN_CHUNK, b"abcd")], b"");
        for (at, value) in [(0, b'x'), (4, 1), (8, 255), (12, 0xFF), (15, 0xFF), (16, b'j')] {
            let mut bad = good.clone();
            bad[at] = value;
            assert!(split(&bad, Format::Glb).is_err(), "byte {at}");
        }
    }

    #[test]
    fn text_files_may_start_with_a_byte_order_mark() {
        let found = split(b"\xEF\xBB\xBF{} \n", Format::Gltf).unwrap();
        assert_eq!(found.json, 3..5);
    }
}
