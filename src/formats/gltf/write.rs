//! Writes new coordinates into the host's own bytes.
//!
//! The floats of moved vertices are replaced where they stand, in the BIN chunk or in the base64
//! text. So are the `min` and `max` of their accessors where an extreme changed. The JSON is never
//! re-serialised: new numbers are spliced into the original text.

use std::collections::BTreeSet;

use glam::DVec3;
use rayon::prelude::*;

use super::assemble::{Splice, assemble};
use super::buffers::Buffers;
use super::carrier::Block;
use super::container;
use super::document::{self, Document};
use super::geometry::local;
use super::transform::same;
use super::{Layout, data_uri, json_spans};
use crate::formats::{Format, FormatError, Stop, go_on};
use crate::mesh::Mesh;
use crate::mesh::stop::STEP;

/// The new smallest and largest value of each axis, where moving vertices changed it.
#[derive(Debug, Default)]
struct Changes {
    min: [Option<f32>; 3],
    max: [Option<f32>; 3],
}

pub(super) fn write(
    layout: &Layout,
    bytes: &[u8],
    host: &Mesh,
    positions: &[DVec3],
    stop: Stop<'_>,
) -> Result<Vec<u8>, FormatError> {
    if positions.len() != host.positions().len() {
        let (given, held) = (positions.len(), host.positions().len());
        return Err(read_back(format!("{given} positions were given for {held} vertices")));
    }
    let format = if layout.container.json_chunk.is_some() { Format::Glb } else { Format::Gltf };
    if bytes.len() != layout.file_bytes
        || container::split(bytes, format).ok().as_ref() != Some(&layout.container)
    {
        return Err(read_back("the bytes given are not those of the file that was read"));
    }
    // The document is parsed again rather than kept: it holds the base64 text of every embedded
    // buffer.
    let json = bytes.get(layout.container.json.clone()).unwrap_or_default();
    let document = document::parse(json)?;
    let mut buffers = Buffers::new(bytes, &layout.container, &document);
    let mut changed_buffers = BTreeSet::new();
    let mut changes = Vec::new();
    for block in &layout.blocks {
        for span in block.key.base.iter().chain(block.key.sparse.iter().map(|s| &s.values)) {
            buffers.load(&document, span.buffer)?;
        }
        changes.push(patch(block, &mut buffers, (host, positions), &mut changed_buffers, stop)?);
    }
    go_on(stop)?;
    if changed_buffers.is_empty() {
        return Ok(bytes.to_vec());
    }
    let mut splices = Vec::new();
    splice_bounds(layout, bytes, &changes, &mut splices);
    splice_uris(layout, bytes, &document, &buffers, &changed_buffers, &mut splices)?;
    splices.sort_by_key(|(span, _)| span.start);
    let embedded = document.buffers.first().is_some_and(|buffer| buffer.uri.is_none());
    let bin = (embedded && changed_buffers.contains(&0)).then(|| buffers.bytes(0));
    assemble(&layout.container, bytes, bin, &splices)
}

/// Writes the moved vertices of a block into its buffers; returns which extremes changed.
fn patch(
    block: &Block,
    buffers: &mut Buffers,
    (host, positions): (&Mesh, &[DVec3]),
    changed_buffers: &mut BTreeSet<usize>,
    stop: Stop<'_>,
) -> Result<Changes, FormatError> {
    let range = block.first..block.first.saturating_add(block.key.count);
    let (Some(hosts), Some(wanted)) = (host.positions().get(range.clone()), positions.get(range))
    else {
        return Err(read_back("the mesh given is not that of the file that was read"));
    };
    let read_only = &*buffers;
    let mut moves: Vec<Move> = Vec::with_capacity(hosts.len());
    for (hosts, wanted) in hosts.chunks(STEP).zip(wanted.chunks(STEP)) {
        go_on(stop)?;
        let first = moves.len();
        let step = hosts.par_iter().zip(wanted).enumerate().map(|(place, (&from, &to))| {
            let element = first + place;
            let old = local(block, read_only, element);
            if !same(block.transform.forward(old), from) {
                return Err(read_back("the bytes given are not those of the file that was read"));
            }
            let new = if same(from, to) { old } else { target(block, element, old, from, to)? };
            Ok(Move { old, new })
        });
        moves.extend(step.collect::<Result<Vec<Move>, _>>()?);
    }
    let mut moved = false;
    for (element, step) in moves.iter().enumerate() {
        if element % STEP == 0 {
            go_on(stop)?;
        }
        let Some((buffer, at)) = block.locate(element) else { continue };
        for (axis, (old, new)) in step.old.into_iter().zip(step.new).enumerate() {
            #[expect(clippy::float_cmp, reason = "a zero keeps its sign; all else is bit for bit")]
            if old == new {
                continue;
            }
            let at = at.saturating_add(axis * 4);
            let slot = buffers.bytes_mut(buffer).get_mut(at..).and_then(<[u8]>::first_chunk_mut);
            let slot: &mut [u8; 4] = slot.ok_or_else(|| read_back("an offset left its buffer"))?;
            *slot = new.to_le_bytes();
            changed_buffers.insert(buffer);
            moved = true;
        }
    }
    if moved { Changes::between(&moves, stop) } else { Ok(Changes::default()) }
}

