//! Files made to break readers, and every available glTF, through everything that takes a file.
//! There must be an answer each time, never a panic, and a refusal must give a reason.
//!
//! The files are not part of the repository (see `support::meshes`).
#![expect(clippy::unwrap_used, reason = "test helpers")]

mod support;

use std::fs;
use std::path::Path;

use quadmark::formats::{Asset, Limits};
use quadmark::marking::{MarkError, extract_file, inspect};
use quadmark::watermark::{BitCount, EmbedParams, Method, Modulation};

use support::{bits_read, files_below, key_named, mark_named, meshes};

/// The result for one file.
enum Answer {
    Marked,
    Refused(String),
}

fn refusal(what: &str, name: &str, error: &MarkError) -> String {
    let text = error.to_string();
    // A failed check would mean that the reader or the writer is wrong, whatever the file.
    let our_fault = matches!(error, MarkError::Check(_)) || text.contains("read back");
    assert!(!our_fault, "{name}: {what}: {text}");
    assert!(text.len() > 10 && !text.contains('\u{fffd}'), "{name}: {what}: {text:?}");
    assert!(text.chars().count() < 1_000, "{name}: {what}: a text of {} bytes", text.len());
    text
}

fn try_all(name: &str, bytes: &[u8]) -> Answer {
    let limits = Limits::default();
    let (params, bits) = (EmbedParams::default(), BitCount::default());
    let read = Asset::read(bytes, &limits).map_err(MarkError::from);
    let inspected = inspect(bytes, &params, &limits);
    let extracted = extract_file(bytes, &key_named(name), bits, Modulation::Mean, &limits);
    let marked = mark_named(name, bytes, Method::default());
    if let Err(error) = &read {
        // An unreadable file is refused with the same error everywhere.
        let text = refusal("read", name, error);
        assert_eq!(inspected.as_ref().err(), Some(error), "{name}");
        assert_eq!(extracted.as_ref().err(), Some(error), "{name}");
        assert_eq!(marked.as_ref().err(), Some(error), "{name}");
        return Answer::Refused(text);
    }
    for (what, error) in
        [("inspect", inspected.as_ref().err()), ("extract", extracted.as_ref().err())]
    {
        error.map(|error| refusal(what, name, error));
    }
    match marked {
        Ok(marked) => {
            let (right, wrong) = bits_read(name, &marked.bytes, Modulation::Mean);
            assert_eq!((right, wrong), (marked.report.usable_bins, 0), "{name}");
            // Not necessarily `markable`: an inspection is about the poorest layout class.
            assert!(inspected.unwrap().usable_bins > 0, "{name}");
            Answer::Marked
        }
        Err(error) => Answer::Refused(refusal("mark", name, &error)),
    }
}

fn every_file(folder: &str) {
    let folder = meshes(folder);
    let (mut marked, mut refused) = (0, 0);
    for path in files_below(&folder) {
        let name = path.strip_prefix(&folder).unwrap().display().to_string();
        let bytes = fs::read(&path).unwrap();
        match try_all(&name, &bytes) {
            Answer::Marked => marked += 1,
            Answer::Refused(text) => {
                refused += 1;
                println!("{name}: {text}");
            }
        }
    }
    println!("{}: {marked} marked, {refused} refused", folder.display());
    assert!(marked + refused > 0);
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn hostile_obj_files() {
    every_file("adversarial/obj");
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn hostile_gltf_files() {
    every_file("adversarial/gltf");
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn gltf_files() {
    every_file("gltf/khronos");
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn files_of_other_tools() {
    for part in fs::read_dir(meshes("gltf")).unwrap().map(Result::unwrap) {
        let (is_folder, part) = (part.file_type().unwrap().is_dir(), part.file_name());
        // The Khronos models have a test of their own, the converted ones are in `meshes.rs`.
        if is_folder && part != "khronos" && part != "converted" {
            every_file(Path::new("gltf").join(part).to_str().unwrap());
        }
    }
}

#[test]
fn words_that_are_no_mesh() {
    let long = [b"v 1 2 3\n".repeat(1_000), b"f 1 2 3\n".to_vec()].concat();
    let cases: [(&str, &[u8]); 8] = [
        ("nothing", b""),
        ("a letter", b"v"),
        ("prose", b"Dear Sir or Madam,\nplease find attached our mesh.\n"),
        ("zeros", &[0; 4096]),
        ("a GLB header alone", b"glTF\x02\0\0\0\x0c\0\0\0"),
        ("JSON", b"{\"asset\":{\"version\":\"2.0\"}}"),
        ("one point a thousand times", &long),
        ("1e999", b"v 1e999 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n"),
    ];
    for (name, bytes) in cases {
        match try_all(name, bytes) {
            Answer::Marked => panic!("{name} was marked"),
            Answer::Refused(text) => println!("{name}: {text}"),
        }
    }
}
