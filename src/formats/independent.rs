//! A second opinion: marked files are opened with the independent readers `tobj` and `gltf`.
//!
//! Both only read bytes that our own reader has read before, and neither is given a path to open.
//! They panic on files they do not expect, so panics are caught at each call.

use std::collections::HashMap;
use std::fmt::Debug;
use std::io::{self, BufRead, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::{Format, Stop};

/// What an independent reader finds in a marked file compared with its host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Agreement {
    /// It reads both, with the same topology.
    Same,
    /// It cannot read the host, so it has no opinion. The reason is for the log.
    HostUnreadable(String),
    /// It reads the host but not the marked file, or with another topology: a bug of ours.
    Differs(String),
}

/// Compares host and marked file in an independent reader.
#[must_use]
pub fn agrees(format: Format, host: &[u8], marked: &[u8]) -> Agreement {
    agrees_until(format, host, marked, &|| false)
}

/// Like [`agrees`]; the result is meaningless once `stop` returns `true`.
#[must_use]
pub fn agrees_until(format: Format, host: &[u8], marked: &[u8], stop: Stop<'_>) -> Agreement {
    let given_up = || if stop() { Err("given up".to_owned()) } else { Ok(()) };
    match format {
        Format::Obj => compare(|bytes| obj_outline(Heard { bytes, stop }), host, marked),
        Format::Gltf | Format::Glb => {
            compare(|bytes| given_up().and_then(|()| gltf_outline(bytes)), host, marked)
        }
    }
}

/// Bytes that can no longer be read once `stop` returns `true`.
struct Heard<'a> {
    bytes: &'a [u8],
    stop: Stop<'a>,
}

/// Bytes that a reader gets at once, at most.
const PART: usize = 64 << 10;

impl BufRead for Heard<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if (self.stop)() {
            return Err(io::Error::other("given up"));
        }
        Ok(self.bytes.get(..PART).unwrap_or(self.bytes))
    }

    fn consume(&mut self, amount: usize) {
        self.bytes = self.bytes.get(amount..).unwrap_or_default();
    }
}

impl Read for Heard<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let read = self.fill_buf()?.read(to)?;
        self.consume(read);
        Ok(read)
    }
}

/// Reads the host first: a file that the reader cannot read at all is not a fault of the mark.
fn compare<O: Debug + PartialEq>(
    outline: impl Fn(&[u8]) -> Result<Vec<O>, String>,
    host: &[u8],
    marked: &[u8],
) -> Agreement {
    let contained = |bytes: &[u8]| {
        catch_unwind(AssertUnwindSafe(|| outline(bytes)))
            .unwrap_or_else(|_| Err("the reader panicked".into()))
    };
    let host = match contained(host) {
        Ok(host) => host,
        Err(reason) => return Agreement::HostUnreadable(reason),
    };
    let marked = match contained(marked) {
        Ok(marked) => marked,
        Err(reason) => return Agreement::Differs(reason),
    };
    if host.len() != marked.len() {
        return Agreement::Differs(format!("{} parts became {}", host.len(), marked.len()));
    }
    match host.iter().zip(&marked).position(|(host, marked)| host != marked) {
        Some(part) => Agreement::Differs(format!("part {part} has another structure")),
        None => Agreement::Same,
    }
}

/// A model of an OBJ, without the values that a mark may change. tobj numbers vertices in the order
/// of first use, so the model shows which corners are shared, not which line each came from.
#[derive(Debug, PartialEq)]
struct ObjModel {
    name: String,
    /// Lengths of positions, colours, normals and texture coordinates.
    counts: [usize; 4],
    /// Of positions, texture coordinates and normals.
    indices: [Vec<u32>; 3],
}

fn obj_outline(mut bytes: impl BufRead) -> Result<Vec<ObjModel>, String> {
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    // The callback is asked for every `mtllib`; it opens nothing.
    let (models, _) =
        tobj::load_obj_buf(&mut bytes, &options, |_| Ok((Vec::new(), HashMap::default())))
            .map_err(|error| error.to_string())?;
    let outline = models.into_iter().map(|model| {
        let mesh = model.mesh;
        ObjModel {
            name: model.name,
            counts: [
                mesh.positions.len(),
                mesh.vertex_color.len(),
                mesh.normals.len(),
                mesh.texcoords.len(),
            ],
            indices: [mesh.indices, mesh.texcoord_indices, mesh.normal_indices],
        }
    });
    Ok(outline.collect())
}

/// A part of a glTF document, without the values that a mark may change.
#[derive(Debug, PartialEq)]
enum GltfPart {
    Document { nodes: usize, meshes: usize, materials: usize, binary_bytes: Option<usize> },
    Accessor { count: usize, kind: String, view: Option<usize>, offset: usize },
    View { buffer: usize, offset: usize, length: usize, stride: Option<usize> },
    Primitive { mesh: usize, mode: String, attributes: Vec<usize>, indices: Option<usize> },
}

