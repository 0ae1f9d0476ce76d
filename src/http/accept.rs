//! What a caller accepts as the answer to an embedding: the `Accept` header, as RFC 9110 defines it
//! (section 12.5.1).
//!
//! The answer is the marked file, in the media type of the upload, or the record as JSON. If a
//! caller accepts both equally (`*/*`, or axios' `application/json, text/plain, */*`), the answer
//! is the file. Errors are problem documents, whatever the header says.
//!
//! Existing crates choose among equals in the caller's order, and would answer axios with JSON.

use axum::http::{HeaderMap, header};

use super::code::Code;
use super::error::ApiError;
use crate::formats::Format;

/// The media type of a record.
const JSON: &str = "application/json";

/// Weights are thousandths: RFC 9110 gives them three decimals.
const FULL: u16 = 1000;

/// The form of the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AnswerForm {
    /// The marked file.
    File,
    /// The record.
    Record,
}

/// The ranges of an `Accept` header; empty if anything is accepted.
#[derive(Debug, Default)]
pub(super) struct Accept(Vec<Range>);

/// A media range with its weight. Parameters of the type are ignored: the media types here have
/// none, and a caller that sends `application/json; charset=utf-8` means JSON.
#[derive(Debug, PartialEq, Eq)]
struct Range {
    /// In lower case; `*` for any.
    kind: String,
    subtype: String,
    weight: u16,
}

impl Accept {
    /// Reads the header and skips what cannot be read.
    pub(super) fn of(headers: &HeaderMap) -> Self {
        let values = headers.get_all(header::ACCEPT);
        let texts = values.iter().filter_map(|value| value.to_str().ok());
        Self(texts.flat_map(|text| split(text, ',')).filter_map(Range::parse).collect())
    }

    /// The weight of a media type: that of the most specific range that includes it; 0 if none
    /// does.
    fn weight(&self, media_type: &str) -> u16 {
        if self.0.is_empty() {
            return FULL;
        }
        let ranges =
            self.0.iter().filter_map(|range| Some((range.specificity(media_type)?, range)));
        // Of equally specific ranges, the one with the largest weight.
        let most = ranges.max_by_key(|(specificity, range)| (*specificity, range.weight));
        most.map_or(0, |(_, range)| range.weight)
    }

    /// The form of the answer to an upload of this format; `None` if the caller accepts neither.
    pub(super) fn wanted(&self, format: Format) -> Option<AnswerForm> {
        match (self.weight(format.media_type()), self.weight(JSON)) {
            (0, 0) => None,
            (file, json) if file >= json => Some(AnswerForm::File),
            _ => Some(AnswerForm::Record),
        }
    }

    /// The upload formats that the service can answer in a form that the caller accepts.
    ///
    /// # Errors
    /// 406 if there is none, before the upload is read.
    pub(super) fn formats(&self) -> Result<Vec<Format>, ApiError> {
        let mut formats = Format::ALL.to_vec();
        formats.retain(|&format| self.wanted(format).is_some());
        if formats.is_empty() {
            return Err(not_acceptable("the marked file, in the media type of the upload"));
        }
        Ok(formats)
    }
}

/// The error for an answer that the caller does not accept.
pub(super) fn not_acceptable(answer: &str) -> ApiError {
    ApiError::new(
        Code::NotAcceptable,
        format!(
            "the answer would be {answer}, or its record as {JSON}, and the Accept header takes \
             neither; send Accept: */* for the file (OBJ is model/obj, GLB model/gltf-binary, glTF \
             model/gltf+json) or Accept: {JSON} for the record"
        ),
    )
}

impl Range {
    fn parse(text: &str) -> Option<Self> {
        let mut parts = split(text, ';');
        let range = parts.next()?.trim().to_ascii_lowercase();
        // Old Java clients send a bare star.
        let (kind, subtype) = if range == "*" { ("*", "*") } else { range.split_once('/')? };
        let is_token = |text: &str| {
            !text.is_empty()
                && text
                    .bytes()
                    .all(|b| b.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&b))
        };
        if !is_token(kind) || !is_token(subtype) || (kind == "*" && subtype != "*") {
            return None;
        }
        let mut weight = FULL;
        for part in parts {
            if let Some((name, value)) = part.split_once('=')
                && name.trim().eq_ignore_ascii_case("q")
            {
                weight = parse_weight(value.trim())?;
            }
        }
        Some(Self { kind: kind.to_owned(), subtype: subtype.to_owned(), weight })
    }

    /// How specifically this range names a media type; `None` if it does not.
    fn specificity(&self, media_type: &str) -> Option<u8> {
        let (kind, subtype) = media_type.split_once('/')?;
        match (self.kind.as_str(), self.subtype.as_str()) {
            ("*", _) => Some(0),
            (own, "*") if own == kind => Some(1),
            (own, own_subtype) if own == kind && own_subtype == subtype => Some(2),
            _ => None,
        }
    }
}

