//! One face corner: a vertex index, absolute or relative to the `v` lines so far.
//!
//! Chunks are parsed before the number of vertices in front of them is known. So a relative index
//! is kept relative to its chunk, in the same 32 bits, and resolved afterwards.

use super::cursor::{Cursor, ends_token};

/// Most vertices that a [`Corner`] can distinguish. A file with as many has 8 GiB.
pub(super) const MOST_VERTICES: usize = (BIAS as usize) - 1;

/// Set in a relative corner.
const RELATIVE: u32 = 1 << 31;
/// The stored value of a relative index of 0, so that indices before the chunk are positive too.
const BIAS: u32 = 1 << 30;

/// A position index that is not resolved yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Corner(u32);

/// Why a token is not a face corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoCorner {
    /// Index 0.
    Zero,
    /// The part before the first slash is not an integer.
    NotAnInteger,
}

impl Corner {
    /// The vertex, zero-based, given the vertices before the chunk and in the whole file.
    pub(super) fn resolve(self, before: u32, total: u32) -> Option<u32> {
        let index = if self.0 & RELATIVE == 0 {
            self.0
        } else {
            (before + (self.0 & !RELATIVE)).checked_sub(BIAS)?
        };
        (index < total).then_some(index)
    }
}

/// Reads the next token of the line as a corner: `7`, `7/2`, `7//3`, `7/2/3`, `-1`. Only the
/// position index matters; what follows the first slash is not read.
///
/// `vertices` is the number of `v` lines so far in this chunk.
#[inline]
pub(super) fn corner(cursor: &mut Cursor<'_>, vertices: usize) -> Option<Result<Corner, NoCorner>> {
    cursor.skip_blank();
    let text = cursor.text();
    let start = cursor.offset();
    if ends_token(text, start) {
        return None;
    }
    let sign = text.get(start).filter(|sign| matches!(sign, b'-' | b'+'));
    let first = start + usize::from(sign.is_some());
    let mut at = first;
    // Saturating far above any index keeps `f 99999999999999999999` out of range.
    let mut magnitude = 0_u32;
    while let Some(digit) = text.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|&d| d < 10) {
        magnitude = magnitude.saturating_mul(10).saturating_add(u32::from(digit));
        at += 1;
    }
    let integer = at > first;
    let slash = text.get(at) == Some(&b'/');
    while !ends_token(text, at) {
        at += 1;
        if !slash {
            cursor.token();
            return Some(Err(NoCorner::NotAnInteger));
        }
    }
    cursor.move_to(at);
    Some(match (integer, magnitude.min(BIAS), sign) {
        (false, _, _) => Err(NoCorner::NotAnInteger),
        (true, 0, _) => Err(NoCorner::Zero),
        (true, back, Some(b'-')) => {
            let vertices = u32::try_from(vertices).unwrap_or(BIAS).min(BIAS - 1);
            Ok(Corner(RELATIVE | (BIAS + vertices - back)))
        }
        (true, number, _) => Ok(Corner(number - 1)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first corner of a line in a chunk with 10 vertices before it, 5 in it so far and 20 in
    /// the file.
    fn read(text: &str) -> Option<Result<Option<u32>, NoCorner>> {
        let mut cursor = Cursor::new(text.as_bytes(), 0);
        Some(corner(&mut cursor, 5)?.map(|corner| corner.resolve(10, 20)))
    }

    #[test]
    fn forms_of_a_corner() {
        for text in ["7", "7/2", "7//3", "7/2/3", "+7", " 7\t8", "7#", "7\\\n", "7/x/", "07", "-9"]
        {
            assert_eq!(read(text), Some(Ok(Some(6))), "{text:?}");
        }
        for text in ["1.5", "x", "/1", "-", "--1", "7\\", "7,8", "1e1", "nan", "\0", "-/1"] {
            assert_eq!(read(text), Some(Err(NoCorner::NotAnInteger)), "{text:?}");
        }
        for text in ["0", "-0", "0/1", "000"] {
            assert_eq!(read(text), Some(Err(NoCorner::Zero)), "{text:?}");
        }
        for text in ["", "  ", "#7", "\n7", "\\\n"] {
            assert_eq!(read(text), None, "{text:?}");
        }
    }

    #[test]
    fn range_of_a_corner() {
        let table = [
            ("1", Some(0)),
            ("20", Some(19)),
            ("21", None),
            ("-1", Some(14)),
            ("-15", Some(0)),
            ("-16", None),
            ("4294967296", None),
            ("-4294967296", None),
            ("99999999999999999999999", None),
            ("-99999999999999999999999", None),
            ("1073741824", None),
            ("-1073741824", None),
        ];
        for (text, index) in table {
            assert_eq!(read(text), Some(Ok(index)), "{text}");
        }
    }
}