/// Uses `from_slice` and never `import`, which opens the files and URLs that a document names.
fn gltf_outline(bytes: &[u8]) -> Result<Vec<GltfPart>, String> {
    let gltf = gltf::Gltf::from_slice(bytes).map_err(|error| error.to_string())?;
    let mut parts = vec![GltfPart::Document {
        nodes: gltf.nodes().len(),
        meshes: gltf.meshes().len(),
        materials: gltf.materials().len(),
        binary_bytes: gltf.blob.as_ref().map(Vec::len),
    }];
    parts.extend(gltf.accessors().map(|accessor| GltfPart::Accessor {
        count: accessor.count(),
        kind: format!("{:?} {:?}", accessor.data_type(), accessor.dimensions()),
        view: accessor.view().map(|view| view.index()),
        offset: accessor.offset(),
    }));
    parts.extend(gltf.views().map(|view| GltfPart::View {
        buffer: view.buffer().index(),
        offset: view.offset(),
        length: view.length(),
        stride: view.stride(),
    }));
    for mesh in gltf.meshes() {
        parts.extend(mesh.primitives().map(|primitive| GltfPart::Primitive {
            mesh: mesh.index(),
            mode: format!("{:?}", primitive.mode()),
            attributes: primitive.attributes().map(|(_, accessor)| accessor.index()).collect(),
            indices: primitive.indices().map(|accessor| accessor.index()),
        }));
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib /etc/passwd\nf 1 2 3\n";

    #[test]
    fn obj_topology_is_compared_and_coordinates_are_not() {
        let agree = |marked: &str| agrees(Format::Obj, TRIANGLE.as_bytes(), marked.as_bytes());
        assert_eq!(agree(TRIANGLE), Agreement::Same);
        assert_eq!(agree(&TRIANGLE.replace("v 1", "v 1.25")), Agreement::Same);
        for marked in [
            TRIANGLE.replace("f 1 2 3", "f 1 2 2"),
            TRIANGLE.replace("f 1 2 3", "f 1 2 3\nf 3 2 1"),
            TRIANGLE.replace("f 1 2 3", "f 1 2 4"),
            TRIANGLE.replace("v 1", "v one"),
        ] {
            assert!(matches!(agree(&marked), Agreement::Differs(_)), "{marked}");
        }
    }

    #[test]
    fn no_opinion_on_a_host_that_the_reader_cannot_read() {
        let host = TRIANGLE.replace("1 0 0", "1 \\\n 0 0");
        let opinion = agrees(Format::Obj, host.as_bytes(), host.as_bytes());
        assert!(matches!(opinion, Agreement::HostUnreadable(_)), "{opinion:?}");
        let opinion = agrees(Format::Glb, b"glTF", b"glTF");
        assert!(matches!(opinion, Agreement::HostUnreadable(_)), "{opinion:?}");
    }

    #[test]
    fn a_panic_is_an_answer() {
        let panics = |bytes: &[u8]| match bytes {
            b"good" => Ok(vec![1]),
            _ => panic!("on purpose"),
        };
        let opinion = |host, marked| compare(panics, host, marked);
        assert_eq!(opinion(b"good", b"good"), Agreement::Same);
        assert!(matches!(opinion(b"bad", b"good"), Agreement::HostUnreadable(_)));
        assert!(matches!(opinion(b"good", b"bad"), Agreement::Differs(_)));
    }

    #[test]
    fn gltf_structure_is_compared() {
        let host = r#"{"asset":{"version":"2.0"},
            "buffers":[{"byteLength":36,"uri":"file:///etc/passwd"}],
            "bufferViews":[{"buffer":0,"byteLength":36}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3",
                "min":[0,0,0],"max":[1,1,0]}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
            "nodes":[{"mesh":0}]}"#;
        let agree = |marked: &str| agrees(Format::Gltf, host.as_bytes(), marked.as_bytes());
        assert_eq!(agree(host), Agreement::Same);
        assert_eq!(agree(&host.replace("[1,1,0]", "[1.5,1,0]")), Agreement::Same);
        for marked in [
            host.replace("\"count\":3", "\"count\":2"),
            host.replace("\"attributes\"", "\"mode\":1,\"attributes\""),
            host.replace("[{\"mesh\":0}]", "[{\"mesh\":0},{}]"),
            host.replace("VEC3", "VEC9"),
        ] {
            assert!(matches!(agree(&marked), Agreement::Differs(_)), "{marked}");
        }
    }
}
