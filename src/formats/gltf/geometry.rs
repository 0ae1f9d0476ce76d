//! Positions and triangles out of checked spans.
//!
//! Everything that can be wrong with counts and offsets has been refused before; what remains
//! are values: coordinates that are not finite, indices out of range.

use glam::DVec3;
use rayon::prelude::*;

use super::accessors::{index_at, overridden};
use super::buffers::Buffers;
use super::carrier::{Block, BlockKey, Mode, Piece};
use super::malformed;
use crate::formats::{FormatError, Stop, go_on};

/// Indices that are read between two calls of `stop`: milliseconds.
const STRETCH: usize = 1 << 18;

/// The local coordinates of an element; zero when it has no bytes.
pub(super) fn local(block: &Block, buffers: &Buffers, element: usize) -> [f32; 3] {
    let bytes = block
        .locate(element)
        .and_then(|(buffer, at)| buffers.bytes(buffer).get(at..)?.first_chunk::<12>());
    let Some(&[a, b, c, d, e, f, g, h, i, j, k, l]) = bytes else { return [0.0; 3] };
    [[a, b, c, d], [e, f, g, h], [i, j, k, l]].map(f32::from_le_bytes)
}

/// All vertices in block order, world space.
pub(super) fn positions(
    blocks: &[Block],
    buffers: &Buffers,
    vertices: usize,
    stop: Stop<'_>,
) -> Result<Vec<DVec3>, FormatError> {
    let mut positions = vec![DVec3::ZERO; vertices];
    for block in blocks {
        go_on(stop)?;
        let range = block.first..block.first.saturating_add(block.key.count);
        let Some(slots) = positions.get_mut(range) else { continue };
        slots.par_iter_mut().enumerate().for_each(|(element, slot)| {
            *slot = block.transform.forward(local(block, buffers, element));
        });
        if let Some(element) = slots.iter().position(|position| !position.is_finite()) {
            let place = format!("accessors[{}], element {element}", block.accessor());
            return Err(FormatError::NonFiniteVertex { place });
        }
    }
    Ok(positions)
}

/// Vertices that have no bytes of their own.
pub(super) fn pinned(blocks: &[Block]) -> Result<Vec<u32>, FormatError> {
    let mut pinned = Vec::new();
    for block in blocks.iter().filter(|block| block.key.base.is_none()) {
        for element in (0..block.key.count).filter(|&element| block.locate(element).is_none()) {
            pinned.push(vertex(block, element)?);
        }
    }
    Ok(pinned)
}

fn vertex(block: &Block, element: usize) -> Result<u32, FormatError> {
    let limit = u64::from(u32::MAX);
    block
        .first
        .checked_add(element)
        .and_then(|vertex| u32::try_from(vertex).ok())
        .ok_or(FormatError::TooLarge { what: "vertices", count: limit.saturating_add(1), limit })
}

/// All triangles, strips and fans unrolled.
pub(super) fn triangles(
    pieces: &[Piece],
    blocks: &[Block],
    buffers: &Buffers,
    count: usize,
    stop: Stop<'_>,
) -> Result<Vec<[u32; 3]>, FormatError> {
    let mut triangles = Vec::with_capacity(count);
    let mut corners = Vec::new();
    for piece in pieces {
        let Some(block) = blocks.get(piece.block) else { continue };
        corners.clear();
        match &piece.indices {
            Some((accessor, key)) => {
                read_indices(*accessor, key, block, buffers, &mut corners, stop)?;
            }
            None => {
                for element in 0..block.key.count {
                    corners.push(vertex(block, element)?);
                }
            }
        }
        match piece.mode {
            Mode::List => {
                triangles.extend(corners.as_chunks::<3>().0);
            }
            // Every other triangle of a strip is wound the other way round.
            Mode::Strip => {
                let turned = |(i, corners): (usize, &[u32])| match *corners {
                    [a, b, c] if i % 2 == 0 => Some([a, b, c]),
                    [a, b, c] => Some([a, c, b]),
                    _ => None,
                };
                triangles.extend(corners.windows(3).enumerate().filter_map(turned));
            }
            Mode::Fan => {
                let Some((&hub, rim)) = corners.split_first() else { continue };
                triangles.extend(rim.windows(2).filter_map(|edge| match *edge {
                    [a, b] => Some([a, b, hub]),
                    _ => None,
                }));
            }
        }
    }
    Ok(triangles)
}

/// Appends the vertices that an index accessor names.
fn read_indices(
    accessor: usize,
    key: &BlockKey,
    block: &Block,
    buffers: &Buffers,
    corners: &mut Vec<u32>,
    stop: Stop<'_>,
) -> Result<(), FormatError> {
    let named = |element: usize, index: u32| {
        usize::try_from(index)
            .ok()
            .filter(|&index| index < block.key.count)
            .ok_or_else(|| {
                malformed(
                    format!("accessors[{accessor}]"),
                    format!(
                        "element {element} is the index {index}, but accessors[{}] has {} elements",
                        block.accessor(),
                        block.key.count
                    ),
                )
            })
            .and_then(|index| vertex(block, index))
    };
    let overrides = match &key.sparse {
        Some(sparse) => overridden(buffers, accessor, key.count, &sparse.indices)?,
        None => Vec::new(),
    };
    let mut overrides = overrides.into_iter().enumerate().peekable();
    for element in 0..key.count {
        if element % STRETCH == 0 {
            go_on(stop)?;
        }
        let own = overrides.next_if(|&(_, at)| usize::try_from(at) == Ok(element));
        let source = match (own, &key.sparse) {
            (Some((k, _)), Some(sparse)) => Some((&sparse.values, k)),
            _ => key.base.as_ref().map(|base| (base, element)),
        };
        let index = source
            .and_then(|(span, at)| index_at(buffers.bytes(span.buffer), span, at))
            .unwrap_or_default();
        corners.push(named(element, index)?);
    }
    Ok(())
}
