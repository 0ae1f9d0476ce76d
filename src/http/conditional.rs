//! Conditional requests as RFC 9110, section 13 defines them, for a resource that has a strong
//! entity tag and no modification date.

use axum::http::{HeaderMap, HeaderName, header};

/// The outcome of a request's conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Answer as if there were no conditions.
    Proceed,
    /// 304: the client already has this representation.
    NotModified,
    /// 412: the client asked for another representation.
    Failed,
}

/// Evaluates `If-Match` and `If-None-Match` of a GET or HEAD, in the order of section 13.2.2. `tag`
/// is the entity tag, with its quotes. Dates are ignored, as sections 13.1.3 and 13.1.4 require for
/// a resource without a date.
pub(super) fn evaluate(headers: &HeaderMap, tag: &str) -> Outcome {
    if listed(headers, &header::IF_MATCH, tag, Comparison::Strong) == Some(false) {
        return Outcome::Failed;
    }
    if listed(headers, &header::IF_NONE_MATCH, tag, Comparison::Weak) == Some(true) {
        return Outcome::NotModified;
    }
    Outcome::Proceed
}

/// Whether a `Range` applies: there is no `If-Range`, or it names this entity tag. A date never
/// matches, because the resource has none.
pub(super) fn range_applies(headers: &HeaderMap, tag: &str) -> bool {
    let mut named = headers.get_all(header::IF_RANGE).iter();
    named.all(|value| value.as_bytes().trim_ascii() == tag.as_bytes())
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Comparison {
    Strong,
    Weak,
}

/// Whether the header names the tag, or is `*`; `None` if the header is absent. A value that is not
/// a list of tags names nothing.
fn listed(
    headers: &HeaderMap,
    name: &HeaderName,
    tag: &str,
    comparison: Comparison,
) -> Option<bool> {
    if !headers.contains_key(name) {
        return None;
    }
    let named = headers.get_all(name).iter().any(|value| {
        let value = value.as_bytes().trim_ascii();
        value == b"*"
            || tags(value).any(|(weak, other)| {
                other == tag.as_bytes() && (comparison == Comparison::Weak || !weak)
            })
    });
    Some(named)
}

/// The tags of a list, each with whether it is weak. A tag keeps its quotes and may contain commas.
fn tags(mut rest: &[u8]) -> impl Iterator<Item = (bool, &[u8])> {
    std::iter::from_fn(move || {
        let start = rest.iter().position(|byte| !b", \t".contains(byte))?;
        let (_, from) = rest.split_at_checked(start)?;
        let strong = from.strip_prefix(b"W/");
        let quoted = strong.unwrap_or(from);
        let inside = quoted.strip_prefix(b"\"")?;
        let end = inside.iter().position(|&byte| byte == b'"')?;
        let (tag, after) = quoted.split_at_checked(end + 2)?;
        rest = after;
        Some((strong.is_some(), tag))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    const TAG: &str = "\"abc\"";

    fn headers(lines: &[(&'static str, &'static str)]) -> HeaderMap {
        let line = |&(name, value): &(&'static str, &'static str)| {
            (HeaderName::from_static(name), HeaderValue::from_static(value))
        };
        let mut headers = HeaderMap::new();
        for (name, value) in lines.iter().map(line) {
            headers.append(name, value);
        }
        headers
    }

    #[test]
    fn the_order_of_rfc_9110() {
        use Outcome::{Failed, NotModified, Proceed};
        let cases: &[(&[(&str, &str)], Outcome)] = &[
            (&[], Proceed),
            (&[("if-none-match", "\"abc\"")], NotModified),
            (&[("if-none-match", "W/\"abc\"")], NotModified),
            (&[("if-none-match", "*")], NotModified),
            (&[("if-none-match", " * ")], NotModified),
            (&[("if-none-match", "\"x\", W/\"y\" ,\t\"abc\"")], NotModified),
            (&[("if-none-match", "\"a,b\",\"abc\"")], NotModified),
            (&[("if-none-match", "\"x\""), ("if-none-match", "\"abc\"")], NotModified),
            (&[("if-none-match", "\"x\"")], Proceed),
            (&[("if-none-match", "abc")], Proceed),
            (&[("if-none-match", "\"x,\"abc\"")], Proceed),
            (&[("if-none-match", "\"abc")], Proceed),
            (&[("if-none-match", "w/\"abc\"")], Proceed),
            (&[("if-none-match", "")], Proceed),
            (&[("if-match", "\"abc\"")], Proceed),
            (&[("if-match", "*")], Proceed),
            (&[("if-match", "\"x\""), ("if-match", "\"y\", \"abc\"")], Proceed),
            (&[("if-match", "W/\"abc\"")], Failed),
            (&[("if-match", "\"x\"")], Failed),
            (&[("if-match", "abc")], Failed),
            // If-Match comes first.
            (&[("if-match", "\"x\""), ("if-none-match", "\"abc\"")], Failed),
            (&[("if-match", "\"abc\""), ("if-none-match", "\"abc\"")], NotModified),
            // There is no date to compare with.
            (&[("if-modified-since", "Sun, 06 Nov 2050 08:49:37 GMT")], Proceed),
            (&[("if-unmodified-since", "Sun, 06 Nov 1994 08:49:37 GMT")], Proceed),
        ];
        for (lines, expected) in cases {
            assert_eq!(evaluate(&headers(lines), TAG), *expected, "{lines:?}");
        }
    }

    #[test]
    fn if_range_compares_strongly() {
        for (value, applies) in [
            ("\"abc\"", true),
            ("W/\"abc\"", false),
            ("\"x\"", false),
            ("*", false),
            ("Sun, 06 Nov 1994 08:49:37 GMT", false),
        ] {
            assert_eq!(range_applies(&headers(&[("if-range", value)]), TAG), applies, "{value}");
        }
        assert!(range_applies(&HeaderMap::new(), TAG));
    }
}
