//! The whole file: cut at line starts, parsed in parallel, joined in order.
//!
//! The result, errors included, does not depend on where the cuts fall. Of several faults, a line
//! that cannot be read comes first, then a count over its limit, then an index out of range; within
//! each kind, the first in the file.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::super::{FormatError, Limits, Stop, go_on};
use super::chunk::{Caps, Chunk};
use super::corner::{Corner, MOST_VERTICES};
use super::cursor::{line_number, next_boundary};
use super::fault::{Cause, Fault, find_unresolved};

/// What a file holds, not yet checked to be a mesh.
#[derive(Debug, PartialEq)]
pub(super) struct Parsed {
    pub(super) positions: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) offsets: Vec<u32>,
    /// The fewest decimals of any coordinate; none without one.
    pub(super) fewest_decimals: Option<usize>,
}

/// Parses a file in chunks of about `chunk_bytes`.
pub(super) fn parse(
    bytes: &[u8],
    limits: &Limits,
    chunk_bytes: usize,
    stop: Stop<'_>,
) -> Result<Parsed, FormatError> {
    // Offsets are kept in 32 bits.
    within("bytes", bytes.len(), u32::MAX as usize)?;
    let caps = Caps {
        vertices: limits.max_vertices.min(MOST_VERTICES),
        triangles: limits.max_triangles.min(u32::MAX as usize),
    };
    let meter = Meter { caps, vertices: AtomicUsize::new(0), triangles: AtomicUsize::new(0) };
    let stretches = cut(bytes, chunk_bytes);
    let chunks = stretches
        .par_iter()
        .map(|&(start, text)| if stop() { Ok(Chunk::default()) } else { meter.parse(text, start) })
        .collect::<Vec<Result<Chunk, Fault>>>();
    go_on(stop)?;
    let chunks = chunks
        .into_iter()
        .collect::<Result<Vec<Chunk>, Fault>>()
        .map_err(|fault| explain(fault, bytes))?;
    let vertices = chunks.iter().map(|chunk| chunk.vertex_count).sum();
    let triangles = chunks.iter().map(|chunk| chunk.triangle_count).sum();
    within("vertices", vertices, caps.vertices)?;
    within("triangles", triangles, caps.triangles)?;
    let parsed = join(chunks, &stretches, vertices, triangles, stop);
    go_on(stop)?;
    parsed.map_err(|fault| explain(fault, bytes))
}

/// Counts over all chunks, so that a hostile file allocates no more than its limits allow, plus the
/// chunks under way. Once a count is over its limit, the rest is only counted, so that the error
/// names the true number.
struct Meter {
    caps: Caps,
    vertices: AtomicUsize,
    triangles: AtomicUsize,
}

impl Meter {
    fn parse(&self, text: &[u8], start: usize) -> Result<Chunk, Fault> {
        let caps = if self.over() { Caps { vertices: 0, triangles: 0 } } else { self.caps };
        let mut chunk = Chunk::parse(text, start, caps)?;
        self.vertices.fetch_add(chunk.vertex_count, Ordering::Relaxed);
        self.triangles.fetch_add(chunk.triangle_count, Ordering::Relaxed);
        if self.over() {
            (chunk.positions, chunk.offsets, chunk.triangles) = Default::default();
        }
        Ok(chunk)
    }

    fn over(&self) -> bool {
        self.vertices.load(Ordering::Relaxed) > self.caps.vertices
            || self.triangles.load(Ordering::Relaxed) > self.caps.triangles
    }
}

/// Cuts a file into chunks of whole logical lines, with their byte offsets. The first begins after
/// the byte order mark, if there is one.
fn cut(bytes: &[u8], chunk_bytes: usize) -> Vec<(usize, &[u8])> {
    let mut start = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    let mut stretches = Vec::new();
    while start < bytes.len() {
        let end = next_boundary(bytes, start.saturating_add(chunk_bytes.max(1)));
        stretches.push((start, bytes.get(start..end).unwrap_or_default()));
        start = end;
    }
    stretches
}

/// Resolves the corners, now that the vertices before each chunk are known, and joins the chunks.
fn join(
    chunks: Vec<Chunk>,
    stretches: &[(usize, &[u8])],
    vertices: usize,
    triangles: usize,
    stop: Stop<'_>,
) -> Result<Parsed, Fault> {
    let total = u32::try_from(vertices).unwrap_or(u32::MAX);
    let mut before = 0_u32;
    let mut parsed = Parsed {
        positions: Vec::with_capacity(vertices),
        triangles: Vec::with_capacity(triangles),
        offsets: Vec::with_capacity(vertices),
        fewest_decimals: chunks.iter().filter_map(|chunk| chunk.fewest_decimals).min(),
    };
    for (chunk, &(start, text)) in chunks.into_iter().zip(stretches) {
        if stop() {
            break;
        }
        let resolve = |corner: Corner| corner.resolve(before, total);
        for &[a, b, c] in &chunk.triangles {
            let (Some(a), Some(b), Some(c)) = (resolve(a), resolve(b), resolve(c)) else {
                return Err(find_unresolved(text, start, before, total).unwrap_or(Fault {
                    offset: start,
                    cause: Cause::Malformed("a face names a vertex that does not exist".into()),
                }));
            };
            parsed.triangles.push([a, b, c]);
        }
        before += u32::try_from(chunk.vertex_count).unwrap_or(0);
        parsed.positions.extend(chunk.positions);
        parsed.offsets.extend(chunk.offsets);
    }
    Ok(parsed)
}

