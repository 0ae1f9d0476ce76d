//! Every available glTF and GLB file: none may panic, a refusal must say what to do, and what can
//! be read must survive a small move of every vertex exactly.
//!
//! The files are not part of the repository (see `support::meshes`). Set `QUADMARK_TEST_KEEP` to a
//! folder that receives the moved files, for opening them in other programs.
#![expect(clippy::unwrap_used, clippy::panic, reason = "test helpers")]

mod support;

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use quadmark::formats::{Asset, Format, FormatError, Limits};

use support::{files_below, has_extension, meshes};

fn gltf_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = files_below(folder);
    found.retain(|path| has_extension(path, "glb") || has_extension(path, "gltf"));
    found
}

fn bits(positions: &[DVec3]) -> Vec<[u64; 3]> {
    positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
}

/// Moves every vertex by a thousandth of the size, each in another direction.
fn nudge(asset: &Asset) -> Vec<DVec3> {
    let host = asset.mesh().positions();
    let low = host.iter().copied().reduce(DVec3::min).unwrap();
    let high = host.iter().copied().reduce(DVec3::max).unwrap();
    let step = 1e-3 * (high - low).length();
    let mut moved: Vec<DVec3> = (0_u32..)
        .zip(host)
        .map(|(i, p)| p + step * DVec3::new(1.0, 0.1, f64::from(i).sin()).normalize())
        .collect();
    asset.round(&mut moved);
    moved
}

fn check(name: &str, bytes: &[u8]) -> Result<Option<Vec<u8>>, FormatError> {
    let limits = Limits::default();
    let asset = Asset::read(bytes, &limits)?;
    assert_eq!(asset.write(bytes, asset.mesh().positions())?, bytes, "{name}: nothing moved");
    let moved = nudge(&asset);
    let written = asset.write(bytes, &moved)?;
    let back = Asset::read(&written, &limits).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!(bits(back.mesh().positions()), bits(&moved), "{name}");
    assert_eq!(back.mesh().triangles(), asset.mesh().triangles(), "{name}");
    assert_eq!(back.pinned(), asset.pinned(), "{name}");
    let pinned = asset.pinned().len();
    let still = moved.iter().zip(asset.mesh().positions()).filter(|(a, b)| a == b).count();
    assert!(still <= pinned + moved.len() / 100, "{name}: {still} of {} stayed", moved.len());
    Ok(Some(written))
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn every_file_survives_or_is_refused_with_advice() {
    let folder = meshes("");
    let keep = std::env::var_os("QUADMARK_TEST_KEEP").map(PathBuf::from);
    let (mut read, mut refused) = (0, 0);
    for path in gltf_files(&folder) {
        let name = path.strip_prefix(&folder).unwrap().display().to_string();
        let bytes = fs::read(&path).unwrap();
        match check(&name, &bytes) {
            Ok(written) => {
                read += 1;
                if let (Some(keep), Some(written)) = (&keep, written) {
                    fs::write(keep.join(name.replace('/', "__")), written).unwrap();
                }
            }
            Err(error) => {
                refused += 1;
                let text = error.to_string();
                assert!(text.len() > 10 && !text.contains("read back"), "{name}: {text}");
                println!("{name}: {text}");
            }
        }
    }
    println!("{read} files read, {refused} refused");
    assert!(read > 0);
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn files_cut_short_are_refused() {
    let folder = meshes("");
    for path in gltf_files(&folder) {
        let bytes = fs::read(&path).unwrap();
        if quadmark::formats::sniff(&bytes) != Ok(Format::Glb) || bytes.len() > 1 << 21 {
            continue;
        }
        if Asset::read(&bytes, &Limits::default()).is_err() {
            continue;
        }
        for part in 0..97 {
            let short = &bytes[..bytes.len() * part / 97];
            assert!(Asset::read(short, &Limits::default()).is_err(), "{}", path.display());
        }
    }
}
