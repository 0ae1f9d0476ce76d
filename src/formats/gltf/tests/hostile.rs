//! Malformed, truncated and corrupt files: an error that helps, or an exact round trip.

use proptest::prelude::*;

use super::documents::{Case, cases, floats, indexed};
use super::{bits, nudged, open};
use crate::formats::gltf::{Layout, read};
use crate::formats::{Format, FormatError, Limits};
use crate::mesh::Mesh;

#[test]
fn what_cannot_be_written_is_refused() {
    let bytes = indexed().glb();
    let (mesh, layout) = open(&bytes, Format::Glb).unwrap();
    let mut wild = mesh.positions().to_vec();
    for bad in [f64::NAN, f64::INFINITY, 1e39] {
        wild[3].y = bad;
        assert!(matches!(
            layout.write(&bytes, &mesh, &wild, &|| false),
            Err(FormatError::ReadBack { .. })
        ));
        let mut rounded = wild.clone();
        layout.round(&mesh, &mut rounded, &|| false);
        assert_eq!(rounded, mesh.positions());
    }
    let few = &mesh.positions()[1..];
    assert!(matches!(
        layout.write(&bytes, &mesh, few, &|| false),
        Err(FormatError::ReadBack { .. })
    ));
    let mut other = bytes.clone();
    let at = layout.container.bin.clone().unwrap().start + 5;
    other[at] ^= 0x40;
    for host in [&bytes[1..], &other] {
        let positions = mesh.positions();
        assert!(matches!(
            layout.write(host, &mesh, positions, &|| false),
            Err(FormatError::ReadBack { .. })
        ));
    }
}

/// Replaces text in the JSON of the plain document.
fn altered(from: &str, to: &str) -> Result<(Mesh, Layout), FormatError> {
    let mut case = indexed();
    assert!(case.json.contains(from), "{from}");
    case.json = case.json.replacen(from, to, 1);
    open(&case.glb(), Format::Glb)
}

