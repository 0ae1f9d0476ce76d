//! What reading and writing promise, over every small document.

use glam::DVec3;
use proptest::prelude::*;

use super::test_documents::{Case, POINTS, cases, floats, indexed};
use super::*;

fn open(bytes: &[u8], format: Format) -> Result<(Mesh, Layout), FormatError> {
    read(bytes, format, &Limits::default())
}

fn files() -> Vec<(String, Vec<u8>, Format)> {
    let twins = |case: Case| {
        [
            (format!("{} (GLB)", case.name), case.glb(), Format::Glb),
            (format!("{} (glTF)", case.name), case.gltf(), Format::Gltf),
        ]
    };
    cases().into_iter().flat_map(twins).collect()
}

fn nudged(layout: &Layout, mesh: &Mesh, step: f64) -> Vec<DVec3> {
    let mut positions: Vec<DVec3> = (0_u32..)
        .zip(mesh.positions())
        .map(|(i, &p)| p + step * DVec3::new(1.0, -2.0, 0.5 + f64::from(i)))
        .collect();
    layout.round(mesh, &mut positions);
    positions
}

fn bits(positions: &[DVec3]) -> Vec<[u64; 3]> {
    positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
}

#[test]
fn counts() {
    for case in cases() {
        for (bytes, format) in [(case.glb(), Format::Glb), (case.gltf(), Format::Gltf)] {
            let (mesh, _) = open(&bytes, format).unwrap_or_else(|e| panic!("{}: {e}", case.name));
            assert_eq!(
                (mesh.positions().len(), mesh.triangles().len()),
                case.counts,
                "{}",
                case.name
            );
        }
    }
}

#[test]
fn written_files_read_back_to_the_bit() {
    for (name, bytes, format) in files() {
        let (mesh, layout) = open(&bytes, format).unwrap();
        for step in [0.0, 1e-9, 1e-3, 0.7, 1e5] {
            let positions = nudged(&layout, &mesh, step);
            let mut again = positions.clone();
            layout.round(&mesh, &mut again);
            assert_eq!(bits(&again), bits(&positions), "{name}: rounding twice");
            let written = layout.write(&bytes, &mesh, &positions).unwrap();
            let (back, _) = open(&written, format).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(bits(back.positions()), bits(&positions), "{name} by {step}");
            assert_eq!(back.triangles(), mesh.triangles(), "{name}");
        }
    }
}

#[test]
fn nothing_moved_is_the_same_file() {
    for (name, bytes, format) in files() {
        let (mesh, layout) = open(&bytes, format).unwrap();
        assert_eq!(layout.write(&bytes, &mesh, mesh.positions()).unwrap(), bytes, "{name}");
        let same = nudged(&layout, &mesh, 0.0);
        assert_eq!(bits(&same), bits(mesh.positions()), "{name}");
    }
}

/// JSON without what a mark may change: bounds of accessors, data of buffers.
fn stripped(json: &[u8]) -> serde_json::Value {
    let mut value: serde_json::Value = serde_json::from_slice(json).unwrap();
    for accessor in value["accessors"].as_array_mut().unwrap() {
        for key in ["min", "max"] {
            if let Some(bound) = accessor.get_mut(key) {
                *bound = bound.as_array().unwrap().len().into();
            }
        }
    }
    for buffer in value["buffers"].as_array_mut().unwrap() {
        buffer["uri"] = serde_json::Value::Null;
    }
    value
}

#[test]
fn only_positions_and_their_bounds_change() {
    for (name, bytes, format) in files() {
        let (mesh, layout) = open(&bytes, format).unwrap();
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3)).unwrap();
        let container = container::split(&written, format).unwrap();
        let (old, new) = (&bytes[layout.container.json.clone()], &written[container.json]);
        assert_ne!(written, bytes, "{name}");
        assert_eq!(stripped(old), stripped(new), "{name}");
        let document = document::parse(old).unwrap();
        let copy = document::parse(new).unwrap();
        let mut mine = Buffers::new(&bytes, &layout.container, &document);
        let split = container::split(&written, format).unwrap();
        let mut theirs = Buffers::new(&written, &split, &copy);
        for index in 0..document.buffers.len() {
            mine.load(&document, index).unwrap();
            theirs.load(&copy, index).unwrap();
            let mut allowed = vec![false; mine.bytes(index).len()];
            for block in &layout.blocks {
                for (_, at) in
                    (0..block.key.count).filter_map(|e| block.locate(e)).filter(|l| l.0 == index)
                {
                    allowed[at..at + 12].fill(true);
                }
            }
            for (at, (a, b)) in mine.bytes(index).iter().zip(theirs.bytes(index)).enumerate() {
                assert!(a == b || allowed[at], "{name}: byte {at} of buffer {index}");
            }
        }
    }
}

