//! `Range: bytes=...` with one range (RFC 9110, section 14). Several ranges are ignored, as the RFC
//! allows: no client needs them for a mesh, and answers to many small ranges cost more than the
//! file.

use std::ops::Range;

use axum::http::{HeaderMap, header};

/// The part of a resource that a request asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum RequestedRange {
    /// The whole resource: no range is given, or none that is understood.
    Whole,
    /// These bytes; at least one, and all of them exist.
    Part(Range<u64>),
    /// 416: bytes that do not exist.
    Unsatisfiable,
}

/// The part of a resource of `length` bytes that the headers ask for.
pub(super) fn wanted(headers: &HeaderMap, length: u64) -> RequestedRange {
    let mut lines = headers.get_all(header::RANGE).iter();
    let (Some(line), None) = (lines.next(), lines.next()) else { return RequestedRange::Whole };
    line.to_str().ok().and_then(|line| read(line, length)).unwrap_or(RequestedRange::Whole)
}

/// Reads one range of bytes; `None` for anything else.
fn read(line: &str, length: u64) -> Option<RequestedRange> {
    let (unit, range) = line.split_once('=')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return None;
    }
    let (first, last) = range.trim().split_once('-')?;
    let range = match (first, last) {
        ("", suffix) => length.saturating_sub(number(suffix)?)..length,
        (first, "") => number(first)?..length,
        (first, last) => {
            let (first, last) = (number(first)?, number(last)?);
            if first > last {
                return None;
            }
            first..last.saturating_add(1).min(length)
        }
    };
    Some(if range.is_empty() { RequestedRange::Unsatisfiable } else { RequestedRange::Part(range) })
}

/// Digits only; a number too large for a file counts as the largest.
fn number(digits: &str) -> Option<u64> {
    if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    Some(digits.parse().unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use proptest::prelude::*;

    fn of(line: &str, length: u64) -> RequestedRange {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, HeaderValue::from_str(line).unwrap());
        wanted(&headers, length)
    }

    #[test]
    fn one_range_is_read_and_others_are_ignored() {
        use RequestedRange::{Part, Unsatisfiable, Whole};
        for (line, expected) in [
            ("bytes=0-0", Part(0..1)),
            ("bytes=0-9", Part(0..10)),
            ("BYTES=2-5", Part(2..6)),
            ("bytes= 2-5 ", Part(2..6)),
            ("bytes=5-", Part(5..10)),
            ("bytes=5-99999999999999999999999999", Part(5..10)),
            ("bytes=-3", Part(7..10)),
            ("bytes=-30", Part(0..10)),
            ("bytes=10-", Unsatisfiable),
            ("bytes=10-12", Unsatisfiable),
            ("bytes=99999999999999999999999999-", Unsatisfiable),
            ("bytes=-0", Unsatisfiable),
            ("bytes=5-2", Whole),
            ("bytes=0-1,3-4", Whole),
            ("bytes=-", Whole),
            ("bytes=", Whole),
            ("bytes=a-b", Whole),
            ("bytes=+1-2", Whole),
            ("bytes=1--2", Whole),
            ("items=0-1", Whole),
            ("0-1", Whole),
        ] {
            assert_eq!(of(line, 10), expected, "{line}");
        }
        assert_eq!(of("bytes=0-", 0), Unsatisfiable);
        assert_eq!(wanted(&HeaderMap::new(), 10), Whole);
        let mut twice = HeaderMap::new();
        twice.append(header::RANGE, HeaderValue::from_static("bytes=0-1"));
        twice.append(header::RANGE, HeaderValue::from_static("bytes=3-4"));
        assert_eq!(wanted(&twice, 10), Whole);
    }

    proptest! {
        #[test]
        fn a_part_is_never_empty_and_always_there(line in "bytes=[0-9]{0,22}-[0-9]{0,22}", length: u64) {
            if let RequestedRange::Part(part) = of(&line, length) {
                prop_assert!(part.start < part.end && part.end <= length);
            }
        }

        #[test]
        fn first_and_last_are_both_inside(first in 0..2000_u64, more in 0..2000_u64, length in 1..2000_u64) {
            let last = first + more;
            let expected = if first >= length {
                RequestedRange::Unsatisfiable
            } else {
                RequestedRange::Part(first..(last + 1).min(length))
            };
            prop_assert_eq!(of(&format!("bytes={first}-{last}"), length), expected);
        }
    }
}
