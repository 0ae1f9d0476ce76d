//! What is wrong with a line, and where, in words that tell the user what to write.

use super::corner::{NoCorner, corner};
use super::cursor::{Cursor, Statement};
use super::number::NoCoordinate;

/// A line that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fault {
    /// A byte offset; the line number is counted only when it is needed.
    pub(super) offset: usize,
    pub(super) cause: Cause,
}

/// Why a line cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Cause {
    Malformed(String),
    NonFinite,
}

impl Fault {
    pub(super) fn malformed(offset: usize, reason: String) -> Self {
        Self { offset, cause: Cause::Malformed(reason) }
    }

    /// A `v` line (its keyword at `keyword`) whose coordinate number `found` cannot be read.
    #[cold]
    pub(super) fn number(problem: NoCoordinate, found: usize, keyword: usize, text: &[u8]) -> Self {
        match problem {
            NoCoordinate::Missing => Self::malformed(
                keyword,
                format!("a vertex needs three numbers, as in `v 1.0 2.0 3.0`; found {found}"),
            ),
            NoCoordinate::Junk { start } => Self::malformed(
                start,
                format!(
                    "`{}` is not a number; a vertex needs three, as in `v 1.0 2.0 3.0`",
                    shown(text, start)
                ),
            ),
        }
    }

    /// A face corner that cannot be read; the cursor stands after it.
    #[cold]
    pub(super) fn corner(problem: NoCorner, cursor: &Cursor<'_>) -> Self {
        let start = token_start(cursor);
        let token = shown(cursor.text(), start);
        let reason = match problem {
            NoCorner::Zero => format!(
                "`{token}` names vertex 0, but vertices are counted from 1 (or from -1 backwards)"
            ),
            NoCorner::NotAnInteger => format!(
                "`{token}` is not a face corner; expected a vertex number, as in `7`, `7/2`, \
                 `7//3` or `-1`"
            ),
        };
        Self::malformed(start, reason)
    }
}

/// The first corner that names no vertex, in a chunk that is known to have one. Reads the text
/// again: the positions of faces are not stored, because they are needed only once per bad file.
pub(super) fn find_unresolved(text: &[u8], start: usize, before: u32, total: u32) -> Option<Fault> {
    let mut cursor = Cursor::new(text, 0);
    let mut vertices = 0;
    while let Some(statement) = cursor.statement() {
        match statement {
            Statement::Vertex => vertices += 1,
            Statement::Face => {
                let mut corners = 0;
                let mut unresolved = None;
                while let Some(Ok(corner)) = corner(&mut cursor, vertices) {
                    corners += 1;
                    if unresolved.is_none() && corner.resolve(before, total).is_none() {
                        unresolved = Some(token_start(&cursor));
                    }
                }
                if let Some(at) = unresolved.filter(|_| corners > 2) {
                    let so_far = vertices as u64 + u64::from(before);
                    let reason = format!(
                        "`{}` names no vertex: {so_far} stand above this line, {total} in \
                         the whole file",
                        shown(text, at)
                    );
                    return Some(Fault::malformed(start + at, reason));
                }
            }
            Statement::Other => {}
        }
        cursor.skip_line();
    }
    None
}

/// Where the token that ends at the cursor starts.
fn token_start(cursor: &Cursor<'_>) -> usize {
    let before = cursor.text().get(..cursor.offset()).unwrap_or_default();
    let blank = |&byte: &u8| matches!(byte, b' ' | b'\t' | 0x0b | 0x0c | b'\n' | b'\r');
    before.iter().rposition(blank).map_or(0, |blank| blank + 1)
}

/// The token at `start`, fit for an error message: printable and short.
fn shown(text: &[u8], start: usize) -> String {
    const LONGEST: usize = 40;
    let token = Cursor::new(text, start).token().unwrap_or_default();
    match token.get(..LONGEST) {
        Some(head) => format!("{}...", head.escape_ascii()),
        None => token.escape_ascii().to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_unresolved_corner_is_found() {
        let text = b"f 1 9\nv 1 2 3\nf 1 2 -4\nf 1 2 -5";
        let fault = find_unresolved(text, 100, 3, 4).unwrap();
        assert_eq!(fault.offset, 129);
        assert!(
            matches!(fault.cause, Cause::Malformed(reason) if reason.contains("`-5` names no"))
        );
        assert_eq!(find_unresolved(text, 100, 4, 5), None);
    }

    #[test]
    fn tokens_are_shown_short_and_printable() {
        assert_eq!(shown(b"v caf\xe9\0 1", 2), "caf\\xe9\\x00");
        assert_eq!(shown(&[b'7'; 100], 0), "7".repeat(40) + "...");
    }
}
