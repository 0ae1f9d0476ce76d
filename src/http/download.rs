//! Marked files as answers: media type, a safe file name, an entity tag.

use std::fmt::Write;

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::Response;

use crate::registry::Record;

pub(super) const EXISTING: HeaderName = HeaderName::from_static("quadmark-existing-marks");

/// Most characters of the stem of a file name.
const LONGEST_STEM: usize = 100;

pub(super) fn etag(record: &Record) -> String {
    format!("\"{}\"", hex::encode(record.marked_sha256))
}

/// Ids of the marks that the host already carried; `None` if there are none.
fn existing_marks(record: &Record) -> Option<String> {
    let marks = record.existing_marks.as_deref().filter(|marks| !marks.is_empty())?;
    let ids: Vec<String> = marks.iter().map(|mark| mark.watermark_id.to_string()).collect();
    Some(ids.join(","))
}

/// An answer of `bytes` bytes. The length is sent first, so that a body that ends early breaks the
/// connection and is not taken for the whole file.
pub(super) fn answer_file(record: &Record, body: Body, bytes: u64) -> Response {
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    let kind = HeaderValue::from_static(record.format.media_type());
    headers.insert(header::CONTENT_TYPE, kind);
    let disposition = disposition(record.file_name.as_deref(), record.format.extension());
    for (name, value) in [(header::CONTENT_DISPOSITION, disposition), (header::ETAG, etag(record))]
    {
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(name, value);
        }
    }
    if let Some(ids) = existing_marks(record)
        && let Ok(ids) = HeaderValue::try_from(ids)
    {
        headers.insert(EXISTING, ids);
    }
    response
}

/// `attachment` with the upload's name, `-marked` and the format's extension.
///
/// The name comes from a stranger. Quotes and line breaks could add headers, and path separators
/// could choose a directory on the machine that saves the file. So the plain form holds letters,
/// digits and `._-` only; `filename*` (RFC 8187) holds all other characters, percent-encoded.
fn disposition(name: Option<&str>, extension: &str) -> String {
    let base = name.and_then(|name| name.rsplit(['/', '\\']).next()).unwrap_or_default();
    let stem = base.rsplit_once('.').map_or(base, |(stem, _)| stem);
    let visible = stem.chars().filter(|c| !c.is_control()).take(LONGEST_STEM);
    let stem: String = visible.collect::<String>().trim_matches([' ', '.']).to_owned();
    let stem = if stem.is_empty() { "mesh".to_owned() } else { stem };
    let full = format!("{stem}-marked.{extension}");
    let plain_character = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let plain: String = full.chars().map(|c| if plain_character(c) { c } else { '_' }).collect();
    if plain == full {
        return format!("attachment; filename=\"{plain}\"");
    }
    let mut encoded = String::with_capacity(full.len() * 3);
    for byte in full.bytes() {
        if plain_character(char::from(byte)) {
            encoded.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(encoded, "%{byte:02X}");
        }
    }
    format!("attachment; filename=\"{plain}\"; filename*=UTF-8''{encoded}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_safe() {
        let cases = [
            (Some("gear.obj"), "attachment; filename=\"gear-marked.obj\""),
            (Some("a.b.OBJ"), "attachment; filename=\"a.b-marked.obj\""),
            (None, "attachment; filename=\"mesh-marked.obj\""),
            (Some("../../etc/passwd"), "attachment; filename=\"passwd-marked.obj\""),
            (Some("C:\\x\\y.obj"), "attachment; filename=\"y-marked.obj\""),
            (Some("..."), "attachment; filename=\"mesh-marked.obj\""),
            (
                Some("a\"\r\nSet-Cookie: b.obj"),
                "attachment; filename=\"a_Set-Cookie__b-marked.obj\"; \
                 filename*=UTF-8''a%22Set-Cookie%3A%20b-marked.obj",
            ),
            (
                Some("R\u{e4}der.obj"),
                "attachment; filename=\"R_der-marked.obj\"; \
                 filename*=UTF-8''R%C3%A4der-marked.obj",
            ),
        ];
        for (name, expected) in cases {
            let found = disposition(name, "obj");
            assert_eq!(found, expected);
            assert!(HeaderValue::try_from(found).is_ok());
        }
        assert!(disposition(Some(&"x".repeat(5000)), "obj").len() < 200);
    }
}