#[test]
fn text_outside_the_tokens_is_kept() {
    // Number tokens and base64 payloads blanked, the two texts must be equal byte for byte.
    let blank = |text: &str| {
        let mut out = String::new();
        for piece in text.split_inclusive(|c: char| "[],:\"".contains(c)) {
            let token = piece.trim_end_matches(|c: char| "[],:\"".contains(c));
            let number = token.trim().parse::<f64>().is_ok() || token.len() > 60;
            out.push_str(if number { piece.get(token.len()..).unwrap() } else { piece });
        }
        out
    };
    for case in cases() {
        let bytes = case.gltf();
        let (mesh, layout) = open(&bytes, Format::Gltf).unwrap();
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3)).unwrap();
        let (old, new) = (String::from_utf8(bytes).unwrap(), String::from_utf8(written).unwrap());
        assert_eq!(blank(&old), blank(&new), "{}", case.name);
    }
}

#[test]
fn bounds_follow_the_positions() {
    for (name, bytes, format) in files() {
        let (mesh, layout) = open(&bytes, format).unwrap();
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3)).unwrap();
        let (_, back) = open(&written, format).unwrap();
        let json: serde_json::Value =
            serde_json::from_slice(&written[back.container.json.clone()]).unwrap();
        let document = document::parse(&written[back.container.json.clone()]).unwrap();
        let mut buffers = Buffers::new(&written, &back.container, &document);
        (0..document.buffers.len()).for_each(|index| buffers.load(&document, index).unwrap());
        for block in &back.blocks {
            let values: Vec<_> =
                (0..block.key.count).map(|e| geometry::local(block, &buffers, e)).collect();
            for (&accessor, axis) in block.accessors.iter().flat_map(|a| [(a, 0), (a, 1), (a, 2)]) {
                let entry = &json["accessors"][accessor];
                let axis_values = || values.iter().map(|v| v[axis]);
                if let Some(min) = entry["min"][axis].as_f64() {
                    let expected = axis_values().fold(f32::INFINITY, f32::min);
                    assert!((min - f64::from(expected)).abs() < 1e-7, "{name} {min} {expected}");
                }
                if let Some(max) = entry["max"][axis].as_f64() {
                    let expected = axis_values().fold(f32::NEG_INFINITY, f32::max);
                    assert!((max - f64::from(expected)).abs() < 1e-7, "{name} {max} {expected}");
                }
            }
        }
    }
}

