//! Real OBJ files, valid and invalid: read, left alone, moved, read back, and opened by another
//! reader.
//!
//! The files are not part of the repository (see `support::meshes`).
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use std::fs;
use std::path::Path;

use glam::DVec3;
use quadmark::formats::{Agreement, Asset, Format, Limits, agrees};

use support::{files_below, has_extension, meshes};

/// Number of vertices as `grep` counts them; right for every file without line continuations.
fn vertex_lines(bytes: &[u8]) -> usize {
    bytes
        .split(|byte| matches!(byte, b'\n' | b'\r'))
        .map(<[u8]>::trim_ascii_start)
        .filter(|line| line.starts_with(b"v ") || line.starts_with(b"v\t"))
        .count()
}

/// Moves every vertex by about a thousandth of the diagonal, each in its own direction.
fn nudged(positions: &[DVec3]) -> Vec<DVec3> {
    let low = positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let step = (high - low).length() * 1e-3;
    let nudge = |(index, position): (usize, &DVec3)| {
        let angle = index as f64;
        *position + step * DVec3::new(angle.sin(), angle.cos(), (2.0 * angle).sin())
    };
    positions.iter().enumerate().map(nudge).collect()
}

fn check(path: &Path, bytes: &[u8], asset: &Asset) {
    let name = path.display();
    let host = asset.mesh().positions();
    assert_eq!(host.len(), vertex_lines(bytes), "{name}: vertices");
    assert!(asset.pinned().is_empty(), "{name}: pinned");
    assert!(asset.write(bytes, host).unwrap() == bytes, "{name}: nothing moved, bytes differ");

    let mut positions = nudged(host);
    let written = asset.write(bytes, &positions).unwrap();
    asset.round(&mut positions);
    let again = Asset::read(&written, &Limits::default()).unwrap();
    assert!(again.mesh().positions() == positions, "{name}: positions read back otherwise");
    assert!(again.mesh().triangles() == asset.mesh().triangles(), "{name}: triangles changed");

    let opinion = agrees(Format::Obj, bytes, &written);
    let hostile = path.components().any(|part| part.as_os_str() == "adversarial");
    match opinion {
        Agreement::Same => {}
        Agreement::HostUnreadable(reason) if hostile => eprintln!("{name}: tobj cannot: {reason}"),
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn every_file_is_patched_exactly_or_refused() {
    let mut files = files_below(&meshes(""));
    files.retain(|path| has_extension(path, "obj"));
    assert!(!files.is_empty());
    for path in files {
        let bytes = fs::read(&path).unwrap();
        match Asset::read(&bytes, &Limits::default()) {
            Ok(asset) => check(&path, &bytes, &asset),
            Err(error) => {
                eprintln!("{}: {error}", path.display());
                let hostile = path.components().any(|part| part.as_os_str() == "adversarial");
                assert!(hostile, "{}: {error}", path.display());
            }
        }
    }
}
