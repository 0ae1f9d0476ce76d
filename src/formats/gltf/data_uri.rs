//! Base64 data URIs, the way a `.gltf` file embeds its buffers.
//!
//! Decodes tolerantly (percent escapes, missing padding); re-encodes in the host's own style, so
//! that a payload in canonical form changes only where its bytes changed.

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

const PADDED: GeneralPurpose = engine(true);
const UNPADDED: GeneralPurpose = engine(false);

const fn engine(padding: bool) -> GeneralPurpose {
    let config = GeneralPurposeConfig::new()
        .with_encode_padding(padding)
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true);
    GeneralPurpose::new(&STANDARD, config)
}

/// A data URI cut at its comma.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DataUri<'a> {
    /// Up to and including the comma.
    head: &'a str,
    payload: &'a str,
}

/// `None` when it is not a data URI at all, but the name of a file.
pub(super) fn parse(uri: &str) -> Option<DataUri<'_>> {
    if !uri.get(..5)?.eq_ignore_ascii_case("data:") {
        return None;
    }
    // Without a comma there is no payload; decoding then says so.
    let cut = memchr::memchr(b',', uri.as_bytes()).map_or(uri.len(), |comma| comma + 1);
    let (head, payload) = uri.split_at_checked(cut)?;
    Some(DataUri { head, payload })
}

impl DataUri<'_> {
    /// The bytes it stands for, or what is wrong.
    pub(super) fn decode(&self) -> Result<Vec<u8>, String> {
        let head = self.head.strip_suffix(',').ok_or("the data URI has no comma")?;
        let mark = head.len().checked_sub(7).and_then(|at| head.get(at..));
        if !mark.is_some_and(|mark| mark.eq_ignore_ascii_case(";base64")) {
            return Err("the data URI is not base64: embed the buffer as base64".to_owned());
        }
        let decoded = if self.payload.contains('%') {
            PADDED.decode(unescape(self.payload))
        } else {
            PADDED.decode(self.payload)
        };
        decoded.map_err(|error| format!("the base64 data cannot be read ({error})"))
    }

    /// The same URI with other bytes, as many as before.
    pub(super) fn encode(&self, bytes: &[u8]) -> String {
        let unpadded = !self.payload.len().is_multiple_of(4) && !self.payload.contains('%');
        let engine = if unpadded { UNPADDED } else { PADDED };
        let mut text = String::with_capacity(self.head.len() + bytes.len().div_ceil(3) * 4);
        text.push_str(self.head);
        engine.encode_string(bytes, &mut text);
        text
    }
}

fn unescape(text: &str) -> Vec<u8> {
    let mut out = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        rest = tail;
        let escaped = (first == b'%')
            .then(|| tail.get(..2))
            .flatten()
            .and_then(|hex| u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok());
        if let Some(byte) = escaped {
            out.push(byte);
            rest = tail.get(2..).unwrap_or_default();
        } else {
            out.push(first);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decodes_what_exporters_write() {
        for (uri, expected) in [
            ("data:application/octet-stream;base64,AQID", Ok(&[1, 2, 3][..])),
            ("data:application/gltf-buffer;base64,AQI=", Ok(&[1, 2])),
            ("data:;base64,AQI", Ok(&[1, 2])),
            ("DATA:x/y;charset=a;BASE64,AQI%3D", Ok(&[1, 2])),
            ("data:x;base64,", Ok(&[])),
            ("data:text/plain,AQID", Err(())),
            ("data:x;base64", Err(())),
            ("data:x;base64,A", Err(())),
            ("data:x;base64,AQ%ZZ", Err(())),
            ("data:x;base64,AQ D", Err(())),
        ] {
            let decoded = parse(uri).unwrap().decode();
            assert_eq!(decoded.as_deref().map_err(|_| ()), expected, "{uri}");
        }
        assert_eq!(parse("model.bin"), None);
        assert_eq!(parse("d\u{e4}ta:"), None);
        assert_eq!(parse("../../etc/passwd"), None);
    }

    #[test]
    fn encodes_in_the_hosts_style() {
        for uri in ["data:;base64,AQI=", "data:a/b;base64,AQI", "data:;base64,AQID"] {
            let parsed = parse(uri).unwrap();
            assert_eq!(parsed.encode(&parsed.decode().unwrap()), uri);
        }
    }
}
