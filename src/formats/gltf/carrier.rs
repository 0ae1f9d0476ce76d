//! From placed meshes to position blocks and the primitives that connect them.
//!
//! Vertices belong to accessors, not to primitives: a *position block* is one distinct layout of
//! POSITION bytes, however many primitives name it. Only the structure is read here. Counts are
//! checked against the limits before anything of their size is allocated.

use std::collections::HashMap;

use super::accessors::{self, Declared, Part, Span, SparseSpans};
use super::buffers::Buffers;
use super::document::{Document, FLOAT, Primitive};
use super::scene::Placed;
use super::transform::Transform;
use super::{compressed, malformed};
use crate::formats::{FormatError, Limits};

/// Bytes of one POSITION element, three 32-bit floats.
pub(super) const POSITION_BYTES: usize = 12;

/// How many times primitives may, on average, name the same indices. Several materials over one
/// surface do so a few times. A hostile file does so a thousand times, and every repeated triangle
/// takes as much memory and time as one of its own.
const MOST_REPEATS: usize = 4;

/// Number of corners, and of elements without bytes, that are allowed in a file of any size.
const FEW_CORNERS: usize = 3 << 16;
const FEW_ELEMENTS: usize = 1 << 16;

/// What makes two POSITION accessors the same data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct BlockKey {
    pub(super) count: usize,
    pub(super) base: Option<Span>,
    pub(super) sparse: Option<SparseSpans>,
}

impl BlockKey {
    fn sparse_values(&self) -> Option<&Span> {
        self.sparse.as_ref().map(|sparse| &sparse.values)
    }
}

/// One layout of POSITION bytes: `count` vertices of the mesh, from `first` on.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) first: usize,
    pub(super) key: BlockKey,
    /// Elements that the sparse values override, ascending.
    pub(super) overridden: Vec<u32>,
    pub(super) transform: Transform,
    /// Every accessor that declares this layout, the first used one first.
    pub(super) accessors: Vec<usize>,
}

impl Block {
    /// Buffer and offset of an element's bytes; `None` when it has none of its own.
    pub(super) fn locate(&self, element: usize) -> Option<(usize, usize)> {
        if let Some(sparse) = &self.key.sparse {
            let wanted = u32::try_from(element).ok()?;
            if let Ok(k) = self.overridden.binary_search(&wanted) {
                return Some((sparse.values.buffer, sparse.values.offset(k)));
            }
        }
        self.key.base.as_ref().map(|base| (base.buffer, base.offset(element)))
    }

    /// The accessor to name in errors.
    pub(super) fn accessor(&self) -> usize {
        self.accessors.first().copied().unwrap_or_default()
    }
}

/// How corners become triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    List,
    Strip,
    Fan,
}

/// A primitive of triangles.
#[derive(Debug)]
pub(super) struct Piece {
    /// Index of its block.
    pub(super) block: usize,
    /// Its index accessor, if it has one, and where the indices stand.
    pub(super) indices: Option<(usize, BlockKey)>,
    pub(super) mode: Mode,
}

/// The carrier's structure.
#[derive(Debug, Default)]
pub(super) struct Carrier {
    pub(super) blocks: Vec<Block>,
    pub(super) pieces: Vec<Piece>,
    pub(super) vertices: usize,
    pub(super) triangles: usize,
}

/// Collects blocks and pieces in traversal order.
pub(super) fn gather(
    document: &Document,
    buffers: &mut Buffers,
    placed: &[Placed],
    limits: &Limits,
    file_bytes: usize,
) -> Result<Carrier, FormatError> {
    let mut gathering = Gathering {
        document,
        buffers,
        limits,
        file_bytes,
        by_accessor: HashMap::new(),
        by_key: HashMap::new(),
        carrier: Carrier::default(),
        corners: 0,
        named: Vec::new(),
        byteless: 0,
    };
    for place in placed {
        let primitives = document.meshes.get(place.mesh).map_or(&[][..], |mesh| &mesh.primitives);
        for (index, primitive) in primitives.iter().enumerate() {
            let path = || format!("meshes[{}].primitives[{index}]", place.mesh);
            gathering.primitive(primitive, &place.transform, &path)?;
        }
    }
    gathering.bounded()?;
    Ok(gathering.carrier)
}

/// Distinct elements of the file: bytes that several spans cover count once.
fn distinct_elements(spans: &mut [Span]) -> usize {
    spans.sort_unstable_by_key(|span| (span.buffer, span.start));
    let (mut elements, mut buffer, mut passed) = (0_usize, None, 0);
    for span in spans.iter() {
        if buffer != Some(span.buffer) {
            (buffer, passed) = (Some(span.buffer), 0);
        }
        let end = span.start.saturating_add(span.count.saturating_mul(span.stride));
        let new = end.saturating_sub(passed.max(span.start));
        elements = elements.saturating_add(new.div_ceil(span.stride.max(1)));
        passed = passed.max(end);
    }
    elements
}

struct Gathering<'a, 'b> {
    document: &'a Document,
    buffers: &'a mut Buffers<'b>,
    limits: &'a Limits,
    file_bytes: usize,
    by_accessor: HashMap<usize, usize>,
    by_key: HashMap<BlockKey, usize>,
    carrier: Carrier,
    /// Corners of all pieces, and the spans of bytes that say which corners they are.
    corners: usize,
    named: Vec<Span>,
    /// Elements that have no bytes.
    byteless: usize,
}