#[test]
fn one_vertex_moved_keeps_the_numbers_of_the_others() {
    let bytes = indexed().gltf();
    let (mesh, layout) = open(&bytes, Format::Gltf).unwrap();
    let mut positions = mesh.positions().to_vec();
    positions[1].x += 0.125;
    layout.round(&mesh, &mut positions);
    let written = layout.write(&bytes, &mesh, &positions).unwrap();
    let text = String::from_utf8(written).unwrap();
    assert!(
        text.contains(r#""min":[-0.4,-1.3,-1.5],"max":[1.8250000476837158,1.1,2.2]"#),
        "{text}"
    );
}

#[test]
fn json_padding_absorbs_what_it_can() {
    let mut case = indexed();
    for _ in 0..24 {
        case.json.push(' ');
        let host = case.glb_with(&[(0x1234_5678, b"kept")]);
        let host = [host, b"trailing".to_vec()].concat();
        let (mesh, layout) = open(&host, Format::Glb).unwrap();
        let written = layout.write(&host, &mesh, &nudged(&layout, &mesh, 0.3)).unwrap();
        assert!(written.ends_with(b"\x04\0\0\0\x78\x56\x34\x12kepttrailing"));
        let (_, back) = open(&written, Format::Glb).unwrap();
        let (old, new) = (layout.container.json_chunk.unwrap(), back.container.json_chunk.unwrap());
        assert!(new.len() >= old.len() && new.len().is_multiple_of(4));
        assert_eq!(written.len() - host.len(), new.len() - old.len());
        assert!(new.len() == old.len() || back.container.json.end + 4 > new.end);
    }
}

#[test]
fn data_uris_of_every_style() {
    let text = String::from_utf8(indexed().gltf()).unwrap();
    let long = "data:application/octet-stream;base64,";
    for (from, to) in [
        (long, "data:application/gltf-buffer;base64,"),
        (long, "data:application\\/octet-stream;base64,"),
        (long, "data:application\\u002foctet-stream;base64,%4"),
        (long, "data:;base64,"),
        ("{\"asset\"", "\u{feff}{\"asset\""),
    ] {
        let payload = text.split_once(long).unwrap().1.chars().next().unwrap();
        let to = to.replace("%4", &format!("%{:02x}", u32::from(payload)));
        let from = if to.contains('%') { format!("{from}{payload}") } else { from.to_owned() };
        let bytes = text.replacen(&from, &to, 1).into_bytes();
        let (mesh, layout) = open(&bytes, Format::Gltf).unwrap();
        let positions = nudged(&layout, &mesh, 0.3);
        let written = layout.write(&bytes, &mesh, &positions).unwrap();
        assert_eq!(open(&written, Format::Gltf).unwrap().0.positions(), positions, "{to}");
    }
}

#[test]
fn pinned_vertices_stay() {
    let case = cases().into_iter().find(|case| case.name == "sparse without a base").unwrap();
    let bytes = case.glb();
    let (mesh, layout) = open(&bytes, Format::Glb).unwrap();
    assert_eq!(layout.pinned(), [0, 2, 4]);
    let positions = nudged(&layout, &mesh, 0.3);
    for vertex in [0, 2, 4] {
        assert_eq!(positions[vertex], DVec3::ZERO);
    }
    assert_ne!(positions[1], mesh.positions()[1]);
    let all: Vec<DVec3> = mesh.positions().iter().map(|p| p + DVec3::ONE).collect();
    assert!(matches!(layout.write(&bytes, &mesh, &all), Err(FormatError::ReadBack { .. })));
}

#[test]
fn what_cannot_be_written_is_refused() {
    let bytes = indexed().glb();
    let (mesh, layout) = open(&bytes, Format::Glb).unwrap();
    let mut wild = mesh.positions().to_vec();
    for bad in [f64::NAN, f64::INFINITY, 1e39] {
        wild[3].y = bad;
        assert!(matches!(layout.write(&bytes, &mesh, &wild), Err(FormatError::ReadBack { .. })));
        let mut rounded = wild.clone();
        layout.round(&mesh, &mut rounded);
        assert_eq!(rounded, mesh.positions());
    }
    let few = &mesh.positions()[1..];
    assert!(matches!(layout.write(&bytes, &mesh, few), Err(FormatError::ReadBack { .. })));
    let mut other = bytes.clone();
    let at = layout.container.bin.clone().unwrap().start + 5;
    other[at] ^= 0x40;
    for host in [&bytes[1..], &other] {
        let positions = mesh.positions();
        assert!(matches!(layout.write(host, &mesh, positions), Err(FormatError::ReadBack { .. })));
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
    let error = read(&indexed().glb(), Format::Glb, &limits).unwrap_err();
    assert_eq!(error, FormatError::TooLarge { what: "vertices", count: 5, limit: 4 });
    let limits = Limits { max_triangles: 3, ..Limits::default() };
    let error = read(&indexed().glb(), Format::Glb, &limits).unwrap_err();
    assert_eq!(error, FormatError::TooLarge { what: "triangles", count: 4, limit: 3 });
    let mut case = indexed();
    case.buffers[0].splice(0..12, floats(&[[1.0, f32::NAN, 0.0]]));
    let error = open(&case.glb(), Format::Glb).unwrap_err();
    assert_eq!(error, FormatError::NonFiniteVertex { place: "accessors[0], element 0".to_owned() });
}

#[test]
fn strips_and_fans_keep_their_winding() {
    let triangles = |name: &str| {
        let case = cases().into_iter().find(|case| case.name == name).unwrap();
        open(&case.glb(), Format::Glb).unwrap().0.triangles().to_vec()
    };
    assert_eq!(triangles("strip"), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
    assert_eq!(triangles("fan"), [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
    assert_eq!(triangles("sparse indices")[1], [4, 2, 3]);
}

#[test]
fn transforms_place_the_mesh() {
    let case = cases().into_iter().find(|c| c.name.starts_with("matrix of a parent")).unwrap();
    let (mesh, _) = open(&case.glb(), Format::Glb).unwrap();
    let [x, y, z] = POINTS[0].map(f64::from);
    let expected = DVec3::new(3.0 * z + 1.0, 3.0 * y + 2.0, -3.0 * x + 3.0);
    assert!((mesh.positions()[0] - expected).length() < 1e-12);
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

/// Whatever reads must round, write and read again.
fn survives(bytes: &[u8], format: Format) {
    let limits = Limits { max_vertices: 10_000, max_triangles: 10_000, max_bytes: 1 << 20 };
    let Ok((mesh, layout)) = read(bytes, format, &limits) else { return };
    let positions = nudged(&layout, &mesh, 0.01);
    let written = layout.write(bytes, &mesh, &positions).unwrap();
    let (back, _) = read(&written, format, &limits).unwrap();
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
    fn arbitrary_numbers_are_survived(which in 0_usize..15, nth in 0_usize..60, new in any::<u64>(), small in 0_u64..200) {
        for value in [new, small] {
            let mut case = cases().swap_remove(which);
            let digits: Vec<(usize, char)> =
                case.json.char_indices().filter(|(_, c)| c.is_ascii_digit()).collect();
            let at = digits[nth % digits.len()].0;
            case.json.replace_range(at..=at, &value.to_string());
            survives(&case.glb(), Format::Glb);
        }
    }
}
