//! Recognises the format of a file by its content, never by a name or a media type: curl sends
//! `application/octet-stream`, and people rename files.
//!
//! OBJ has no signature, so it comes last: any text with a line of a vertex or a face. Formats that
//! cannot be read are named, because "convert your PLY file" helps and "unknown format" does not.

use memchr::memmem;

use super::obj::{Cursor, Statement};
use super::{Format, FormatError};

/// Bytes at the start of a file that are searched for a word that distinguishes two formats.
const HEAD_BYTES: usize = 4096;

/// Bytes of lines foreign to OBJ that are read, at most, in search of a vertex or a face.
const MOST_UNKNOWN_BYTES: usize = 1 << 20;

/// First bytes of formats that cannot be read, and the names of these formats.
const SIGNATURES: &[(&[u8], &str)] = &[
    (b"ply\n", "a PLY file"),
    (b"ply\r", "a PLY file"),
    (b"OFF", "an OFF file"),
    (b"COFF", "an OFF file"),
    (b"NOFF", "an OFF file"),
    (b"STOFF", "an OFF file"),
    (b"Kaydara FBX", "an FBX file"),
    (b"; FBX", "an FBX file"),
    (b"PK\x03\x04", "a ZIP archive (3MF, USDZ or a zipped file)"),
    (b"\x1f\x8b", "a gzip-compressed file"),
    (b"\x28\xb5\x2f\xfd", "a Zstandard-compressed file"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"%PDF", "a PDF document"),
    (b"#usda", "a USD file"),
    (b"PXR-USDC", "a USD file"),
    (b"#VRML", "a VRML file"),
    (b"BLENDER", "a Blender file"),
    (b"DRACO", "a bare Draco stream"),
    (b"ISO-10303-21", "a STEP file"),
    (b"\xff\xfe", "a UTF-16 text (save it as UTF-8)"),
    (b"\xfe\xff", "a UTF-16 text (save it as UTF-8)"),
];

/// First words of other lines that an OBJ may have in any number.
const OBJ_WORDS: &[&[u8]] = &[
    b"vt",
    b"vn",
    b"vp",
    b"o",
    b"g",
    b"s",
    b"mg",
    b"usemtl",
    b"mtllib",
    b"usemap",
    b"maplib",
    b"l",
    b"p",
    b"cstype",
    b"deg",
    b"bmat",
    b"step",
    b"curv",
    b"curv2",
    b"surf",
    b"parm",
    b"trim",
    b"hole",
    b"scrv",
    b"sp",
    b"end",
    b"con",
    b"bevel",
    b"c_interp",
    b"d_interp",
    b"lod",
];

/// Names the format of a file from its content.
///
/// # Errors
/// [`FormatError::Empty`], or [`FormatError::UnknownFormat`] naming what it looks like.
pub fn sniff(bytes: &[u8]) -> Result<Format, FormatError> {
    if bytes.is_empty() {
        return Err(FormatError::Empty);
    }
    if bytes.starts_with(b"glTF") {
        return Ok(Format::Glb);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = text.trim_ascii_start();
    if text.first() == Some(&b'{') {
        return Ok(Format::Gltf);
    }
    if let Some(name) = foreign(bytes, text) {
        return unknown(format!("this looks like {name}"));
    }
    if looks_like_obj(text) {
        return Ok(Format::Obj);
    }
    unknown("this is not a mesh file that quadmark knows".into())
}

fn unknown(looks_like: String) -> Result<Format, FormatError> {
    Err(FormatError::UnknownFormat { looks_like })
}

/// The name of a format that cannot be read.
fn foreign(bytes: &[u8], text: &[u8]) -> Option<&'static str> {
    let signature =
        |(magic, _): &&(&[u8], &str)| bytes.starts_with(magic) || text.starts_with(magic);
    if let Some((_, name)) = SIGNATURES.iter().find(signature) {
        return Some(name);
    }
    let head = text.get(..HEAD_BYTES).unwrap_or(text);
    let head_has = |word: &str| memmem::find(head, word.as_bytes()).is_some();
    match text.first() {
        Some(b'<') if head_has("COLLADA") => Some("a COLLADA file"),
        Some(b'<') => Some("an XML or HTML file"),
        Some(b'[') => Some("a JSON array"),
        Some(b's') if text.starts_with(b"solid") && head_has("facet") => Some("an STL file"),
        _ if is_binary_stl(bytes) => Some("an STL file"),
        _ => None,
    }
}

/// A binary STL has 80 free bytes, a count of triangles, and 50 bytes for each. No text has such a
/// length: as ASCII, the count would be half a billion or more.
fn is_binary_stl(bytes: &[u8]) -> bool {
    let count = bytes.get(80..84).and_then(|count| <[u8; 4]>::try_from(count).ok());
    count.is_some_and(|count| {
        let triangles = u64::from(u32::from_le_bytes(count));
        triangles > 0 && 84 + 50 * triangles == bytes.len() as u64
    })
}

