//! A chunk of whole logical lines: its vertices and faces, parsed before the number of vertices in
//! front of it is known.

use glam::DVec3;

use super::corner::{Corner, corner};
use super::cursor::{Cursor, Statement};
use super::fault::{Cause, Fault};
use super::number::coordinate;

/// The content of one chunk. What exceeds the caller's caps is counted but not kept.
#[derive(Debug, Default)]
pub(super) struct Chunk {
    pub(super) positions: Vec<DVec3>,
    /// Byte offset of each vertex's first coordinate in the file.
    pub(super) offsets: Vec<u32>,
    pub(super) triangles: Vec<[Corner; 3]>,
    pub(super) vertex_count: usize,
    pub(super) triangle_count: usize,
    /// The fewest decimals of any coordinate; none without one.
    pub(super) fewest_decimals: Option<usize>,
}

/// What may be kept of one chunk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Caps {
    pub(super) vertices: usize,
    pub(super) triangles: usize,
}

impl Chunk {
    /// Parses the chunk `text`, which starts at byte `start` of the file.
    pub(super) fn parse(text: &[u8], start: usize, caps: Caps) -> Result<Self, Fault> {
        let mut chunk = Self::default();
        let mut cursor = Cursor::new(text, 0);
        while let Some(statement) = cursor.statement() {
            let parsed = match statement {
                Statement::Vertex => chunk.vertex(&mut cursor, start, caps),
                Statement::Face => chunk.face(&mut cursor, caps),
                Statement::Other => Ok(()),
            };
            parsed.map_err(|fault| Fault { offset: start + fault.offset, ..fault })?;
            cursor.skip_line();
        }
        Ok(chunk)
    }

    /// Reads the first three numbers. A weight or a colour after them is left alone.
    #[inline]
    fn vertex(&mut self, cursor: &mut Cursor<'_>, start: usize, caps: Caps) -> Result<(), Fault> {
        let keyword = cursor.offset().saturating_sub(1);
        let mut position = [0.0; 3];
        let mut first = None;
        for (found, slot) in position.iter_mut().enumerate() {
            let read = coordinate(cursor)
                .map_err(|problem| Fault::number(problem, found, keyword, cursor.text()))?;
            if !read.value.is_finite() {
                return Err(Fault { offset: read.start, cause: Cause::NonFinite });
            }
            *slot = read.value;
            first.get_or_insert(read.start);
            let fewest = self.fewest_decimals.get_or_insert(read.decimals);
            *fewest = read.decimals.min(*fewest);
        }
        if self.positions.len() < caps.vertices {
            // A file that 32 bits cannot address is refused before it is cut into chunks.
            let offset = first.and_then(|first| u32::try_from(start + first).ok());
            self.offsets.push(offset.unwrap_or(u32::MAX));
            self.positions.push(DVec3::from_array(position));
        }
        self.vertex_count += 1;
        Ok(())
    }

    /// Reads a polygon as a fan from its first corner. Fewer than three corners give no triangle.
    #[inline]
    fn face(&mut self, cursor: &mut Cursor<'_>, caps: Caps) -> Result<(), Fault> {
        let mut first = None;
        let mut last = None;
        while let Some(next) = self.next_corner(cursor)? {
            match (first, last) {
                (None, _) => first = Some(next),
                (Some(_), None) => last = Some(next),
                (Some(first), Some(middle)) => {
                    if self.triangles.len() < caps.triangles {
                        self.triangles.push([first, middle, next]);
                    }
                    self.triangle_count += 1;
                    last = Some(next);
                }
            }
        }
        Ok(())
    }

