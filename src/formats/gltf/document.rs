//! The parts of a glTF document that geometry depends on, as plain data.
//!
//! Everything else is ignored here and kept in the file: nothing is ever written from these
//! structures. Duplicate keys of the parts read here are errors, so that no two readers can
//! see two different files in one.
#![expect(clippy::zero_sized_map_values, reason = "only the names of extensions matter")]

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{json_spans, malformed};
use crate::formats::FormatError;

/// Component type 5126, 32-bit floating point.
pub(super) const FLOAT: u32 = 5126;

type Extensions = BTreeMap<String, IgnoredAny>;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    asset: AssetInfo,
    #[serde(default)]
    pub(super) extensions_required: Vec<String>,
    pub(super) scene: Option<usize>,
    #[serde(default)]
    pub(super) scenes: Vec<Scene>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<MeshEntry>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    pub(super) images: Vec<Image>,
    #[serde(default)]
    pub(super) skins: Vec<Skin>,
    #[serde(default)]
    pub(super) animations: Vec<Animation>,
}

#[derive(Debug, Deserialize)]
struct AssetInfo {
    version: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) skin: Option<usize>,
    // Boxed: a node of two bytes, `{}`, must not become three hundred.
    pub(super) matrix: Option<Box<[f64; 16]>>,
    pub(super) translation: Option<Box<[f64; 3]>>,
    pub(super) rotation: Option<Box<[f64; 4]>>,
    pub(super) scale: Option<Box<[f64; 3]>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct MeshEntry {
    #[serde(default)]
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    pub(super) indices: Option<usize>,
    #[serde(default = "triangles")]
    pub(super) mode: u32,
    #[serde(default)]
    pub(super) targets: Vec<BTreeMap<String, usize>>,
    #[serde(default)]
    pub(super) extensions: Extensions,
}

fn triangles() -> u32 {
    4
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub(super) count: usize,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: usize,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
    #[serde(default)]
    pub(super) extensions: Extensions,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    pub(super) byte_length: usize,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image {
    pub(super) buffer_view: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub(super) inverse_bind_matrices: Option<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Animation {
    #[serde(default)]
    pub(super) samplers: Vec<Sampler>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sampler {
    pub(super) input: usize,
    pub(super) output: usize,
}

/// Parses the JSON text.
pub(super) fn parse(json: &[u8]) -> Result<Document, FormatError> {
    if let Err(error) = std::str::from_utf8(json) {
        return Err(malformed("JSON", format!("byte {} is not UTF-8", error.valid_up_to())));
    }
    // Deep nesting overflows the stack of readers that recurse. This reader does not recurse;
    // others may.
    if json_spans::nested_deeper_than(json, 127) {
        return Err(malformed("JSON", "nested more than 127 levels deep: simplify the file"));
    }
    let mut reader = serde_json::Deserializer::from_slice(json);
    let document: Document = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        if let Some(old) = old_version(json) {
            return old;
        }
        let path = error.path().to_string();
        // A text that is not JSON has no path.
        let path = if path == "." || path == "?" { "JSON".to_owned() } else { path };
        let mut reason = error.into_inner().to_string();
        reason = reason.replace("expected usize", "expected a whole number from 0 on");
        if !path.contains('.') && reason.contains("map, expected a sequence") {
            reason.push_str("; if this is glTF 1.0, export the asset as glTF 2.0");
        }
        malformed(path, reason)
    })?;
    reader.end().map_err(|error| malformed("JSON", error.to_string()))?;
    version(&document.asset).map_or(Ok(document), Err)
}

/// A glTF 1.0 document fails for many reasons; the version is the one that helps the user.
fn old_version(json: &[u8]) -> Option<FormatError> {
    #[derive(Deserialize)]
    struct Preface {
        asset: AssetInfo,
    }
    version(&serde_json::from_slice::<Preface>(json).ok()?.asset)
}

fn version(asset: &AssetInfo) -> Option<FormatError> {
    let two = asset.version == "2" || asset.version.starts_with("2.");
    (!two).then(|| {
        let version: String = asset.version.chars().take(20).collect();
        malformed("asset.version", format!("{version:?} is not 2.0: export the asset as glTF 2.0"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(json: &str) -> String {
        match parse(json.as_bytes()) {
            Err(FormatError::MalformedGltf { path, reason }) => {
                assert!(!reason.is_empty());
                path
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn errors_name_the_json_path() {
        for (json, expected) in [
            ("", "JSON"),
            ("[]", "JSON"),
            ("{5:6}", "JSON"),
            (r#"{"asset":{},"accessors":{}}"#, "asset"),
            ("{}", "JSON"),
            (r#"{"asset":{"version":"1.0"},"accessors":{}}"#, "asset.version"),
            (r#"{"asset":{"version":"3.0"}}"#, "asset.version"),
            (r#"{"asset":{"version":"2.0"}} x"#, "JSON"),
            (r#"{"asset":{"version":"2.0"},"scene":-1}"#, "scene"),
            (
                r#"{"asset":{"version":"2.0"},"accessors":[{"componentType":1,"type":"x","count":-1}]}"#,
                "accessors[0].count",
            ),
            (
                r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":1e99}]}"#,
                "buffers[0].byteLength",
            ),
        ] {
            assert_eq!(path(json), expected, "{json}");
        }
    }

    #[test]
    fn deep_nesting_and_bad_text_are_refused() {
        let deep = format!(
            r#"{{"asset":{{"version":"2.0"}},"extras":{}{}}}"#,
            "[".repeat(100_000),
            "]".repeat(100_000)
        );
        assert_eq!(path(&deep), "JSON");
        assert!(parse(b"{\"asset\":{\"version\":\"2.0\"},\"extras\":\"\xFF\"}").is_err());
    }
}
