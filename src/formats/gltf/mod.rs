//! glTF 2.0 and GLB.
//!
//! Reads the carrier (the default scene's triangles, in world space) with checked arithmetic, and
//! writes new positions into the host's own bytes: POSITION data and the `min` and `max` of those
//! accessors change, nothing else. Opens no file that a URI names. Never reads textures, materials,
//! animations or morph targets.
//!
//! - `container`: JSON text and BIN chunk; `document`: the parts of the JSON that matter;
//! - `data_uri`, `buffers`: bytes; `accessors`: checked spans of bytes;
//! - `scene`: which meshes, where; `carrier`: position blocks and primitives;
//! - `overlap`: refuses layouts that cannot be patched; `geometry`: positions and triangles;
//! - `transform`: the arithmetic that reading and writing share;
//! - `json_spans`, `write`, `assemble`: patching.

mod accessors;
mod assemble;
mod buffers;
mod carrier;
mod container;
mod data_uri;
mod document;
mod geometry;
mod json_spans;
mod overlap;
mod scene;
#[cfg(test)]
mod tests;
mod transform;
mod write;

use glam::DVec3;

use self::buffers::Buffers;
use self::carrier::Block;
use self::container::Container;
use super::{Format, FormatError, Limits, Stop, go_on};
use crate::mesh::Mesh;
use crate::mesh::stop::changed;

/// Where the coordinates stand.
#[derive(Debug)]
pub(super) struct Layout {
    file_bytes: usize,
    container: Container,
    blocks: Vec<Block>,
    pinned: Vec<u32>,
}

/// Reads the carrier mesh of a glTF or GLB file.
pub(super) fn read(
    bytes: &[u8],
    format: Format,
    limits: &Limits,
    stop: Stop<'_>,
) -> Result<(Mesh, Layout), FormatError> {
    if bytes.is_empty() {
        return Err(FormatError::Empty);
    }
    let container = container::split(bytes, format)?;
    let document = document::parse(bytes.get(container.json.clone()).unwrap_or_default())?;
    for extension in &document.extensions_required {
        match extension.as_str() {
            "KHR_draco_mesh_compression"
            | "EXT_meshopt_compression"
            | "KHR_meshopt_compression" => return Err(compressed(extension)),
            "KHR_mesh_quantization" => return Err(quantised()),
            // Materials, lights, variants and the like move no vertex.
            _ => {}
        }
    }
    go_on(stop)?;
    let placed = scene::placed_meshes(&document)?;
    let mut buffers = Buffers::new(bytes, &container, &document);
    let carrier = carrier::gather(&document, &mut buffers, &placed, limits, bytes.len())?;
    if carrier.triangles == 0 {
        return Err(FormatError::NoTriangles);
    }
    let mut blocks = carrier.blocks;
    // Before anything is allocated: blocks that share no byte are together no larger than the
    // file, however many accessors a hostile document declares.
    overlap::check(&document, &mut blocks)?;
    let positions = geometry::positions(&blocks, &buffers, carrier.vertices, stop)?;
    let triangles =
        geometry::triangles(&carrier.pieces, &blocks, &buffers, carrier.triangles, stop)?;
    let pinned = geometry::pinned(&blocks)?;
    drop(buffers);
    let mesh = Mesh::new(positions, triangles)?;
    Ok((mesh, Layout { file_bytes: bytes.len(), container, blocks, pinned }))
}

impl Layout {
    /// Vertices without bytes of their own, ascending.
    pub(super) fn pinned(&self) -> &[u32] {
        &self.pinned
    }

    /// Replaces positions by what they would read back as. Meaningless once `stop` returns `true`.
    pub(super) fn round(&self, host: &Mesh, positions: &mut [DVec3], stop: Stop<'_>) {
        for block in &self.blocks {
            let range = block.first..block.first.saturating_add(block.key.count);
            let (Some(hosts), Some(moved)) =
                (host.positions().get(range.clone()), positions.get_mut(range))
            else {
                continue;
            };
            let settled = changed(moved, stop, |vertex, position| {
                let Some(&host) = hosts.get(vertex) else { return };
                if !transform::same(*position, host) {
                    let settled = block.transform.settle(*position);
                    *position = settled.map_or(host, |(_, position)| position);
                }
            });
            if settled.is_none() {
                return;
            }
        }
        for &vertex in &self.pinned {
            let Ok(vertex) = usize::try_from(vertex) else { continue };
            if let (Some(position), Some(&host)) =
                (positions.get_mut(vertex), host.positions().get(vertex))
            {
                *position = host;
            }
        }
    }

    /// The host's bytes with new coordinates.
    pub(super) fn write(
        &self,
        bytes: &[u8],
        host: &Mesh,
        positions: &[DVec3],
        stop: Stop<'_>,
    ) -> Result<Vec<u8>, FormatError> {
        write::write(self, bytes, host, positions, stop)
    }
}

fn malformed(path: impl Into<String>, reason: impl Into<String>) -> FormatError {
    FormatError::MalformedGltf { path: path.into(), reason: reason.into() }
}

fn compressed(extension: &str) -> FormatError {
    FormatError::UnsupportedExtension {
        extension: extension.to_owned(),
        advice: "the geometry is compressed; decode the file first (for example with \
                 `gltf-transform copy in.glb out.glb`)"
            .to_owned(),
    }
}

fn quantised() -> FormatError {
    FormatError::UnsupportedExtension {
        extension: "KHR_mesh_quantization".to_owned(),
        advice: "positions are stored as integers; convert them to 32-bit floats first (for \
                 example with `gltf-transform dequantize in.glb out.glb`)"
            .to_owned(),
    }
}
