//! Checks every offset, count and stride of accessors. The result is a [`Span`] whose every element
//! lies inside its buffer, or an error that names the JSON path.
//!
//! Must not know what the elements mean. Nothing is allocated here by a declared count alone.

use super::buffers::Buffers;
use super::document::{Accessor, Document};
use super::malformed;
use crate::formats::FormatError;

/// Elements of equal size at equal distance in one buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Span {
    pub(super) buffer: usize,
    pub(super) start: usize,
    pub(super) stride: usize,
    pub(super) size: usize,
    pub(super) count: usize,
}

impl Span {
    /// Where element `index` starts. Cannot overflow for `index < count`.
    pub(super) fn offset(&self, index: usize) -> usize {
        self.start + index * self.stride
    }
}

/// The part of an accessor that an error's path names.
#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    Base,
    SparseIndices,
    SparseValues,
}

impl Part {
    fn path(self, accessor: usize) -> String {
        match self {
            Self::Base => format!("accessors[{accessor}]"),
            Self::SparseIndices => format!("accessors[{accessor}].sparse.indices"),
            Self::SparseValues => format!("accessors[{accessor}].sparse.values"),
        }
    }
}

/// Elements as a document declares them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Declared {
    pub(super) view: usize,
    pub(super) offset: usize,
    pub(super) size: usize,
    pub(super) count: usize,
}

/// Checks declared elements against their bufferView and buffer, and loads the buffer.
pub(super) fn span(
    document: &Document,
    buffers: &mut Buffers,
    accessor: usize,
    part: Part,
    declared: Declared,
) -> Result<Span, FormatError> {
    let Declared { view: index, offset, size, count } = declared;
    let Some(view) = document.buffer_views.get(index) else {
        let path = format!("{}.bufferView", part.path(accessor));
        return Err(malformed(path, format!("bufferViews[{index}] does not exist")));
    };
    for extension in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        // The view may have an uncompressed copy, but only one of the two would be marked.
        if view.extensions.contains_key(extension) {
            return Err(super::compressed(extension));
        }
    }
    let stride = view.byte_stride.unwrap_or(size);
    if stride < size {
        return Err(malformed(
            format!("bufferViews[{index}].byteStride"),
            format!(
                "{stride} is less than the {size} bytes of one element of accessors[{accessor}]"
            ),
        ));
    }
    let needed = count
        .checked_sub(1)
        .and_then(|gaps| gaps.checked_mul(stride))
        .and_then(|bytes| bytes.checked_add(size))
        .and_then(|bytes| bytes.checked_add(offset));
    if needed.is_none_or(|needed| needed > view.byte_length) {
        return Err(malformed(
            part.path(accessor),
            format!(
                "{count} elements at offset {offset} do not fit bufferViews[{index}] of {} bytes",
                view.byte_length
            ),
        ));
    }
    let held = document.buffers.get(view.buffer).map_or(0, |buffer| buffer.byte_length);
    buffers.load(document, view.buffer)?;
    if view.byte_offset.checked_add(view.byte_length).is_none_or(|end| end > held) {
        return Err(malformed(
            format!("bufferViews[{index}]"),
            format!("it reaches beyond the {held} bytes of buffers[{}]", view.buffer),
        ));
    }
    // Both sums were checked above: offset fits the view, the view fits the buffer.
    Ok(Span { buffer: view.buffer, start: view.byte_offset + offset, stride, size, count })
}

/// Looks an accessor up and refuses counts that no file of this size can mean.
pub(super) fn get(
    document: &Document,
    index: usize,
    named_by: impl FnOnce() -> String,
    file_bytes: usize,
) -> Result<&Accessor, FormatError> {
    let accessor = document
        .accessors
        .get(index)
        .ok_or_else(|| malformed(named_by(), format!("accessors[{index}] does not exist")))?;
    let path = || format!("accessors[{index}].count");
    if accessor.count == 0 {
        return Err(malformed(path(), "an accessor needs at least one element"));
    }
    // Elements without bytes are zeros, and a 1 KB file could declare a billion of them.
    if accessor.buffer_view.is_none() && accessor.count > file_bytes.saturating_mul(16) {
        return Err(malformed(
            path(),
            format!("{} elements without a bufferView, in so small a file", accessor.count),
        ));
    }
    Ok(accessor)
}

