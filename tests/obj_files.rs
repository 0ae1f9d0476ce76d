//! Real OBJ files, good and bad: read, left alone, moved, read back, and opened by another reader.
//!
//! The files are not part of the repository: they are looked for in `$QUADMARK_MESHES`, then in
//! `../shared/meshes`. Without them these tests say so and pass.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use quadmark::formats::{Agreement, Asset, Format, Limits, agrees};

fn shared_meshes() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes");
    let folder = std::env::var_os("QUADMARK_MESHES").map_or_else(beside, PathBuf::from);
    if !folder.is_dir() {
        eprintln!("skipped: there is no {}", folder.display());
        return None;
    }
    Some(folder)
}

fn obj_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            obj_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "obj") {
            found.push(path);
        }
    }
}

/// Vertices as `grep` counts them; good for every file without line continuations.
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
fn every_file_is_patched_exactly_or_refused() {
    let Some(folder) = shared_meshes() else { return };
    let mut files = Vec::new();
    obj_files(&folder, &mut files);
    files.sort();
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