/// Reads `0` to `1` with at most three decimals, in thousandths. Also reads `.5`, which Java
/// clients send.
fn parse_weight(text: &str) -> Option<u16> {
    let (whole, decimals) = text.split_once('.').unwrap_or((text, ""));
    if decimals.len() > 3 || !decimals.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let thousandths: u16 = format!("{decimals:0<3}").parse().ok()?;
    match whole {
        "0" => Some(thousandths),
        "" if !decimals.is_empty() => Some(thousandths),
        "1" if thousandths == 0 => Some(FULL),
        _ => None,
    }
}

/// Splits at a separator that is not in quotes.
fn split(text: &str, separator: char) -> impl Iterator<Item = &str> {
    let (mut quoted, mut escaped) = (false, false);
    text.split(move |letter| {
        let here = !quoted && letter == separator;
        match letter {
            _ if escaped => escaped = false,
            '\\' if quoted => escaped = true,
            '"' => quoted = !quoted,
            _ => {}
        }
        here
    })
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn accept(lines: &[&str]) -> Accept {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(header::ACCEPT, HeaderValue::from_str(line).unwrap());
        }
        Accept::of(&headers)
    }

    #[test]
    fn what_callers_send() {
        use AnswerForm::{File, Record};
        let table: &[(&[&str], Option<AnswerForm>)] = &[
            (&[], Some(File)),
            (&[""], Some(File)),
            (&["*/*"], Some(File)),
            // axios, fetch in a browser, and an old Java client.
            (&["application/json, text/plain, */*"], Some(File)),
            (
                &["text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,*/*;q=0.8"],
                Some(File),
            ),
            (&["text/html, image/gif, image/jpeg, *; q=.2, */*; q=.2"], Some(File)),
            (&["application/json"], Some(Record)),
            (&["application/json; charset=utf-8"], Some(Record)),
            (&["Application/JSON;Q=0.5"], Some(Record)),
            (&["application/*"], Some(Record)),
            (&["model/*"], Some(File)),
            (&["model/obj"], Some(File)),
            (&["MODEL/OBJ"], Some(File)),
            (&["application/json, */*;q=0.5"], Some(Record)),
            (&["application/json;q=0.5, */*"], Some(File)),
            (&["application/json;q=0.5, model/obj;q=0.499"], Some(Record)),
            (&["application/json;q=0.5", "model/obj;q=0.501"], Some(File)),
            (&["application/json", "model/obj"], Some(File)),
            // The most specific range counts, whatever its position.
            (&["*/*;q=1, model/*;q=0.1, model/obj;q=0.9, application/json;q=0.8"], Some(File)),
            (&["*/*, model/*;q=0.1"], Some(Record)),
            (&["*/*, model/obj;q=0, application/json;q=0"], None),
            (&["model/obj;q=0, */*"], Some(Record)),
            (&["application/json;q=0, */*;q=0.001"], Some(File)),
            (&["application/json;q=0"], None),
            (&["*/*;q=0"], None),
            (&["text/html"], None),
            (&["model/gltf-binary"], None),
            (&["model/gltf-binary, application/json;q=0.1"], Some(Record)),
            // Separators in quotes do not separate.
            (&["text/x;a=\", application/json\\\", \""], None),
            (&["text/x;a=\"1;q=0\", model/obj"], Some(File)),
            // What cannot be read is skipped.
            (&["nonsense, application/json"], Some(Record)),
            (&["application/json;q=2, model/obj;q=0.1"], Some(File)),
            (&["application/json;q=0.1234, model/obj;q=0.1"], Some(File)),
            (&["*/json, model/obj;q=0.1"], Some(File)),
        ];
        for (lines, wanted) in table {
            assert_eq!(accept(lines).wanted(Format::Obj), *wanted, "{lines:?}");
        }
    }

    #[test]
    fn formats_that_can_be_answered() {
        let formats = |line| accept(&[line]).formats();
        assert_eq!(formats("*/*").unwrap(), Format::ALL);
        assert_eq!(formats("application/json").unwrap(), Format::ALL);
        assert_eq!(
            formats("model/gltf-binary, model/obj;q=0.1").unwrap(),
            [Format::Obj, Format::Glb]
        );
        assert!(formats("image/png").is_err());
    }

    #[test]
    fn weights() {
        let table = [
            ("0", Some(0)),
            ("1", Some(1000)),
            ("0.5", Some(500)),
            ("0.001", Some(1)),
            ("1.000", Some(1000)),
            ("0.", Some(0)),
            (".2", Some(200)),
            ("1.001", None),
            ("2", None),
            ("-1", None),
            ("0.0001", None),
            ("", None),
            (".", None),
            ("nan", None),
            ("0.+5", None),
        ];
        for (text, weight) in table {
            assert_eq!(parse_weight(text), weight, "{text:?}");
        }
    }
}
