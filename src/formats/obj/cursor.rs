//! Logical lines and tokens.
//!
//! A logical line ends at LF, CR LF or CR. If a backslash stands directly before that end, the line
//! goes on, as if backslash and end were white space. Within a comment a backslash means nothing,
//! so an artist's `# C:\scans\` cannot swallow the vertex below it. Names may be Latin-1: nothing
//! here assumes UTF-8.

use memchr::{memchr, memchr2};

/// What the first word of a logical line says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::formats) enum Statement {
    /// `v`: the cursor stands after it.
    Vertex,
    /// `f`: the cursor stands after it.
    Face,
    /// Anything else: the cursor stands before it.
    Other,
}

/// A position in a text.
#[derive(Debug, Clone)]
pub(in crate::formats) struct Cursor<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    /// Starts at byte `at`, or at the end if that comes first.
    pub(in crate::formats) fn new(text: &'a [u8], at: usize) -> Self {
        Self { text, at: at.min(text.len()) }
    }

    /// The byte offset of the cursor.
    pub(in crate::formats) fn offset(&self) -> usize {
        self.at
    }

    /// Moves to `at`, which the caller has found to be inside the text.
    pub(super) fn move_to(&mut self, at: usize) {
        self.at = at.min(self.text.len());
    }

    /// The text that the offsets refer to.
    pub(super) fn text(&self) -> &'a [u8] {
        self.text
    }

    /// Moves to the next logical line that holds a word, and reads the word if it matters.
    pub(in crate::formats) fn statement(&mut self) -> Option<Statement> {
        loop {
            self.skip_blank();
            let first = *self.text.get(self.at)?;
            let word = match first {
                b'\n' | b'\r' | b'#' => {
                    self.skip_line();
                    continue;
                }
                b'v' => Statement::Vertex,
                b'f' => Statement::Face,
                _ => return Some(Statement::Other),
            };
            if !ends_token(self.text, self.at + 1) {
                return Some(Statement::Other);
            }
            self.at += 1;
            return Some(word);
        }
    }

    /// Skips spaces, tabs and line continuations.
    pub(in crate::formats) fn skip_blank(&mut self) {
        while let Some(&byte) = self.text.get(self.at) {
            match byte {
                b' ' | b'\t' | 0x0b | 0x0c => self.at += 1,
                b'\\' => match line_end(self.text, self.at + 1) {
                    Some(next) => self.at = next,
                    None => return,
                },
                _ => return,
            }
        }
    }

    /// The next token of the logical line, or `None` at its end or at a comment.
    pub(in crate::formats) fn token(&mut self) -> Option<&'a [u8]> {
        self.skip_blank();
        let start = self.at;
        while !ends_token(self.text, self.at) {
            self.at += 1;
        }
        self.text.get(start..self.at).filter(|token| !token.is_empty())
    }

    /// Moves past the end of the logical line.
    pub(in crate::formats) fn skip_line(&mut self) {
        loop {
            let Some(rest) = self.text.get(self.at..) else { return };
            let Some(length) = memchr2(b'\n', b'\r', rest) else {
                self.at = self.text.len();
                return;
            };
            let line = rest.get(..length).unwrap_or_default();
            let continues = line.last() == Some(&b'\\') && memchr(b'#', line).is_none();
            let end = self.at + length;
            self.at = line_end(self.text, end).unwrap_or(end + 1);
            if !continues {
                return;
            }
        }
    }
}

/// Where the next line starts, if a line end stands at `at`.
fn line_end(text: &[u8], at: usize) -> Option<usize> {
    match (text.get(at)?, text.get(at + 1)) {
        (b'\r', Some(b'\n')) => Some(at + 2),
        (b'\r' | b'\n', _) => Some(at + 1),
        _ => None,
    }
}

/// Whether a token that reaches up to `at` ends there.
pub(super) fn ends_token(text: &[u8], at: usize) -> bool {
    match text.get(at) {
        None | Some(b' ' | b'\n' | b'\r' | b'\t' | b'#' | 0x0b | 0x0c) => true,
        Some(b'\\') => line_end(text, at + 1).is_some(),
        Some(_) => false,
    }
}

/// The first line start at or after `from` that is surely the start of a logical line, because no
/// backslash stands before the line end in front of it. Otherwise the end of the text. `from` is
/// not 0.
pub(super) fn next_boundary(text: &[u8], from: usize) -> usize {
    // One byte back, so that a line end that straddles `from` is read whole.
    let mut at = from.saturating_sub(1);
    while let Some(length) = text.get(at..).and_then(|rest| memchr2(b'\n', b'\r', rest)) {
        let mut end = at + length;
        let next = line_end(text, end).unwrap_or(end + 1);
        let second_half = text.get(end) == Some(&b'\n')
            && end.checked_sub(1).and_then(|before| text.get(before)) == Some(&b'\r');
        end -= usize::from(second_half);
        if end.checked_sub(1).and_then(|before| text.get(before)) != Some(&b'\\') {
            return next;
        }
        at = next;
    }
    text.len()
}

