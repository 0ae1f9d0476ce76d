//! Small documents for tests, each as a GLB and as its twin with data URIs.

use base64::Engine;

/// Five vertices with coordinates that no short decimal hits, and one zero with a sign.
pub(super) const POINTS: [[f32; 3]; 5] =
    [[0.1, -0.2, 0.3], [1.7, 0.25, -0.0], [-0.4, 1.1, 0.6], [0.9, -1.3, 2.2], [0.5, 0.5, -1.5]];
/// Four triangles on them.
pub(super) const CORNERS: [u16; 12] = [0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 4, 2];

/// A document whose `@BUFFERS@` stands for the `buffers` array.
#[derive(Debug, Clone)]
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) json: String,
    pub(super) buffers: Vec<Vec<u8>>,
    /// Vertices and triangles that it has.
    pub(super) counts: (usize, usize),
}

impl Case {
    pub(super) fn glb(&self) -> Vec<u8> {
        self.glb_with(&[])
    }

    /// The GLB with more chunks, each a type and its content.
    pub(super) fn glb_with(&self, chunks: &[(u32, &[u8])]) -> Vec<u8> {
        let mut json = self.text(1).into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut bin = self.buffers[0].clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut body = Vec::new();
        let own: [(u32, &[u8]); 2] = [(0x4E4F_534A, &json), (0x004E_4942, &bin)];
        for (kind, content) in own.into_iter().chain(chunks.iter().copied()) {
            body.extend(u32::try_from(content.len()).unwrap().to_le_bytes());
            body.extend(kind.to_le_bytes());
            body.extend(content);
        }
        let total = u32::try_from(body.len() + 12).unwrap();
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend(total.to_le_bytes());
        file.extend(body);
        file
    }

    pub(super) fn gltf(&self) -> Vec<u8> {
        self.text(0).into_bytes()
    }

    fn text(&self, without_uri: usize) -> String {
        let entries: Vec<String> = self
            .buffers
            .iter()
            .enumerate()
            .map(|(index, bytes)| {
                let length = bytes.len();
                if index < without_uri {
                    return format!("{{\"byteLength\":{length}}}");
                }
                let data = base64::engine::general_purpose::STANDARD.encode(bytes);
                let uri = format!("data:application/octet-stream;base64,{data}");
                format!("{{ \"byteLength\" : {length} , \"uri\" : \"{uri}\" }}")
            })
            .collect();
        self.json.replace("@BUFFERS@", &format!("[{}]", entries.join(", ")))
    }
}

pub(super) fn floats(points: &[[f32; 3]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect()
}

fn shorts(indices: &[u16]) -> Vec<u8> {
    indices.iter().flat_map(|i| i.to_le_bytes()).collect()
}

const BOUNDS: &str = r#""min":[-0.4,-1.3,-1.5],"max":[1.7,1.1,2.2]"#;

fn case(
    name: &'static str,
    counts: (usize, usize),
    buffers: &[&[u8]],
    views: &str,
    accessors: &str,
    rest: &str,
) -> Case {
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"buffers\":@BUFFERS@,\"bufferViews\":[{views}],\
         \"accessors\":[{accessors}],{rest}}}"
    );
    Case { name, json, buffers: buffers.iter().map(|b| b.to_vec()).collect(), counts }
}

/// Positions and indices one after the other.
pub(super) fn indexed() -> Case {
    let mut bin = floats(&POINTS);
    bin.extend(shorts(&CORNERS));
    case(
        "indexed",
        (5, 4),
        &[&bin],
        r#"{"buffer":0,"byteLength":60},{"buffer":0,"byteOffset":60,"byteLength":24}"#,
        &format!(
            r#"{{"bufferView":0,"componentType":5126,"count":5,"type":"VEC3",{BOUNDS}}},
            {{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}}"#
        ),
        r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}]"#,
    )
}