/// Local coordinates of a vertex before and after.
struct Move {
    old: [f32; 3],
    new: [f32; 3],
}

fn target(
    block: &Block,
    element: usize,
    old: [f32; 3],
    from: DVec3,
    to: DVec3,
) -> Result<[f32; 3], FormatError> {
    let Some((new, settled)) = block.transform.settle(to) else {
        let vertex = block.first.saturating_add(element);
        return Err(read_back(format!("the new position of vertex {vertex} has no 32-bit form")));
    };
    if same(settled, from) {
        return Ok(old);
    }
    if block.locate(element).is_none() {
        let vertex = block.first.saturating_add(element);
        return Err(read_back(format!("vertex {vertex} is pinned and cannot move")));
    }
    Ok(new)
}

impl Changes {
    fn between(moves: &[Move], stop: Stop<'_>) -> Result<Self, FormatError> {
        let mut changes = Self::default();
        let bounds = |axis: usize, of: fn(&Move) -> &[f32; 3]| {
            moves
                .iter()
                .filter_map(|step| of(step).get(axis))
                .fold((f32::INFINITY, f32::NEG_INFINITY), |(min, max), &value| {
                    (min.min(value), max.max(value))
                })
        };
        for (axis, (min, max)) in changes.min.iter_mut().zip(&mut changes.max).enumerate() {
            let old = bounds(axis, |step| &step.old);
            go_on(stop)?;
            let new = bounds(axis, |step| &step.new);
            go_on(stop)?;
            #[expect(clippy::float_cmp, reason = "an extreme is one of the values themselves")]
            {
                *min = (old.0 != new.0).then_some(new.0);
                *max = (old.1 != new.1).then_some(new.1);
            }
        }
        Ok(changes)
    }
}

/// New numbers for the extremes that changed, where the host declares them as numbers.
fn splice_bounds(layout: &Layout, bytes: &[u8], changes: &[Changes], splices: &mut Vec<Splice>) {
    let text = bytes.get(..layout.container.json.end).unwrap_or_default();
    let root = json_spans::root(text, layout.container.json.clone());
    let entries = json_spans::member(text, root, "accessors")
        .and_then(|array| json_spans::elements(text, array))
        .unwrap_or_default();
    for (block, changes) in layout.blocks.iter().zip(changes) {
        for entry in block.accessors.iter().filter_map(|&index| entries.get(index)) {
            for (key, values) in [("min", &changes.min), ("max", &changes.max)] {
                let Some(spans) = json_spans::member(text, entry.clone(), key)
                    .and_then(|array| json_spans::elements(text, array))
                else {
                    continue;
                };
                for (span, value) in spans.into_iter().zip(values) {
                    let number =
                        text.get(span.start).is_some_and(|b| matches!(b, b'-' | b'0'..=b'9'));
                    if let (true, Some(value)) = (number, value) {
                        splices.push((span, f64::from(*value).to_string()));
                    }
                }
            }
        }
    }
}

/// New base64 text of the changed buffers that are data URIs.
fn splice_uris(
    layout: &Layout,
    bytes: &[u8],
    document: &Document,
    buffers: &Buffers,
    changed: &BTreeSet<usize>,
    splices: &mut Vec<Splice>,
) -> Result<(), FormatError> {
    let text = bytes.get(..layout.container.json.end).unwrap_or_default();
    let root = json_spans::root(text, layout.container.json.clone());
    let mut entries = None;
    for &index in changed {
        let Some(uri) = document.buffers.get(index).and_then(|b| b.uri.as_deref()) else {
            continue;
        };
        let entries = entries.get_or_insert_with(|| {
            json_spans::member(text, root.clone(), "buffers")
                .and_then(|array| json_spans::elements(text, array))
                .unwrap_or_default()
        });
        let span = entries
            .get(index)
            .and_then(|entry| json_spans::member(text, entry.clone(), "uri"))
            .ok_or_else(|| read_back(format!("buffers[{index}].uri was not found again")))?;
        let encoded = data_uri::parse(uri).map(|uri| uri.encode(buffers.bytes(index)));
        let json = encoded.and_then(|uri| serde_json::to_string(&uri).ok());
        let json = json.ok_or_else(|| read_back(format!("buffers[{index}].uri is no data URI")))?;
        splices.push((span, json));
    }
    Ok(())
}

pub(super) fn read_back(reason: impl Into<String>) -> FormatError {
    FormatError::ReadBack { reason: reason.into() }
}
