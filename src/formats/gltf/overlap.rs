//! Refuses files in which moving a vertex would change anything but a position.
//!
//! POSITION bytes may be interleaved with other attributes, but must not be the bytes of another
//! accessor or of an image. The check is one sweep over sorted intervals: a hostile file with a
//! hundred thousand accessors must not cost the square of them.

use std::collections::HashMap;

use super::accessors::{Span, SparseSpans, component_bytes};
use super::carrier::{Block, BlockKey};
use super::document::{Accessor, Document, FLOAT};
use crate::formats::FormatError;

/// Most comparisons of a sweep. Real files need a few per accessor; a file that needs more than
/// this is hostile.
const MOST_COMPARISONS: usize = 1 << 26;

/// Refuses shared bytes, and names in each block every accessor that declares its layout.
pub(super) fn check(document: &Document, blocks: &mut [Block]) -> Result<(), FormatError> {
    let positions_only = positions_only(document);
    let by_key: HashMap<BlockKey, usize> =
        blocks.iter().enumerate().map(|(block, it)| (it.key, block)).collect();
    let mut items = Vec::new();
    for (block, it) in blocks.iter().enumerate() {
        let claim = |span| Item { span, owner: Owner::Block(block), accessor: Some(it.accessor()) };
        items.extend(it.key.base.map(claim));
        items.extend(it.key.sparse.map(|sparse| claim(sparse.values)));
        let reads = |span| Item { span, owner: Owner::Other, accessor: Some(it.accessor()) };
        items.extend(it.key.sparse.map(|sparse| reads(sparse.indices)));
    }
    for (index, accessor) in document.accessors.iter().enumerate() {
        let Some(key) = declared(document, accessor) else { continue };
        let float3 = accessor.component_type == FLOAT && accessor.kind == "VEC3";
        let twin = by_key.get(&key).filter(|_| float3 && positions_only.get(index) == Some(&true));
        if let Some(block) = twin.and_then(|&block| blocks.get_mut(block)) {
            if block.accessor() != index {
                block.accessors.push(index);
            }
            continue;
        }
        let reads = |span| Item { span, owner: Owner::Other, accessor: Some(index) };
        items.extend(key.base.map(reads));
        items.extend(key.sparse.map(|sparse| reads(sparse.indices)));
        items.extend(key.sparse.map(|sparse| reads(sparse.values)));
    }
    for image in &document.images {
        let view = image.buffer_view.and_then(|index| document.buffer_views.get(index));
        items.extend(view.map(|view| Item {
            span: Span {
                buffer: view.buffer,
                start: view.byte_offset,
                stride: view.byte_length.max(1),
                size: view.byte_length,
                count: 1,
            },
            owner: Owner::Other,
            accessor: None,
        }));
    }
    sweep(items)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Block(usize),
    Other,
}

#[derive(Debug, Clone, Copy)]
struct Item {
    span: Span,
    owner: Owner,
    /// For the error; an image has none.
    accessor: Option<usize>,
}

/// Per accessor, whether it is used only as POSITION of primitives, or not at all.
fn positions_only(document: &Document) -> Vec<bool> {
    let mut only = vec![true; document.accessors.len()];
    let mut also = |index: usize| {
        if let Some(slot) = only.get_mut(index) {
            *slot = false;
        }
    };
    for primitive in document.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let attributes = primitive.attributes.iter().filter(|(name, _)| *name != "POSITION");
        attributes.for_each(|(_, &index)| also(index));
        primitive.indices.into_iter().for_each(&mut also);
        primitive.targets.iter().flat_map(|target| target.values()).for_each(|&index| also(index));
    }
    document.skins.iter().filter_map(|skin| skin.inverse_bind_matrices).for_each(&mut also);
    for sampler in document.animations.iter().flat_map(|animation| &animation.samplers) {
        also(sampler.input);
        also(sampler.output);
    }
    only
}

