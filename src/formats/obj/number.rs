//! One coordinate: its value, correctly rounded, and how many decimals it was written with.

use super::cursor::{Cursor, ends_token};
use super::precision::POWERS_OF_TEN;

/// All integers up to this one are exact as doubles.
const EXACT: u64 = 1 << 53;

/// A coordinate as it stands in the text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coordinate {
    /// The nearest double. May be infinite or NaN.
    pub(super) value: f64,
    /// Decimals of its fixed-point spelling: digits after the point, minus the exponent.
    pub(super) decimals: usize,
    /// Where the token starts. It ends at the cursor.
    pub(super) start: usize,
}

/// Why there is no coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoCoordinate {
    /// The logical line ends.
    Missing,
    /// A token that is not a number; the cursor stands after it.
    Junk {
        /// Where it starts.
        start: usize,
    },
}

/// Reads the next token of the line as a number.
pub(super) fn coordinate(cursor: &mut Cursor<'_>) -> Result<Coordinate, NoCoordinate> {
    cursor.skip_blank();
    let start = cursor.offset();
    if let Some((value, decimals, end)) = plain(cursor.text(), start) {
        cursor.move_to(end);
        return Ok(Coordinate { value, decimals, start });
    }
    let token = cursor.token().ok_or(NoCoordinate::Missing)?;
    let value = fast_float2::parse(token).map_err(|_| NoCoordinate::Junk { start })?;
    if is_msvc_non_finite(cursor.text(), cursor.offset()) {
        return Ok(Coordinate { value: f64::NAN, decimals: 0, start });
    }
    Ok(Coordinate { value, decimals: decimals(token), start })
}

/// The common case: sign, digits, point, digits, and small enough that digits / power of ten is one
/// division of two exact doubles, which IEEE 754 rounds correctly (Clinger 1990). This loop also
/// gives the decimals: one pass over the bytes instead of three.
#[inline]
fn plain(text: &[u8], start: usize) -> Option<(f64, usize, usize)> {
    let mut at = start;
    let negative = match text.get(at)? {
        b'-' => {
            at += 1;
            true
        }
        b'+' => {
            at += 1;
            false
        }
        _ => false,
    };
    let first = at;
    let mut digits = 0_u64;
    let mut point = None;
    while let Some(&byte) = text.get(at) {
        let digit = byte.wrapping_sub(b'0');
        if digit < 10 {
            digits = digits.wrapping_mul(10).wrapping_add(u64::from(digit));
        } else if byte == b'.' && point.is_none() {
            point = Some(at);
        } else {
            break;
        }
        at += 1;
    }
    let decimals = point.map_or(0, |point| at - point - 1);
    let length = at - first - usize::from(point.is_some());
    // 19 digits cannot overflow 64 bits, so `digits` has not wrapped.
    let exact = (1..=19).contains(&length) && digits <= EXACT;
    if !exact || text.get(at) == Some(&b'#') || !ends_token(text, at) {
        return None;
    }
    let value = digits as f64 / POWERS_OF_TEN.get(decimals)?;
    Some((if negative { -value } else { value }, decimals, at))
}

/// Old Microsoft runtimes print NaN as `-1.#IND`. The comment sign must not turn it into -1.
fn is_msvc_non_finite(text: &[u8], end: usize) -> bool {
    let rest = text.get(end..).unwrap_or_default();
    [&b"#IND"[..], b"#INF", b"#QNAN", b"#SNAN"].iter().any(|marker| rest.starts_with(marker))
}

/// Decimals of the token's fixed-point spelling: digits after the point, minus the exponent.
fn decimals(token: &[u8]) -> usize {
    let exponent_sign = token.iter().position(|byte| matches!(byte, b'e' | b'E'));
    let (mantissa, exponent) = token.split_at(exponent_sign.unwrap_or(token.len()));
    let behind_point = mantissa
        .iter()
        .position(|&byte| byte == b'.')
        .map_or(0, |point| mantissa.len() - point - 1);
    let exponent = exponent
        .get(1..)
        .and_then(|digits| std::str::from_utf8(digits).ok())
        .and_then(|digits| digits.parse::<i64>().ok())
        .unwrap_or(0);
    let needed = i64::try_from(behind_point).unwrap_or(i64::MAX).saturating_sub(exponent);
    usize::try_from(needed).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(text: &str) -> Result<Coordinate, NoCoordinate> {
        coordinate(&mut Cursor::new(text.as_bytes(), 0))
    }

    #[test]
    fn values_and_decimals() {
        let table = [
            ("1", 1.0, 0),
            ("+1.50", 1.5, 2),
            ("-.5", -0.5, 1),
            ("3.", 3.0, 0),
            ("-0.0", -0.0, 1),
            ("0.032027", 0.032_027, 6),
            ("1e3", 1000.0, 0),
            ("1.25e-3", 0.001_25, 5),
            ("1.25E+1", 12.5, 1),
            ("1.e2", 100.0, 0),
            ("+.5e1", 5.0, 0),
            ("1e-300", 1e-300, 300),
            ("0.1234567890123456789012345", 0.123_456_789_012_345_68, 25),
            ("9007199254740993", 9_007_199_254_740_992.0, 0),
            ("123456789012345678901234567890", 1.234_567_890_123_456_8e29, 0),
        ];
        for (text, value, decimals) in table {
            let read = read(text).unwrap();
            assert_eq!(f64::to_bits(value), read.value.to_bits(), "{text}");
            assert_eq!(decimals, read.decimals, "{text}");
        }
    }

    #[test]
    fn non_finite_values_are_told_apart_from_junk() {
        for text in ["nan", "-inf", "Infinity", "1e999", "-1.#IND", "1.#QNAN0", "1.#INF"] {
            assert!(!read(text).unwrap().value.is_finite(), "{text}");
        }
        for text in ["x", "1,5", "1.2.3", "--1", "-", ".", "1e", "0x10", "1\0", "1d3", "\\1"] {
            assert_eq!(read(text), Err(NoCoordinate::Junk { start: 0 }), "{text}");
        }
        for text in ["", "  ", " # 1", "\n1", "\r1"] {
            assert_eq!(read(text), Err(NoCoordinate::Missing), "{text:?}");
        }
    }

    proptest! {
        #[test]
        fn values_are_those_of_the_standard_library(
            text in "[+-]?([0-9]{1,22}(\\.[0-9]{0,22})?|\\.[0-9]{1,22})([eE][+-]?[0-9]{1,3})?"
        ) {
            let expected: f64 = text.parse().unwrap();
            prop_assert_eq!(read(&text).unwrap().value.to_bits(), expected.to_bits());
        }
    }
}