/// Whether some line is a vertex or a face. Comments and other lines of the format may come first
/// in any number, as a scan may begin with megabytes of them. Foreign lines are limited.
fn looks_like_obj(text: &[u8]) -> bool {
    let mut cursor = Cursor::new(text, 0);
    let mut unknown = 0;
    while let Some(statement) = cursor.statement() {
        let start = cursor.offset();
        let word = cursor.token();
        match (statement, word) {
            (Statement::Face, Some(_)) => return true,
            (Statement::Vertex, Some(word)) if is_number_like(word) => return true,
            (Statement::Other, Some(word)) if OBJ_WORDS.contains(&word) => cursor.skip_line(),
            _ => {
                cursor.skip_line();
                unknown += cursor.offset() - start;
                if unknown > MOST_UNKNOWN_BYTES {
                    return false;
                }
            }
        }
    }
    false
}

/// Whether a word was meant to be a number. The parser checks the number and reports its line.
fn is_number_like(word: &[u8]) -> bool {
    let unsigned = word.strip_prefix(b"-").or(word.strip_prefix(b"+")).unwrap_or(word);
    let starts =
        |name: &[u8]| unsigned.get(..3).is_some_and(|head| head.eq_ignore_ascii_case(name));
    matches!(unsigned.first(), Some(b'0'..=b'9' | b'.')) || starts(b"nan") || starts(b"inf")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looks_like(bytes: &[u8]) -> String {
        match sniff(bytes) {
            Err(FormatError::UnknownFormat { looks_like }) => looks_like,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn formats_that_can_be_read() {
        let comments = "# a scan\n".repeat(1 << 20) + "v 1 2 3";
        let normals = "vn 1 2 3\n".repeat(1 << 18) + "v 1 2 3";
        let table: &[(&[u8], Format)] = &[
            (b"glTF\x02\0\0\0", Format::Glb),
            (b"{", Format::Gltf),
            (b"\xef\xbb\xbf \r\n\t{\"asset\"", Format::Gltf),
            (b"v 1 2 3", Format::Obj),
            (b"\xef\xbb\xbfv 1 2 3", Format::Obj),
            (b"v nan 0 0", Format::Obj),
            (b"v -Infinity 0 0", Format::Obj),
            (b"v -.5 0 0", Format::Obj),
            (b"v \\\n 1 2 3", Format::Obj),
            (b"\r\r  f 1 2 3", Format::Obj),
            (b"mtllib a.mtl\ng caf\xe9\nv 1 2 3", Format::Obj),
            (b"mystery line\nv 1 2 3", Format::Obj),
            (b"# C:\\\nv 1 2 3", Format::Obj),
            (b"solid ground\nv 1 2 3", Format::Obj),
            (comments.as_bytes(), Format::Obj),
            (normals.as_bytes(), Format::Obj),
        ];
        for (bytes, format) in table {
            assert_eq!(
                sniff(bytes),
                Ok(*format),
                "{}",
                bytes[..20.min(bytes.len())].escape_ascii()
            );
        }
    }

    #[test]
    fn formats_that_cannot_be_read_are_named() {
        let mut stl = vec![b' '; 184];
        stl[80..84].copy_from_slice(&2_u32.to_le_bytes());
        let table: &[(&[u8], &str)] = &[
            (b"ply\nformat ascii 1.0\n", "a PLY file"),
            (b"ply\r\nformat ascii 1.0\n", "a PLY file"),
            (b"solid cube\n facet normal 0 0 1\n", "an STL file"),
            (&stl, "an STL file"),
            (b"OFF\n8 6 0\n", "an OFF file"),
            (b"Kaydara FBX Binary  \0", "an FBX file"),
            (b"PK\x03\x04\x14\0", "a ZIP archive (3MF, USDZ or a zipped file)"),
            (b"\x1f\x8b\x08", "a gzip-compressed file"),
            (b"\x89PNG\r\n\x1a\n", "a PNG image"),
            (b"\xff\xd8\xff\xe0", "a JPEG image"),
            (b"#usda 1.0\n", "a USD file"),
            (b"PXR-USDC", "a USD file"),
            (b"<?xml version=\"1.0\"?>\n<COLLADA>", "a COLLADA file"),
            (b"\xef\xbb\xbf<html>", "an XML or HTML file"),
            (b" [1, 2]", "a JSON array"),
            (b"\xff\xfev\0 \x001\0", "a UTF-16 text (save it as UTF-8)"),
        ];
        for (bytes, name) in table {
            assert_eq!(looks_like(bytes), format!("this looks like {name}"));
        }
    }

    #[test]
    fn what_is_nothing_is_refused_soon() {
        assert_eq!(sniff(b""), Err(FormatError::Empty));
        let late = "prose ".repeat(1 << 18) + "\nv 1 2 3";
        let table: &[&[u8]] = &[
            b" ",
            b"\xef\xbb\xbf",
            b"hello",
            b"v one",
            b"v",
            b"# v 1 2 3",
            b"\0",
            late.as_bytes(),
        ];
        for bytes in table {
            assert_eq!(looks_like(bytes), "this is not a mesh file that quadmark knows");
        }
    }
}