#[test]
fn malformed_documents_name_the_path() {
    let accessor = r#""componentType":5126,"count":5"#;
    for (from, to, expected) in [
        (r#""count":5"#, r#""count":0"#, "accessors[0].count"),
        (r#""count":5"#, r#""count":6"#, "accessors[0]"),
        (r#""count":5"#, r#""count":18446744073709551615"#, "accessors[0]"),
        (r#""count":5"#, r#""count":4"#, "accessors[1]"),
        (r#""count":5"#, r#""count":5,"byteOffset":18446744073709551615"#, "accessors[0]"),
        (
            r#""bufferView":0,"componentType":5126,"count":5"#,
            r#""componentType":5126,"count":40000000"#,
            "accessors[0].count",
        ),
        (r#""bufferView":0"#, r#""bufferView":9"#, "accessors[0].bufferView"),
        (r#""type":"VEC3""#, r#""type":"VEC2""#, "accessors[0].type"),
        (accessor, r#""componentType":77,"count":5"#, "accessors[0].componentType"),
        (r#""componentType":5123"#, r#""componentType":5122"#, "accessors[1].componentType"),
        (r#""type":"SCALAR""#, r#""type":"VEC2""#, "accessors[1].type"),
        (r#""byteLength":60"#, r#""byteLength":60,"byteStride":8"#, "bufferViews[0].byteStride"),
        (r#""byteLength":60"#, r#""byteLength":6000"#, "bufferViews[0]"),
        (
            r#""byteLength":60"#,
            r#""byteLength":60,"byteOffset":18446744073709551600"#,
            "bufferViews[0]",
        ),
        (r#""buffer":0"#, r#""buffer":3"#, "buffers[3]"),
        (r#""POSITION":0"#, r#""POSITION":5"#, "meshes[0].primitives[0].attributes.POSITION"),
        (r#""indices":1"#, r#""indices":5"#, "meshes[0].primitives[0].indices"),
        (r#""indices":1"#, r#""indices":1,"mode":7"#, "meshes[0].primitives[0].mode"),
        (r#""indices":1"#, r#""indices":"1""#, "meshes[0].primitives[0].indices"),
        ("@BUFFERS@", r#"[{"byteLength":9999}]"#, "buffers[0].byteLength"),
        ("@BUFFERS@", r#"[{"byteLength":84,"uri":"data:;base64,!"}]"#, "buffers[0].uri"),
    ] {
        match altered(from, to) {
            Err(FormatError::MalformedGltf { path, reason }) => {
                assert_eq!(path, expected, "{to}: {reason}");
            }
            other => panic!("{to}: {other:?}"),
        }
    }
}

#[test]
fn refusals_have_their_own_variants() {
    let draco = r#""indices":1,"extensions":{"KHR_draco_mesh_compression":{}}"#;
    let meshopt = r#""byteLength":60,"extensions":{"EXT_meshopt_compression":{}}"#;
    for (from, to, expected) in [
        (
            r#""buffers":"#,
            r#""extensionsRequired":["KHR_mesh_quantization"],"buffers":"#,
            "KHR_mesh_quantization",
        ),
        (
            r#""buffers":"#,
            r#""extensionsRequired":["KHR_draco_mesh_compression"],"buffers":"#,
            "KHR_draco_mesh_compression",
        ),
        (r#""componentType":5126"#, r#""componentType":5122"#, "KHR_mesh_quantization"),
        (r#""indices":1"#, draco, "KHR_draco_mesh_compression"),
        (r#""byteLength":60"#, meshopt, "EXT_meshopt_compression"),
    ] {
        match altered(from, to) {
            Err(FormatError::UnsupportedExtension { extension, advice }) => {
                assert_eq!(extension, expected);
                assert!(advice.contains("first"));
            }
            other => panic!("{to}: {other:?}"),
        }
    }
    assert_eq!(
        altered("@BUFFERS@", r#"[{"byteLength":84,"uri":"../../etc/passwd"}]"#).unwrap_err(),
        FormatError::ExternalBuffer { buffer: 0, uri: "../../etc/passwd".to_owned() }
    );
    assert_eq!(altered(r#""indices":1"#, r#""mode":1"#).unwrap_err(), FormatError::NoTriangles);
    let normal = altered(r#""POSITION":0"#, r#""POSITION":0,"NORMAL":0"#);
    assert!(matches!(normal, Err(FormatError::CannotPatch { .. })), "{normal:?}");
    let limits = Limits { max_vertices: 4, ..Limits::default() };
    let error = read(&indexed().glb(), Format::Glb, &limits, &|| false).unwrap_err();
    assert_eq!(error, FormatError::TooLarge { what: "vertices", count: 5, limit: 4 });
    let limits = Limits { max_triangles: 3, ..Limits::default() };
    let error = read(&indexed().glb(), Format::Glb, &limits, &|| false).unwrap_err();
    assert_eq!(error, FormatError::TooLarge { what: "triangles", count: 4, limit: 3 });
    let mut case = indexed();
    case.buffers[0].splice(0..12, floats(&[[1.0, f32::NAN, 0.0]]));
    let error = open(&case.glb(), Format::Glb).unwrap_err();
    assert_eq!(error, FormatError::NonFiniteVertex { place: "accessors[0], element 0".to_owned() });
}

/// A grid of `side` x `side` cells. Its triangles are named by each of `primitives`
/// primitives, from indices that begin `step` bytes after those of the one before.
fn repeated(side: u16, primitives: usize, step: usize) -> Vec<u8> {
    let across = side + 1;
    let mut bin: Vec<u8> = Vec::new();
    for k in 0..across * across {
        bin.extend(floats(&[[f32::from(k % across), f32::from(k / across), 0.0]]));
    }
    let vertices = usize::from(across) * usize::from(across);
    let indices_at = bin.len();
    for k in 0..side * side {
        let first = k / side * across + k % side;
        for corner in [0, 1, across, across, 1, across + 1] {
            bin.extend((first + corner).to_le_bytes());
        }
    }
    let corners = usize::from(side) * usize::from(side) * 6;
    let count = corners - step / 2 * primitives.saturating_sub(1);
    let accessors: Vec<String> = (0..if step == 0 { 1 } else { primitives })
        .map(|k| {
            format!(
                r#"{{"bufferView":1,"byteOffset":{},"componentType":5123,"count":{count},"type":"SCALAR"}}"#,
                k * step
            )
        })
        .collect();
    let pieces: Vec<String> = (0..primitives)
        .map(|k| {
            let indices = if step == 0 { 1 } else { 1 + k };
            format!(r#"{{"attributes":{{"POSITION":0}},"indices":{indices}}}"#)
        })
        .collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":@BUFFERS@,"bufferViews":[
        {{"buffer":0,"byteLength":{indices_at}}},
        {{"buffer":0,"byteOffset":{indices_at},"byteLength":{}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{vertices},"type":"VEC3"}},{}],
        "meshes":[{{"primitives":[{}]}}]}}"#,
        bin.len() - indices_at,
        accessors.join(","),
        pieces.join(","),
    );
    Case { name: "repeated", json, buffers: vec![bin], counts: (0, 0) }.glb()
}

#[test]
fn triangles_that_repeat_others_are_bounded_by_the_bytes_of_their_indices() {
    let limits = Limits::default();
    for (primitives, step) in [(1, 0), (4, 0), (4, 2)] {
        let (mesh, _) =
            read(&repeated(100, primitives, step), Format::Glb, &limits, &|| false).unwrap();
        assert!(mesh.triangles().len() >= 19_900 * primitives, "{primitives} {step}");
    }
    // The same accessor two hundred times, and as many accessors over nearly the same bytes.
    for step in [0, 2] {
        let file = repeated(100, 200, step);
        assert!(file.len() < 300_000);
        let error = read(&file, Format::Glb, &limits, &|| false).unwrap_err();
        assert!(matches!(error, FormatError::TooLarge { .. }), "{error}");
        assert!(error.to_string().contains("repeat"), "{error}");
    }
}

#[test]
fn vertices_without_bytes_are_bounded_by_what_the_file_could_spell_out() {
    let with = |count: usize, pieces: usize| {
        let accessors: Vec<String> = (0..pieces)
            .map(|k| format!(r#"{{"componentType":5126,"count":{},"type":"VEC3"}}"#, count + k))
            .collect();
        let primitives: Vec<String> =
            (0..pieces).map(|k| format!(r#"{{"attributes":{{"POSITION":{k}}}}}"#)).collect();
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"extras":"{}","accessors":[{}],"meshes":[{{"primitives":[{}]}}]}}"#,
            "x".repeat(600_000),
            accessors.join(","),
            primitives.join(",")
        );
        read(json.as_bytes(), Format::Gltf, &Limits::default(), &|| false).map(|(mesh, _)| mesh)
    };
    assert_eq!(with(60_000, 1).unwrap().positions().len(), 60_000);
    for (count, pieces) in [(8_000_000, 1), (60_000, 20)] {
        let error = with(count, pieces).unwrap_err();
        assert!(matches!(error, FormatError::TooLarge { .. }), "{error}");
    }
}

#[test]
fn truncated_at_every_length() {
    for case in cases() {
        let file = case.glb();
        for length in 0..file.len() {
            assert!(open(&file[..length], Format::Glb).is_err(), "{} at {length}", case.name);
        }
    }
}

/// A file that can be read must round, write and be read again.
fn survives(bytes: &[u8], format: Format) {
    let limits = Limits { max_vertices: 10_000, max_triangles: 10_000, max_bytes: 1 << 20 };
    let Ok((mesh, layout)) = read(bytes, format, &limits, &|| false) else { return };
    let positions = nudged(&layout, &mesh, 0.01);
    let written = layout.write(bytes, &mesh, &positions, &|| false).unwrap();
    let (back, _) = read(&written, format, &limits, &|| false).unwrap();
    assert_eq!(bits(back.positions()), bits(&positions));
}

#[test]
fn every_corrupt_byte_is_survived() {
    for case in cases() {
        let (glb, gltf) = (case.glb(), case.gltf());
        for (file, format) in [(glb, Format::Glb), (gltf, Format::Gltf)] {
            for at in 0..file.len() {
                for flip in [0x01, 0x10, 0x80, 0xFF] {
                    let mut bad = file.clone();
                    bad[at] ^= flip;
                    survives(&bad, format);
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn arbitrary_fragments_are_survived(
        which in 0_usize..15,
        at in any::<proptest::sample::Index>(),
        remove in 0_usize..30,
        text in r#"([\[\]{}",:0-9.e+-]|null|"count"|"children"|"sparse"|"matrix"|"byteStride"|18446744073709551615){0,8}"#,
    ) {
        let mut case = cases().swap_remove(which);
        let from = at.index(case.json.len());
        let to = (from + remove).min(case.json.len());
        if case.json.is_char_boundary(from) && case.json.is_char_boundary(to) {
            case.json.replace_range(from..to, &text);
        }
        survives(&case.glb(), Format::Glb);
        survives(&case.gltf(), Format::Gltf);
    }

    #[test]
    fn arbitrary_numbers_are_survived(
        which in 0_usize..15, nth in 0_usize..60, new in any::<u64>(), small in 0_u64..200,
    ) {
        for value in [new, small] {
            let mut case = cases().swap_remove(which);
            let digits: Vec<(usize, char)> =
                case.json.char_indices().filter(|(_, c)| c.is_ascii_digit()).collect();
            let at = digits[nth % digits.len()].0;
            case.json.replace_range(at..=at, &value.to_string());
            survives(&case.glb(), Format::Glb);
        }
    }

    #[test]
    fn arbitrary_floats_are_survived(
        which in 0_usize..15,
        words in proptest::collection::vec(any::<u32>(), 15),
        exponent in 0_u32..255,
    ) {
        // Half of all bit patterns are far too large or small for a mesh; keep some in range.
        for words in [words.clone(), words.iter().map(|w| w & 0x807F_FFFF | exponent << 23).collect()] {
            let mut case = cases().swap_remove(which);
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            case.buffers[0][..60].copy_from_slice(&bytes);
            survives(&case.glb(), Format::Glb);
        }
    }
}