impl Gathering<'_, '_> {
    fn primitive(
        &mut self,
        primitive: &Primitive,
        transform: &Transform,
        path: &dyn Fn() -> String,
    ) -> Result<(), FormatError> {
        let mode = match primitive.mode {
            0..=3 => return Ok(()),
            4 => Mode::List,
            5 => Mode::Strip,
            6 => Mode::Fan,
            other => {
                let reason = format!("{other} is none of the modes 0 to 6");
                return Err(malformed(format!("{}.mode", path()), reason));
            }
        };
        if primitive.extensions.contains_key("KHR_draco_mesh_compression") {
            return Err(compressed("KHR_draco_mesh_compression"));
        }
        // The specification allows a primitive without positions: there is nothing to draw, and
        // nothing to move.
        let Some(&position) = primitive.attributes.get("POSITION") else { return Ok(()) };
        let block = self.block(position, transform, path)?;
        let indices = match primitive.indices {
            Some(accessor) => Some((accessor, self.indices(accessor, path)?)),
            None => None,
        };
        let corners = match (&indices, self.carrier.blocks.get(block)) {
            (Some((_, key)), _) => key.count,
            (None, Some(block)) => block.key.count,
            (None, None) => 0,
        };
        let triangles = match mode {
            Mode::List => corners / 3,
            Mode::Strip | Mode::Fan => corners.saturating_sub(2),
        };
        self.carrier.triangles =
            within("triangles", self.carrier.triangles, triangles, self.limits.max_triangles)?;
        self.corners = self.corners.saturating_add(corners);
        let named = match (&indices, self.carrier.blocks.get(block)) {
            (Some((_, key)), _) => Some(*key),
            (None, block) => block.map(|block| block.key),
        };
        self.named.extend(named.iter().flat_map(|key| key.base.iter().chain(key.sparse_values())));
        self.carrier.pieces.push(Piece { block, indices, mode });
        Ok(())
    }

    /// Refuses more corners than the bytes of the file can stand for.
    fn bounded(&mut self) -> Result<(), FormatError> {
        let own = distinct_elements(&mut self.named);
        let limit = own.saturating_mul(MOST_REPEATS).saturating_add(FEW_CORNERS);
        if self.corners > limit {
            return Err(FormatError::TooLarge {
                what: "corners of triangles, most of which repeat others",
                count: self.corners as u64,
                limit: limit as u64,
            });
        }
        Ok(())
    }

    fn block(
        &mut self,
        index: usize,
        transform: &Transform,
        path: &dyn Fn() -> String,
    ) -> Result<usize, FormatError> {
        if let Some(&block) = self.by_accessor.get(&index) {
            return Ok(block);
        }
        let named_by = || format!("{}.attributes.POSITION", path());
        let accessor = accessors::get(self.document, index, named_by, self.file_bytes)?;
        if accessor.kind != "VEC3" {
            let kind: String = accessor.kind.chars().take(20).collect();
            let reason = format!("{kind:?} cannot hold positions: expected \"VEC3\"");
            return Err(malformed(format!("accessors[{index}].type"), reason));
        }
        if accessor.component_type != FLOAT {
            return Err(match accessors::component_bytes(accessor.component_type) {
                Some(_) => super::quantised(),
                None => malformed(
                    format!("accessors[{index}].componentType"),
                    format!("{} cannot hold positions: expected 5126", accessor.component_type),
                ),
            });
        }
        let key = self.key(index, POSITION_BYTES)?;
        if let Some(&block) = self.by_key.get(&key) {
            self.by_accessor.insert(index, block);
            return Ok(block);
        }
        if key.base.is_none() {
            // Elements without bytes are zeros: no more of them are allowed than the file could
            // have stored.
            let limit = FEW_ELEMENTS.max(self.file_bytes / POSITION_BYTES);
            self.byteless = within("vertices without bytes", self.byteless, key.count, limit)?;
        }
        let first = self.carrier.vertices;
        self.carrier.vertices = within("vertices", first, key.count, self.limits.max_vertices)?;
        let overridden = match &key.sparse {
            Some(sparse) => accessors::overridden(self.buffers, index, key.count, &sparse.indices)?,
            None => Vec::new(),
        };
        let block = self.carrier.blocks.len();
        let (transform, accessors) = (*transform, vec![index]);
        self.carrier.blocks.push(Block { first, key, overridden, transform, accessors });
        self.by_accessor.insert(index, block);
        self.by_key.insert(key, block);
        Ok(block)
    }

    fn indices(
        &mut self,
        index: usize,
        path: &dyn Fn() -> String,
    ) -> Result<BlockKey, FormatError> {
        let named_by = || format!("{}.indices", path());
        let accessor = accessors::get(self.document, index, named_by, self.file_bytes)?;
        if accessor.kind != "SCALAR" {
            let reason = "indices must be of type \"SCALAR\"";
            return Err(malformed(format!("accessors[{index}].type"), reason));
        }
        let size = accessors::index_bytes(accessor.component_type, || {
            format!("accessors[{index}].componentType")
        })?;
        self.key(index, size)
    }

    fn key(&mut self, index: usize, size: usize) -> Result<BlockKey, FormatError> {
        let Some(accessor) = self.document.accessors.get(index) else {
            return Err(malformed(format!("accessors[{index}]"), "it does not exist"));
        };
        let count = accessor.count;
        let base = match accessor.buffer_view {
            Some(view) => {
                let declared = Declared { view, offset: accessor.byte_offset, size, count };
                Some(accessors::span(self.document, self.buffers, index, Part::Base, declared)?)
            }
            None => None,
        };
        let sparse = accessors::sparse_spans(self.document, self.buffers, index, accessor, size)?;
        Ok(BlockKey { count, base, sparse })
    }
}

fn within(what: &'static str, sum: usize, more: usize, limit: usize) -> Result<usize, FormatError> {
    let sum = sum.saturating_add(more);
    if sum > limit {
        return Err(FormatError::TooLarge { what, count: sum as u64, limit: limit as u64 });
    }
    Ok(sum)
}
