//! Finds the byte span of a value in JSON text, so that one number can be replaced and every
//! other byte kept.
//!
//! Must not know glTF. Expects text that a real parser has accepted; on any other text the
//! answers are `None` or meaningless, never a panic. Nothing recurses.

use std::ops::Range;

/// The value of `key` in the object that stands at `object`; the last one of duplicates.
pub(super) fn member(text: &[u8], object: Range<usize>, key: &str) -> Option<Range<usize>> {
    let mut found = None;
    let mut at = enter(text, object.start, b'{')?;
    while byte(text, at)? != b'}' {
        let name_end = skip_string(text, at)?;
        let name = text.get(at..name_end)?;
        let start = blank(text, enter(text, blank(text, name_end), b':')?);
        let end = skip_value(text, start)?;
        if same_key(name, key) {
            found = Some(start..end);
        }
        at = next(text, end)?;
    }
    found
}

/// The elements of the array that stands at `array`.
pub(super) fn elements(text: &[u8], array: Range<usize>) -> Option<Vec<Range<usize>>> {
    let mut found = Vec::new();
    let mut at = enter(text, array.start, b'[')?;
    while byte(text, at)? != b']' {
        let end = skip_value(text, at)?;
        found.push(at..end);
        at = next(text, end)?;
    }
    Some(found)
}

/// Where the first value in `range` starts.
pub(super) fn root(text: &[u8], range: Range<usize>) -> Range<usize> {
    blank(text, range.start)..range.end
}

/// Whether brackets outside strings nest deeper than `levels`.
pub(super) fn nested_deeper_than(text: &[u8], levels: usize) -> bool {
    let mut depth = 0_usize;
    let mut at = 0;
    while let Some(&byte) = text.get(at) {
        at += 1;
        match byte {
            b'"' => match skip_string(text, at - 1) {
                Some(end) => at = end,
                None => return false,
            },
            b'{' | b'[' => {
                depth += 1;
                if depth > levels {
                    return true;
                }
            }
            b'}' | b']' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    false
}

fn byte(text: &[u8], at: usize) -> Option<u8> {
    text.get(at).copied()
}

fn blank(text: &[u8], mut at: usize) -> usize {
    while matches!(text.get(at), Some(b' ' | b'\t' | b'\n' | b'\r')) {
        at += 1;
    }
    at
}

/// Steps over `opening` and the white space behind it.
fn enter(text: &[u8], at: usize, opening: u8) -> Option<usize> {
    (byte(text, at)? == opening).then(|| blank(text, at + 1))
}

/// From the end of an item to the next one or to the closing bracket.
fn next(text: &[u8], end: usize) -> Option<usize> {
    let at = blank(text, end);
    match byte(text, at)? {
        b',' => Some(blank(text, at + 1)),
        b'}' | b']' => Some(at),
        _ => None,
    }
}

fn skip_string(text: &[u8], at: usize) -> Option<usize> {
    if byte(text, at)? != b'"' {
        return None;
    }
    let mut at = at + 1;
    loop {
        // Embedded buffers are strings of many megabytes.
        at += memchr::memchr2(b'"', b'\\', text.get(at..)?)?;
        if byte(text, at)? == b'"' {
            return Some(at + 1);
        }
        at += 2;
    }
}

fn skip_value(text: &[u8], start: usize) -> Option<usize> {
    match byte(text, start)? {
        b'"' => skip_string(text, start),
        b'{' | b'[' => {
            let mut depth = 0_usize;
            let mut at = start;
            loop {
                match byte(text, at)? {
                    b'"' => {
                        at = skip_string(text, at)?;
                        continue;
                    }
                    b'{' | b'[' => depth += 1,
                    b'}' | b']' => depth -= 1,
                    _ => {}
                }
                at += 1;
                if depth == 0 {
                    return Some(at);
                }
            }
        }
        _ => {
            let rest = text.get(start..)?;
            let length = rest
                .iter()
                .position(|b| matches!(b, b',' | b'}' | b']' | b' ' | b'\t' | b'\n' | b'\r'))
                .unwrap_or(rest.len());
            (length > 0).then_some(start + length)
        }
    }
}

/// `name` is a JSON string with its quotes, perhaps with escapes.
fn same_key(name: &[u8], key: &str) -> bool {
    if name.contains(&b'\\') {
        return serde_json::from_slice::<String>(name).is_ok_and(|name| name == key);
    }
    name.get(1..name.len().saturating_sub(1)) == Some(key.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at<'a>(text: &'a str, path: &[&str]) -> Option<&'a str> {
        let bytes = text.as_bytes();
        let mut span = root(bytes, 0..bytes.len());
        for step in path {
            span = match step.parse::<usize>() {
                Ok(index) => elements(bytes, span)?.get(index)?.clone(),
                Err(_) => member(bytes, span, step)?,
            };
        }
        text.get(span)
    }

    #[test]
    fn finds_values_in_odd_text() {
        let text = " \n{ \"a\" :[ 1 ,\t-2.5e+3,[],{}, \"x\\\"],\" ] , \"\\u0062\":{\"c\":null},\
                    \"a\\\\\" : 0, \"d\":1,\"d\":\"last\", \"e\": true}  ";
        for (path, expected) in [
            (&["a", "0"][..], Some("1")),
            (&["a", "1"], Some("-2.5e+3")),
            (&["a", "2"], Some("[]")),
            (&["a", "3"], Some("{}")),
            (&["a", "4"], Some("\"x\\\"],\"")),
            (&["a", "5"], None),
            (&["b", "c"], Some("null")),
            (&["b"], Some("{\"c\":null}")),
            (&["d"], Some("\"last\"")),
            (&["e"], Some("true")),
            (&["f"], None),
            (&["e", "x"], None),
        ] {
            assert_eq!(at(text, path), expected, "{path:?}");
        }
    }

    #[test]
    fn depth() {
        assert!(!nested_deeper_than(b"[[\"[[[[[\"]]", 2));
        assert!(nested_deeper_than(b"[[{}]]", 2));
        assert!(!nested_deeper_than(b"[[],[],[[]]]", 3));
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in r#"[\[\]{}",:\\ 0-9a-z]{0,60}"#, start in 0_usize..70) {
            let bytes = text.as_bytes();
            let _ = elements(bytes, start..bytes.len());
            let _ = member(bytes, start..bytes.len(), "a");
            let _ = nested_deeper_than(bytes, 3);
        }

        #[test]
        fn agrees_with_serde_json(numbers in proptest::collection::vec(any::<f64>(), 1..9)) {
            let numbers: Vec<f64> = numbers.into_iter().filter(|n| n.is_finite()).collect();
            let text = serde_json::json!({ "a,\"]": 1, "k": numbers }).to_string();
            for (i, number) in numbers.iter().enumerate() {
                let found = at(&text, &["k", &i.to_string()]).unwrap();
                prop_assert_eq!(found.parse::<f64>().unwrap().to_bits(), number.to_bits());
            }
        }
    }
}
