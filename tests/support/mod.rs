//! Shared by the tests over real files: where the files are, keys, and comparisons of bytes that
//! are independent of the program.
#![allow(dead_code, reason = "each test uses some of it")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers")]

use std::ops::Range;
use std::path::{Path, PathBuf};

use quadmark::formats::Limits;
use quadmark::marking::{Amplitude, Layers, MarkError, MarkRequest, Marked, extract_file, mark};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Modulation};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// A folder of the test meshes, below `$QUADMARK_MESHES`, else below `../shared/meshes`. They are
/// not part of the repository. A test that calls this has `#[cfg_attr(not(shared_meshes), ignore =
/// "...")]`, so that it is reported as ignored if they are missing (`build.rs` sets the flag).
pub fn meshes(part: &str) -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes");
    let folder = std::env::var_os("QUADMARK_MESHES").map_or_else(beside, PathBuf::from).join(part);
    assert!(folder.is_dir(), "there is no {}: set QUADMARK_MESHES", folder.display());
    folder
}

/// Every file below `folder`, in the order of their names.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
}

pub fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().is_some_and(|extension| extension == wanted)
}

/// A key that is the same in every run and differs between names.
pub fn key_named(name: &str) -> MarkKey {
    MarkKey::from_bytes(Sha256::digest(name).into())
}

/// A pseudo-random message, about half ones.
pub fn message_named(name: &str, bits: BitCount) -> Message {
    let bytes: [u8; 32] = Sha256::digest(format!("message {name}")).into();
    Message::from_bytes(&bytes[..bits.get() / 8], bits).unwrap()
}

/// Marks a file with the key and the message of a name.
pub fn mark_named(name: &str, host: &[u8], method: Method) -> Result<Marked, MarkError> {
    let params = EmbedParams { method, ..EmbedParams::default() };
    let request = MarkRequest {
        key: &key_named(name),
        others: &[],
        message: &message_named(name, params.bits),
        params,
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 16 << 20,
    };
    mark(host, &request)
}

/// Number of bits of the message of `name` that a blind reader reads right, and wrong.
pub fn bits_read(name: &str, bytes: &[u8], modulation: Modulation) -> (usize, usize) {
    let bits = BitCount::default();
    let found =
        extract_file(bytes, &key_named(name), bits, modulation, &Limits::default()).unwrap();
    let meant = message_named(name, bits);
    let count = |same: bool| {
        found.bits.iter().zip(meant.bits()).filter(|(read, m)| **read == Some(**m ^ !same)).count()
    };
    (count(true), count(false))
}

/// Asserts that two OBJ files differ only in coordinate tokens of `v` lines. Returns the number of
/// lines that differ.
pub fn assert_only_coordinates_differ(name: &str, host: &[u8], marked: &[u8]) -> usize {
    let lines = |bytes: &[u8]| -> Vec<Vec<u8>> {
        bytes.split_inclusive(|b| matches!(b, b'\n' | b'\r')).map(<[u8]>::to_vec).collect()
    };
    let (host, marked) = (lines(host), lines(marked));
    assert_eq!(host.len(), marked.len(), "{name}: lines");
    let mut moved = 0;
    for (number, (before, after)) in host.iter().zip(&marked).enumerate() {
        if before == after {
            continue;
        }
        moved += 1;
        let line = number + 1;
        let (before, after) = (pieces(before), pieces(after));
        assert_eq!(before.len(), after.len(), "{name}, line {line}");
        let word = before.iter().position(|piece| !is_blank(piece)).unwrap();
        assert_eq!(before[word], b"v", "{name}, line {line} is no vertex");
        // The keyword, then a blank and a coordinate three times.
        for (at, (before, after)) in before.iter().zip(&after).enumerate() {
            let coordinate = at > word && at <= word + 6 && !is_blank(before);
            assert!(coordinate || before == after, "{name}, line {line}, piece {at}");
        }
    }
    moved
}

fn is_blank(piece: &[u8]) -> bool {
    piece.first().is_some_and(u8::is_ascii_whitespace)
}

/// Words and the blanks between them.
fn pieces(line: &[u8]) -> Vec<&[u8]> {
    line.chunk_by(|a, b| a.is_ascii_whitespace() == b.is_ascii_whitespace()).collect()
}

/// Asserts that two GLB files differ only in POSITION bytes and the bounds of those accessors,
/// which must not be sparse and must be in the GLB's own buffer.
pub fn assert_only_positions_differ(name: &str, host: &[u8], marked: &[u8]) {
    let ((before, before_bin), (after, after_bin)) = (chunks(host), chunks(marked));
    let mut positions: Vec<usize> = Vec::new();
    for mesh in before["meshes"].as_array().unwrap() {
        for primitive in mesh["primitives"].as_array().unwrap() {
            positions.extend(primitive["attributes"]["POSITION"].as_u64().map(index));
        }
    }
    let without_bounds = |document: &Value| {
        let mut document = document.clone();
        for &accessor in &positions {
            for bound in ["min", "max"] {
                document["accessors"][accessor][bound] = Value::Null;
            }
        }
        document.to_string()
    };
    assert_eq!(without_bounds(&before), without_bounds(&after), "{name}: JSON");
    assert_eq!(before_bin.len(), after_bin.len(), "{name}: BIN");
    let ranges: Vec<Range<usize>> =
        positions.iter().map(|&accessor| element_range(&before, accessor)).collect();
    for (at, (before, after)) in before_bin.iter().zip(after_bin).enumerate() {
        let inside = || ranges.iter().any(|range| range.contains(&at));
        assert!(before == after || inside(), "{name}: byte {at} of BIN");
    }
}

fn index(number: u64) -> usize {
    usize::try_from(number).unwrap()
}

/// The byte range of a tightly packed VEC3 of floats in the buffer.
fn element_range(document: &Value, accessor: usize) -> Range<usize> {
    let accessor = &document["accessors"][accessor];
    let view = &document["bufferViews"][index(accessor["bufferView"].as_u64().unwrap())];
    assert_eq!(view["byteStride"].as_u64().unwrap_or(12), 12);
    let offset = |of: &Value| index(of["byteOffset"].as_u64().unwrap_or(0));
    let start = offset(accessor) + offset(view);
    start..start + 12 * index(accessor["count"].as_u64().unwrap())
}

/// The JSON and the BIN chunk of a GLB.
fn chunks(glb: &[u8]) -> (Value, &[u8]) {
    let length = |at: usize| {
        usize::try_from(u32::from_le_bytes(glb[at..at + 4].try_into().unwrap())).unwrap()
    };
    let json_end = 20 + length(12);
    let bin = json_end + 8;
    let document = serde_json::from_slice(&glb[20..json_end]).unwrap();
    (document, &glb[bin..bin + length(json_end)])
}