/// One document per layout that the reader must know.
#[expect(clippy::too_many_lines, reason = "a table")]
pub(super) fn cases() -> Vec<Case> {
    let points = floats(&POINTS);
    let plain = r#"{"buffer":0,"byteLength":60}"#;
    let position =
        format!(r#"{{"bufferView":0,"componentType":5126,"count":5,"type":"VEC3",{BOUNDS}}}"#);
    let unindexed = |name, mode: u32, triangles| {
        case(
            name,
            (5, triangles),
            &[&points],
            plain,
            &position,
            &format!(
                r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"mode":{mode}}}]}}]"#
            ),
        )
    };
    let placed = |name, node: &str| {
        let mut case = indexed();
        case.name = name;
        case.json.truncate(case.json.len() - 1);
        let scene = r#""scenes":[{"nodes":[0]}],"scene":0}"#;
        case.json.push_str(&[",\"nodes\":[", node, "],", scene].concat());
        case
    };
    let interleaved: Vec<u8> = POINTS.iter().flat_map(|p| floats(&[*p, [0.0, 0.6, 0.8]])).collect();
    let mut sparse = points.clone();
    sparse.extend(shorts(&[1, 3, 0, 0]));
    sparse.extend(floats(&[[2.5, 0.1, 0.7], [-3.25, 0.3, 0.9]]));
    let mut indexed_bin = points.clone();
    indexed_bin.extend(shorts(&CORNERS));
    let sparse_views = r#"{"buffer":0,"byteLength":60},{"buffer":0,"byteOffset":60,"byteLength":4},
        {"buffer":0,"byteOffset":68,"byteLength":24}"#;
    let sparse_part = r#""sparse":{"count":2,"indices":{"bufferView":1,"componentType":5123},
        "values":{"bufferView":2}}"#;
    let list = r#""meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
    let strip = r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"mode":5}]}]"#;
    vec![
        indexed(),
        unindexed("list", 4, 1),
        unindexed("strip", 5, 3),
        unindexed("fan", 6, 3),
        case(
            "interleaved with normals",
            (5, 3),
            &[&interleaved],
            r#"{"buffer":0,"byteLength":120,"byteStride":24}"#,
            r#"{"bufferView":0,"componentType":5126,"count":5,"type":"VEC3","max":[1.7,1.1,2.2]},
               {"bufferView":0,"byteOffset":12,"componentType":5126,"count":5,"type":"VEC3"}"#,
            r#""meshes":[{"primitives":[{"attributes":{"NORMAL":1,"POSITION":0},"mode":5}]}]"#,
        ),
        case(
            "sparse",
            (5, 3),
            &[&sparse],
            sparse_views,
            &format!(
                r#"{{"bufferView":0,"componentType":5126,"count":5,"type":"VEC3",{sparse_part},
                "min":[-3.25,0,-1.5],"max":[2.5,1.1,0.9]}}"#
            ),
            strip,
        ),
        case(
            "sparse without a base",
            (5, 3),
            &[&sparse],
            sparse_views,
            &format!(r#"{{"componentType":5126,"count":5,"type":"VEC3",{sparse_part}}}"#),
            strip,
        ),
        case(
            "sparse indices",
            (5, 4),
            &[&[indexed_bin.as_slice(), &[3, 0, 0, 0, 4, 0, 0, 0]].concat()],
            r#"{"buffer":0,"byteLength":60},{"buffer":0,"byteOffset":60,"byteLength":24},
               {"buffer":0,"byteOffset":84,"byteLength":1},{"buffer":0,"byteOffset":88,"byteLength":2}"#,
            &format!(
                r#"{position},{{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR",
                "sparse":{{"count":1,"indices":{{"bufferView":2,"componentType":5121}},
                "values":{{"bufferView":3}}}}}}"#
            ),
            r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}]"#,
        ),
        case(
            "two primitives, one accessor, a twin, points and lines",
            (5, 7),
            &[&indexed_bin],
            r#"{"buffer":0,"byteLength":60},{"buffer":0,"byteOffset":60,"byteLength":24}"#,
            &format!(
                r#"{position},{{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}},{position}"#
            ),
            r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1},
               {"attributes":{"POSITION":0},"mode":0},{"attributes":{"POSITION":7},"mode":1},
               {"attributes":{"POSITION":2},"mode":5}]}]"#,
        ),
        case(
            "two buffers",
            (10, 2),
            &[&points, &points],
            r#"{"buffer":0,"byteLength":60},{"buffer":1,"byteLength":60}"#,
            &format!("{position},{}", position.replace(r#""bufferView":0"#, r#""bufferView":1"#)),
            r#""meshes":[{"primitives":[{"attributes":{"POSITION":0}},{"attributes":{"POSITION":1}}]}]"#,
        ),
        case(
            "odd text, extras, unknown extensions, a missing image",
            (5, 1),
            &[&points],
            plain,
            &position.replace("\"min\"", "\"extras\" : {\"min\":[9,9,9]},\n\t\"m\\u0069n\" "),
            &format!(
                "\"extensionsUsed\":[\"X_y\"],\"extensionsRequired\":[\"KHR_materials_unlit\"],\
                 \"images\":[{{\"uri\":\"gone.png\"}}],\"extensions\":{{\"X_y\":{{\"accessors\":\
                 [{{\"min\":[1]}}],\"a\\\"]}}\":\"\\\\\"}}}},\r\n  {list}"
            ),
        ),
        placed(
            "turned and scaled",
            r#"{"mesh":0,"rotation":[0.1,0.2,0.3,0.9],"scale":[2,3,-0.5],"translation":[10,0,-7]}"#,
        ),
        placed(
            "matrix of a parent, an instance",
            r#"{"matrix":[0,0,-3,0,0,3,0,0,3,0,0,0,1,2,3,1],"children":[1,2]},{"mesh":0},
               {"mesh":0,"translation":[5,5,5]}"#,
        ),
        placed("far away", r#"{"mesh":0,"scale":[1e-7,1e-7,1e-7],"translation":[1e6,0,-1e6]}"#),
        placed("skinned", r#"{"mesh":0,"skin":0,"scale":[9,9,9]}"#),
    ]
}