/// The layout of an accessor that need not be valid: sums saturate; `None` when it makes no sense.
fn declared(document: &Document, accessor: &Accessor) -> Option<BlockKey> {
    let size = element_bytes(accessor)?;
    let span = |view: usize, offset: usize, size: usize, count: usize| {
        let view = document.buffer_views.get(view)?;
        let start = view.byte_offset.saturating_add(offset);
        let stride = view.byte_stride.unwrap_or(size).max(1);
        Some(Span { buffer: view.buffer, start, stride, size, count })
    };
    let count = accessor.count;
    let base = accessor.buffer_view.and_then(|view| span(view, accessor.byte_offset, size, count));
    let sparse = accessor.sparse.as_ref().filter(|sparse| sparse.count > 0).and_then(|sparse| {
        let (indices, values) = (&sparse.indices, &sparse.values);
        let index_bytes = component_bytes(indices.component_type)?;
        Some(SparseSpans {
            indices: span(indices.buffer_view, indices.byte_offset, index_bytes, sparse.count)?,
            values: span(values.buffer_view, values.byte_offset, size, sparse.count)?,
        })
    });
    Some(BlockKey { count, base, sparse })
}

fn element_bytes(accessor: &Accessor) -> Option<usize> {
    let component = component_bytes(accessor.component_type)?;
    // Matrix columns start at multiples of four bytes.
    let column = |rows: usize| (rows * component).next_multiple_of(4);
    Some(match accessor.kind.as_str() {
        "SCALAR" => component,
        "VEC2" => 2 * component,
        "VEC3" => 3 * component,
        "VEC4" => 4 * component,
        "MAT2" => 2 * column(2),
        "MAT3" => 3 * column(3),
        "MAT4" => 4 * column(4),
        _ => return None,
    })
}

fn end(span: &Span) -> usize {
    let gaps = span.count.saturating_sub(1).saturating_mul(span.stride);
    span.start.saturating_add(gaps).saturating_add(span.size)
}

fn sweep(mut items: Vec<Item>) -> Result<(), FormatError> {
    items.sort_by_key(|item| (item.span.buffer, item.span.start));
    let (mut claims, mut others): (Vec<Item>, Vec<Item>) = (Vec::new(), Vec::new());
    let mut comparisons = 0_usize;
    for item in items {
        let live = |other: &Item| {
            other.span.buffer == item.span.buffer && end(&other.span) > item.span.start
        };
        let is_claim = item.owner != Owner::Other;
        comparisons = comparisons.saturating_add(claims.len());
        claims.retain(live);
        let mut rivals = claims.iter().find(|claim| share_bytes(&claim.span, &item.span));
        if is_claim && rivals.is_none() {
            comparisons = comparisons.saturating_add(others.len());
            others.retain(live);
            rivals = others.iter().find(|other| share_bytes(&other.span, &item.span));
        }
        if let Some(rival) = rivals {
            return Err(if is_claim { shared(&item, rival) } else { shared(rival, &item) });
        }
        if comparisons > MOST_COMPARISONS {
            return Err(FormatError::CannotPatch {
                path: "accessors".to_owned(),
                reason: "too many accessors overlap one another: export the asset again with \
                         separate data"
                    .to_owned(),
            });
        }
        if is_claim { claims.push(item) } else { others.push(item) }
    }
    Ok(())
}

fn shared(claim: &Item, rival: &Item) -> FormatError {
    let what = rival.accessor.map_or("an image".to_owned(), |index| format!("accessors[{index}]"));
    FormatError::CannotPatch {
        path: format!("accessors[{}]", claim.accessor.unwrap_or_default()),
        reason: format!(
            "its positions share bytes with {what}, which would change with them: export the \
             asset again with separate data for each"
        ),
    }
}