    #[inline]
    fn next_corner(&self, cursor: &mut Cursor<'_>) -> Result<Option<Corner>, Fault> {
        let Some(read) = corner(cursor, self.vertex_count) else { return Ok(None) };
        read.map(Some).map_err(|problem| Fault::corner(problem, cursor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Caps = Caps { vertices: usize::MAX, triangles: usize::MAX };

    fn triangles(text: &str, before: u32, total: u32) -> Vec<[Option<u32>; 3]> {
        let chunk = Chunk::parse(text.as_bytes(), 0, ALL).unwrap();
        let resolve = |corner: Corner| corner.resolve(before, total);
        chunk.triangles.iter().map(|corners| corners.map(resolve)).collect()
    }

    #[test]
    fn polygons_are_fans() {
        let table: &[(&str, &[[u32; 3]])] = &[
            ("f 1 2 3", &[[0, 1, 2]]),
            ("f 1 2 3 4", &[[0, 1, 2], [0, 2, 3]]),
            ("f 1/1 2/2 3/3 \\\n 4/4 5/5", &[[0, 1, 2], [0, 2, 3], [0, 3, 4]]),
            ("f 1 1 1", &[[0, 0, 0]]),
            ("f", &[]),
            ("f 1", &[]),
            ("f 1 99", &[]),
            ("f 1 2 3#4", &[[0, 1, 2]]),
            ("l 1 2 3\np 1 2 3\nfo 1 2 3", &[]),
            ("v 0 0 0\nf -1 -2 -3\nv 0 0 0\nf -1 1 -6", &[[5, 4, 3], [6, 0, 1]]),
        ];
        for (text, expected) in table {
            let expected: Vec<_> = expected.iter().map(|corners| corners.map(Some)).collect();
            assert_eq!(triangles(text, 5, 9), expected, "{text:?}");
        }
    }

    #[test]
    fn vertices_take_three_numbers_and_leave_the_rest() {
        type Row = (&'static str, &'static [[f64; 3]], &'static [u32]);
        let table: &[Row] = &[
            ("v 1 2 3", &[[1.0, 2.0, 3.0]], &[102]),
            ("v 1 2 3 0.5", &[[1.0, 2.0, 3.0]], &[102]),
            ("v 1 2 3 .1 .2 .3", &[[1.0, 2.0, 3.0]], &[102]),
            ("v 1 2 3 1 .1 .2 .3", &[[1.0, 2.0, 3.0]], &[102]),
            ("v 1 2 3 name", &[[1.0, 2.0, 3.0]], &[102]),
            (" v\\\n1 2\\\r\n3#c\nv 4 5 6", &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], &[104, 116]),
            ("vt 1 2\nvn 1 2 3\nvp 1\nV 1 2 3", &[], &[]),
        ];
        for (text, positions, offsets) in table {
            let chunk = Chunk::parse(text.as_bytes(), 100, ALL).unwrap();
            let read: Vec<_> = chunk.positions.iter().map(DVec3::to_array).collect();
            assert_eq!(&read, positions, "{text:?}");
            assert_eq!(&chunk.offsets, offsets, "{text:?}");
        }
    }

    #[test]
    fn faults_stand_where_the_token_stands() {
        let table = [
            ("v 1 2", 100, "found 2"),
            ("  v", 102, "found 0"),
            ("v 1 2 # 3", 100, "found 2"),
            ("v 1 two 3", 104, "`two` is not a number"),
            ("v 1 2 \\\n 3\0", 109, "`3\\x00` is not a number"),
            ("f 1 2 0", 106, "`0` names vertex 0"),
            ("f 1 2 3 x/1", 108, "`x/1` is not a face corner"),
            ("f 1.5 2 3", 102, "`1.5` is not"),
        ];
        for (text, offset, reason) in table {
            let fault = Chunk::parse(text.as_bytes(), 100, ALL).unwrap_err();
            assert_eq!(fault.offset, offset, "{text:?}");
            assert!(matches!(&fault.cause, Cause::Malformed(text) if text.contains(reason)));
        }
        let fault = Chunk::parse(b"v 1 2 nan", 100, ALL).unwrap_err();
        assert_eq!(fault, Fault { offset: 106, cause: Cause::NonFinite });
    }

    #[test]
    fn beyond_the_caps_lines_are_counted_but_not_kept() {
        let text = b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 1 1 1 1 1";
        let chunk = Chunk::parse(text, 0, Caps { vertices: 2, triangles: 1 }).unwrap();
        assert_eq!((chunk.vertex_count, chunk.positions.len(), chunk.offsets.len()), (3, 2, 2));
        assert_eq!((chunk.triangle_count, chunk.triangles.len()), (4, 1));
    }
}