fn explain(fault: Fault, bytes: &[u8]) -> FormatError {
    let line = line_number(bytes, fault.offset);
    match fault.cause {
        Cause::Malformed(reason) => FormatError::MalformedObj { line, reason },
        Cause::NonFinite => FormatError::NonFiniteVertex { place: format!("line {line}") },
    }
}

fn within(what: &'static str, count: usize, limit: usize) -> Result<(), FormatError> {
    if count > limit {
        return Err(FormatError::TooLarge { what, count: count as u64, limit: limit as u64 });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "\
        v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1 2 3\nf -4 -2 -1\nf 1/1 2/1 3/1 4/1\n";

    fn parse_all_ways(text: &[u8], limits: &Limits) -> Result<Parsed, FormatError> {
        let whole = parse(text, limits, usize::MAX, &|| false);
        for chunk_bytes in [1, 7, 16, 64] {
            assert_eq!(
                parse(text, limits, chunk_bytes, &|| false),
                whole,
                "chunks of {chunk_bytes}"
            );
        }
        whole
    }

    #[test]
    fn cuts_do_not_matter() {
        let forms = [
            SQUARE.to_owned(),
            SQUARE.replace('\n', "\r\n"),
            SQUARE.replace('\n', "\r"),
            SQUARE.replace(' ', " \\\n"),
            SQUARE.replace(' ', "\\\r\n\t"),
            SQUARE.replace('\n', " # C:\\\n"),
            format!("\u{feff}{SQUARE}"),
            format!("f 1 2 3\nf 1 3 4\nf 1 2 3 4\n{}", SQUARE.replace('f', "#")),
        ];
        let expected = [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]];
        for text in forms {
            let parsed = parse_all_ways(text.as_bytes(), &Limits::default()).unwrap();
            assert_eq!(parsed.positions.len(), 4, "{text:?}");
            assert_eq!(parsed.triangles, expected, "{text:?}");
            for (position, &offset) in parsed.positions.iter().zip(&parsed.offsets) {
                let at = usize::try_from(offset).unwrap();
                assert_eq!(text.as_bytes()[at], if position.x > 0.0 { b'1' } else { b'0' });
            }
        }
    }

    #[test]
    fn faults_name_the_physical_line_wherever_the_cuts_fall() {
        let table = [
            ("v 0 0 0\nf 1 1 2\n", 2, "`2` names no vertex"),
            ("v 0 0 0\nf 1 1 -2\nv 0 0 0", 2, "`-2` names no vertex"),
            ("v 0 0 0\r\n\r\nf 1 1 0\r\n", 3, "names vertex 0"),
            ("v 0 0 0\rv 0 \\\r 0 \\\r zero\r", 4, "`zero` is not"),
            ("f 9 9 9\nv 1 1\n", 2, "found 2"),
            ("v 0 0 0\nf 1 1 99999999999999\n", 2, "names no vertex"),
            ("\u{feff}v 0 0\n", 1, "found 2"),
        ];
        for (text, line, reason) in table {
            match parse_all_ways(text.as_bytes(), &Limits::default()) {
                Err(FormatError::MalformedObj { line: found, reason: text }) => {
                    assert!(found == line && text.contains(reason), "line {found}: {text}");
                }
                other => panic!("{text:?}: {other:?}"),
            }
        }
        let non_finite = parse_all_ways(b"v 0 0 0\nv 0 1e999 0", &Limits::default());
        assert_eq!(non_finite, Err(FormatError::NonFiniteVertex { place: "line 2".into() }));
    }

    #[test]
    fn limits_name_the_true_count() {
        let limits = |max_vertices, max_triangles| Limits {
            max_vertices,
            max_triangles,
            ..Limits::default()
        };
        let too_large = |what, count, limit| Err(FormatError::TooLarge { what, count, limit });
        assert_eq!(parse_all_ways(SQUARE.as_bytes(), &limits(3, 4)), too_large("vertices", 4, 3));
        assert_eq!(parse_all_ways(SQUARE.as_bytes(), &limits(4, 3)), too_large("triangles", 4, 3));
        assert!(parse_all_ways(SQUARE.as_bytes(), &limits(4, 4)).is_ok());
    }
}