/// The one-based physical line of a byte.
pub(super) fn line_number(text: &[u8], offset: usize) -> u64 {
    let before = text.get(..offset).unwrap_or(text);
    let ends = memchr::memchr2_iter(b'\n', b'\r', before);
    let second_halves = memchr::memmem::find_iter(before, b"\r\n");
    1 + (ends.count() - second_halves.count()) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every logical line as its tokens joined by `|`.
    fn lines(text: &[u8]) -> Vec<String> {
        let mut cursor = Cursor::new(text, 0);
        let mut lines = Vec::new();
        while cursor.statement().is_some() {
            let mut tokens = Vec::new();
            while let Some(token) = cursor.token() {
                tokens.push(token.escape_ascii().to_string());
            }
            lines.push(tokens.join("|"));
            cursor.skip_line();
        }
        lines
    }

    #[test]
    fn logical_lines_and_tokens() {
        // (name, text, the tokens of each logical line behind `v` or `f`)
        let table: &[(&str, &[u8], &[&str])] = &[
            ("no_end", b"v 1 2", &["1|2"]),
            ("lf", b"v 1\nv 2\n", &["1", "2"]),
            ("crlf", b"v 1\r\nv 2\r\n", &["1", "2"]),
            ("cr_only", b"v 1\rv 2\r", &["1", "2"]),
            ("mixed", b"v 1\r\r\nv 2\n\rv 3", &["1", "2", "3"]),
            ("indented", b" \t v\t1\x0b2  \n", &["1|2"]),
            ("comment_at_end", b"v 1 2#3\nv 4 # 5", &["1|2", "4"]),
            ("only_comment", b"# v 1\n#\n", &[]),
            ("continued", b"v 1 \\\n2\nv 3", &["1|2", "3"]),
            ("continued_crlf", b"v 1 \\\r\n2\r\nv 3", &["1|2", "3"]),
            ("continued_cr", b"v 1 \\\r2\rv 3", &["1|2", "3"]),
            ("continued_tight", b"v 1\\\n2", &["1|2"]),
            ("continued_keyword", b"v\\\n1", &["1"]),
            ("continued_twice", b"v 1\\\n\\\n2", &["1|2"]),
            ("continued_at_end", b"v 1\\", &["1\\\\"]),
            ("backslash_within", b"g a\\b c\nv 1", &["g|a\\\\b|c", "1"]),
            ("comment_does_not_continue", b"v 1 # C:\\\nv 2", &["1", "2"]),
            ("comment_line_does_not_continue", b"# C:\\\nv 2", &["2"]),
            ("latin_1", b"g caf\xe9\nv 1", &["g|caf\\xe9", "1"]),
            ("nul", b"g a\0b\nv 1", &["g|a\\x00b", "1"]),
            ("words_that_start_alike", b"vt 1\nfo 2\nvn 3", &["vt|1", "fo|2", "vn|3"]),
        ];
        for (name, text, expected) in table {
            assert_eq!(&lines(text), expected, "{name}");
        }
    }

    #[test]
    fn unknown_lines_are_skipped_whole() {
        let table: &[(&str, &[u8])] = &[
            ("plain", b"usemtl a b\nX"),
            ("continued", b"usemtl a\\\nv 1 2 3\nX"),
            ("comment_does_not_continue", b"usemtl a # \\\nX"),
            ("crlf", b"usemtl a\r\nX"),
        ];
        for (name, text) in table {
            let mut cursor = Cursor::new(text, 0);
            cursor.skip_line();
            assert_eq!(text.get(cursor.offset()), Some(&b'X'), "{name}");
        }
    }

    #[test]
    fn boundaries_are_starts_of_logical_lines() {
        let table: &[(&str, &[u8], usize, usize)] = &[
            ("next_line", b"ab\ncd\nef", 1, 3),
            ("already_there", b"ab\ncd\nef", 3, 3),
            ("within_crlf", b"ab\r\ncd", 3, 4),
            ("behind_continuation", b"ab\\\ncd\nef", 1, 7),
            ("within_continued_crlf", b"ab\\\r\ncd\r\nef", 4, 9),
            ("none", b"abcdef", 2, 6),
            ("behind_the_end", b"ab", 9, 2),
        ];
        for &(name, text, from, expected) in table {
            assert_eq!(next_boundary(text, from), expected, "{name}");
        }
    }

    #[test]
    fn physical_lines() {
        let text = b"a\nb\r\nc\rd\\\ne";
        for (word, line) in [(b'a', 1), (b'b', 2), (b'c', 3), (b'd', 4), (b'e', 5)] {
            let offset = memchr(word, text).unwrap();
            assert_eq!(line_number(text, offset), line);
        }
    }
}