/// Bytes of one component, by component type.
pub(super) fn component_bytes(component_type: u32) -> Option<usize> {
    match component_type {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5125 | super::document::FLOAT => Some(4),
        _ => None,
    }
}

/// Bytes of one unsigned integer component that may serve as an index.
pub(super) fn index_bytes(
    component_type: u32,
    path: impl FnOnce() -> String,
) -> Result<usize, FormatError> {
    match component_type {
        5121 => Ok(1),
        5123 => Ok(2),
        5125 => Ok(4),
        other => Err(malformed(
            path(),
            format!("{other} cannot hold indices: expected 5121, 5123 or 5125"),
        )),
    }
}

/// One index; `None` only beyond the bytes.
pub(super) fn index_at(bytes: &[u8], span: &Span, element: usize) -> Option<u32> {
    let at = span.offset(element);
    let raw = bytes.get(at..at.checked_add(span.size)?)?;
    match *raw {
        [a] => Some(u32::from(a)),
        [a, b] => Some(u32::from(u16::from_le_bytes([a, b]))),
        [a, b, c, d] => Some(u32::from_le_bytes([a, b, c, d])),
        _ => None,
    }
}

/// Where a sparse accessor keeps the indices and the values of the elements it overrides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct SparseSpans {
    pub(super) indices: Span,
    pub(super) values: Span,
}

/// The sparse part of an accessor; all but the indices themselves is checked.
pub(super) fn sparse_spans(
    document: &Document,
    buffers: &mut Buffers,
    index: usize,
    accessor: &Accessor,
    size: usize,
) -> Result<Option<SparseSpans>, FormatError> {
    let Some(sparse) = accessor.sparse.as_ref().filter(|sparse| sparse.count > 0) else {
        return Ok(None);
    };
    let count = sparse.count;
    if count > accessor.count {
        return Err(malformed(
            format!("accessors[{index}].sparse.count"),
            format!("{count} overrides of {} elements", accessor.count),
        ));
    }
    let index_size = index_bytes(sparse.indices.component_type, || {
        format!("accessors[{index}].sparse.indices.componentType")
    })?;
    let (view, offset) = (sparse.indices.buffer_view, sparse.indices.byte_offset);
    let declared = Declared { view, offset, size: index_size, count };
    let indices = span(document, buffers, index, Part::SparseIndices, declared)?;
    let (view, offset) = (sparse.values.buffer_view, sparse.values.byte_offset);
    let declared = Declared { view, offset, size, count };
    let values = span(document, buffers, index, Part::SparseValues, declared)?;
    Ok(Some(SparseSpans { indices, values }))
}

/// The elements that a sparse accessor of `count` elements overrides, ascending.
pub(super) fn overridden(
    buffers: &Buffers,
    index: usize,
    count: usize,
    indices: &Span,
) -> Result<Vec<u32>, FormatError> {
    let bytes = buffers.bytes(indices.buffer);
    let mut elements: Vec<u32> = Vec::with_capacity(indices.count);
    for k in 0..indices.count {
        let element = index_at(bytes, indices, k)
            .filter(|&e| usize::try_from(e).is_ok_and(|e| e < count))
            .filter(|&e| elements.last().is_none_or(|&last| last < e))
            .ok_or_else(|| {
                malformed(
                    format!("accessors[{index}].sparse.indices"),
                    format!("entry {k} must be below {count} and above the one before"),
                )
            })?;
        elements.push(element);
    }
    Ok(elements)
}
