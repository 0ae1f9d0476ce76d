//! The closed loop's promise on real meshes: a marked file has no wrong bit in a blind reading
//! after writing and reading, and differs from its host in coordinates only. A mesh that cannot
//! carry a mark is refused with the counts.
#![expect(clippy::unwrap_used, clippy::panic, reason = "test helpers")]

mod support;

use std::fs;
use std::path::Path;

use quadmark::marking::MarkError;
use quadmark::watermark::{Method, WatermarkError, needed_bins};

use support::{
    assert_only_coordinates_differ, assert_only_positions_differ, bits_read, files_below,
    has_extension, mark_named, meshes,
};

/// Marks with each method; `true` for marked, `false` for refused.
fn closed_loop(name: &str, host: &[u8], differs: impl Fn(&str, &[u8], &[u8])) -> Vec<bool> {
    let each = |&method: &Method| {
        let name = format!("{name} {method}");
        match mark_named(&name, host, method) {
            Ok(marked) => {
                differs(&name, host, &marked.bytes);
                let (right, wrong) = bits_read(&name, &marked.bytes, method.modulation());
                assert_eq!((right, wrong), (marked.report.usable_bins, 0), "{name}");
                assert!(right >= needed_bins(64), "{name}: {right} bits");
                println!("{name}: {:?}", marked.report);
                true
            }
            Err(refused @ MarkError::Watermark(WatermarkError::InsufficientCapacity { .. })) => {
                println!("{name}: refused: {refused}");
                false
            }
            Err(other) => panic!("{name}: {other}"),
        }
    };
    Method::ALL.iter().map(each).collect()
}

fn all_in(folder: &Path, extension: &str, differs: impl Fn(&str, &[u8], &[u8]) + Copy) {
    let (mut marked, mut refused) = (0, 0);
    for path in files_below(folder).iter().filter(|path| has_extension(path, extension)) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let outcomes = closed_loop(name, &fs::read(path).unwrap(), differs);
        if name.starts_with("nefertiti") || folder.ends_with("paper") {
            assert!(outcomes.iter().all(|&marked| marked), "{name} must be accepted: {outcomes:?}");
        }
        marked += outcomes.iter().filter(|&&marked| marked).count();
        refused += outcomes.iter().filter(|&&marked| !marked).count();
    }
    println!("{}: {marked} embeddings, {refused} refusals", folder.display());
    assert!(marked > 0);
}

macro_rules! each_folder {
    ($($test:ident: $folder:literal, $extension:literal, $differs:expr;)*) => {$(
        #[test]
        #[cfg_attr(
            not(shared_meshes),
            ignore = "needs the shared meshes: set QUADMARK_MESHES"
        )]
        fn $test() {
            all_in(&meshes($folder), $extension, $differs);
        }
    )*};
}

fn obj_differs(name: &str, host: &[u8], marked: &[u8]) {
    assert!(assert_only_coordinates_differ(name, host, marked) > 0, "{name}: nothing moved");
}

each_folder! {
    paper: "obj/paper", "obj", obj_differs;
    closed: "obj/closed", "obj", obj_differs;
    cad: "obj/cad", "obj", obj_differs;
    open: "obj/open", "obj", obj_differs;
    attributes: "obj/attrs", "obj", obj_differs;
    degenerate: "obj/degenerate", "obj", obj_differs;
    glb_twins: "gltf/converted", "glb", assert_only_positions_differ;
}
