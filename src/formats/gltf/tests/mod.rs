//! The guarantees of reading and writing, on every small document.

mod documents;
mod hostile;

use glam::DVec3;

use self::documents::{Case, POINTS, cases, indexed};
use super::*;

fn open(bytes: &[u8], format: Format) -> Result<(Mesh, Layout), FormatError> {
    read(bytes, format, &Limits::default(), &|| false)
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

fn displaced(mesh: &Mesh, step: f64) -> Vec<DVec3> {
    let shift = |i: u32| step * DVec3::new(1.0, -2.0, 0.5 + f64::from(i));
    (0..).zip(mesh.positions()).map(|(i, &p)| p + shift(i)).collect()
}

fn nudged(layout: &Layout, mesh: &Mesh, step: f64) -> Vec<DVec3> {
    let mut positions = displaced(mesh, step);
    layout.round(mesh, &mut positions, &|| false);
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
            layout.round(&mesh, &mut again, &|| false);
            assert_eq!(bits(&again), bits(&positions), "{name}: rounding twice");
            let written = layout.write(&bytes, &mesh, &positions, &|| false).unwrap();
            assert!(
                layout.pinned().len() == 3 || {
                    let raw = displaced(&mesh, step);
                    layout.write(&bytes, &mesh, &raw, &|| false).unwrap() == written
                }
            );
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
        assert_eq!(
            layout.write(&bytes, &mesh, mesh.positions(), &|| false).unwrap(),
            bytes,
            "{name}"
        );
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
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3), &|| false).unwrap();
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
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3), &|| false).unwrap();
        let (old, new) = (String::from_utf8(bytes).unwrap(), String::from_utf8(written).unwrap());
        assert_eq!(blank(&old), blank(&new), "{}", case.name);
    }
}

#[test]
fn bounds_follow_the_positions() {
    for (name, bytes, format) in files() {
        let (mesh, layout) = open(&bytes, format).unwrap();
        let written = layout.write(&bytes, &mesh, &nudged(&layout, &mesh, 0.3), &|| false).unwrap();
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
    layout.round(&mesh, &mut positions, &|| false);
    let written = layout.write(&bytes, &mesh, &positions, &|| false).unwrap();
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
        let written = layout.write(&host, &mesh, &nudged(&layout, &mesh, 0.3), &|| false).unwrap();
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
        let written = layout.write(&bytes, &mesh, &positions, &|| false).unwrap();
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
    assert!(matches!(
        layout.write(&bytes, &mesh, &all, &|| false),
        Err(FormatError::ReadBack { .. })
    ));
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