/// Whether two spans of one buffer have a byte in common. For different strides, `true` may be
/// wrong.
fn share_bytes(a: &Span, b: &Span) -> bool {
    if a.start >= end(b) || b.start >= end(a) {
        return false;
    }
    let solid = |span: &Span| span.count == 1 || span.stride == span.size;
    if solid(b) {
        return touches(a, b.start, end(b));
    }
    if solid(a) {
        return touches(b, a.start, end(a));
    }
    if a.stride != b.stride {
        return true;
    }
    let (low, high) = if a.start <= b.start { (a, b) } else { (b, a) };
    let distance = (high.start - low.start) % low.stride;
    distance < low.size || distance.saturating_add(high.size) > low.stride
}

/// Whether an element of `span` reaches into `from..to`.
fn touches(span: &Span, from: usize, to: usize) -> bool {
    let first_end = span.start.saturating_add(span.size);
    let element = if from < first_end { 0 } else { (from - first_end) / span.stride.max(1) + 1 };
    element < span.count && span.start.saturating_add(element.saturating_mul(span.stride)) < to
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn span(start: usize, stride: usize, size: usize, count: usize) -> Span {
        Span { buffer: 0, start, stride, size, count }
    }

    #[test]
    fn interleaved_is_fine_and_shared_is_not() {
        for (a, b, expected) in [
            (span(0, 24, 12, 9), span(12, 24, 12, 9), false),
            (span(12, 24, 12, 9), span(0, 24, 12, 9), false),
            (span(0, 24, 12, 9), span(8, 24, 12, 9), true),
            (span(0, 24, 12, 9), span(20, 24, 12, 9), true),
            (span(0, 12, 12, 9), span(108, 12, 12, 9), false),
            (span(0, 12, 12, 9), span(96, 12, 12, 9), true),
            (span(0, 24, 12, 9), span(12, 12, 12, 1), false),
            (span(0, 24, 12, 9), span(12, 13, 13, 1), true),
            (span(0, 24, 12, 9), span(500, 13, 13, 1), false),
            (span(0, 24, 12, 9), span(0, usize::MAX, 4, usize::MAX), true),
        ] {
            assert_eq!(share_bytes(&a, &b), expected, "{a:?} {b:?}");
            assert_eq!(share_bytes(&b, &a), expected, "{b:?} {a:?}");
        }
    }

    #[test]
    fn a_hundred_thousand_accessors_are_swept_quickly() {
        let items = (0..100_000_usize)
            .map(|i| Item {
                span: span(i * 12, 12, 12, if i % 2 == 0 { 1 } else { 1_000_000 }),
                owner: Owner::Other,
                accessor: Some(i),
            })
            .collect();
        assert_eq!(sweep(items), Ok(()));
        let interleaved = (0..100_000_usize)
            .map(|i| Item {
                span: span(i / 2 * 12 % 1200 + i % 2 * 1200, 2400, 12, 1_000),
                owner: if i % 2 == 0 { Owner::Block(i) } else { Owner::Other },
                accessor: Some(i),
            })
            .collect();
        assert!(sweep(interleaved).is_err());
    }

    proptest! {
        #[test]
        fn never_misses_a_shared_byte(
            a in (0_usize..40, 0_usize..9, 1_usize..9, 1_usize..6),
            b in (0_usize..40, 0_usize..9, 1_usize..9, 1_usize..6),
        ) {
            let bytes = |s: &Span| -> std::collections::HashSet<usize> {
                (0..s.count).flat_map(|i| s.offset(i)..s.offset(i) + s.size).collect()
            };
            let a = span(a.0, a.1 + a.2, a.2, a.3);
            let b = span(b.0, b.1 + b.2, b.2, b.3);
            let truth = !bytes(&a).is_disjoint(&bytes(&b));
            prop_assert!(share_bytes(&a, &b) || !truth);
            if a.stride == a.size || b.count == 1 {
                prop_assert_eq!(share_bytes(&a, &b), truth);
            }
        }
    }
}
