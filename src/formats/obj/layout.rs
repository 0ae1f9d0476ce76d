//! Patching: the host's bytes with the coordinates of moved vertices replaced, and nothing else
//! changed.

use glam::DVec3;
use rayon::prelude::*;

use super::super::{FormatError, Stop, Written, go_on};
use super::cursor::Cursor;
use super::number::coordinate;
use super::precision::Precision;
use crate::mesh::Mesh;
use crate::mesh::stop::STEP;

/// Vertices that one task writes.
const BLOCK: usize = 1 << 14;

/// Bytes that the text of a coordinate grows by, at most, in all meshes observed. Used to reserve
/// memory.
const USUAL_GROWTH: usize = 12;

/// Where the coordinates stand: four bytes per vertex. The tokens are read again while writing.
#[derive(Debug)]
pub(in crate::formats) struct Layout {
    /// Byte offset of each vertex's first coordinate.
    offsets: Vec<u32>,
    /// The fewest decimals of any coordinate.
    fewest_decimals: usize,
    diagonal: f64,
    host_bytes: usize,
}

/// The coordinates of one file with steps of one size.
#[derive(Debug, Clone, Copy)]
pub(in crate::formats) struct Stepped<'a> {
    layout: &'a Layout,
    precision: Precision,
}

impl Layout {
    /// `fewest_decimals` is the number of decimals that every coordinate of the host has at least.
    /// `None` once `stop` returns `true`.
    pub(super) fn new(
        mesh: &Mesh,
        offsets: Vec<u32>,
        fewest_decimals: Option<usize>,
        host_bytes: usize,
        stop: Stop<'_>,
    ) -> Option<Self> {
        let fewest_decimals = fewest_decimals.unwrap_or(0);
        let diagonal = diagonal(mesh, stop)?;
        Some(Self { offsets, fewest_decimals, diagonal, host_bytes })
    }

    /// The layout with steps of `step` where the host's decimals give coarser ones. 0 means the
    /// finest steps that are of any use.
    pub(in crate::formats) fn with_step(&self, step: f64) -> Stepped<'_> {
        let precision = Precision::choose(self.fewest_decimals, step, self.diagonal);
        Stepped { layout: self, precision }
    }

    /// Whether steps of `step` are coarser than the finest that are of any use.
    pub(in crate::formats) fn is_coarse(&self, step: f64) -> bool {
        self.with_step(step).precision != self.with_step(0.0).precision
    }

    fn offset(&self, vertex: usize) -> Option<usize> {
        self.offsets.get(vertex).and_then(|&offset| usize::try_from(offset).ok())
    }
}

impl Stepped<'_> {
    /// Replaces every coordinate that differs from the host's by what its text will read back as.
    /// Meaningless once `stop` returns `true`.
    pub(in crate::formats) fn round(&self, host: &Mesh, positions: &mut [DVec3], stop: Stop<'_>) {
        positions.par_chunks_mut(BLOCK).zip(host.positions().par_chunks(BLOCK)).for_each(
            |(positions, hosts)| {
                if stop() {
                    return;
                }
                for (position, host) in positions.iter_mut().zip(hosts) {
                    for axis in 0..3 {
                        position[axis] = self.round_coordinate(host[axis], position[axis]);
                    }
                }
            },
        );
    }

    fn round_coordinate(&self, host: f64, moved: f64) -> f64 {
        if host.to_bits() == moved.to_bits() { host } else { self.precision.of(host).round(moved) }
    }

    /// The host's bytes with the coordinates that differ from the host's replaced, and how many of them
    /// have more decimals than in the host.
    ///
    /// # Errors
    /// [`FormatError::ReadBack`] when `bytes` or `positions` do not belong to this layout, or a
    /// position is not finite; [`FormatError::Cancelled`] once `stop` returns `true`.
    pub(in crate::formats) fn write(
        &self,
        bytes: &[u8],
        host: &Mesh,
        positions: &[DVec3],
        stop: Stop<'_>,
    ) -> Result<Written, FormatError> {
        let vertices = self.layout.offsets.len();
        if bytes.len() != self.layout.host_bytes || host.positions().len() != vertices {
            return Err(foreign_host());
        }
        if positions.len() != vertices {
            let found = positions.len();
            return Err(read_back(format!("{found} positions for {vertices} vertices")));
        }
        let blocks = vertices.div_ceil(BLOCK);
        let pieces = (0..blocks)
            .into_par_iter()
            .map(|block| {
                go_on(stop)?;
                self.write_block(bytes, host.positions(), positions, block)
            })
            .collect::<Vec<Result<Written, FormatError>>>();
        let pieces = pieces.into_iter().collect::<Result<Vec<Written>, FormatError>>()?;
        let mut out = Vec::with_capacity(pieces.iter().map(|piece| piece.bytes.len()).sum());
        let more_decimals = pieces.iter().map(|piece| piece.more_decimals).sum();
        for piece in pieces {
            go_on(stop)?;
            out.extend(piece.bytes);
        }
        Ok(Written { bytes: out, more_decimals })
    }

    /// The bytes from the first coordinate of a block's first vertex up to that of the next
    /// block's. The first block begins with the file, and the last one ends with it.
    fn write_block(
        &self,
        bytes: &[u8],
        hosts: &[DVec3],
        positions: &[DVec3],
        block: usize,
    ) -> Result<Written, FormatError> {
        let first = block * BLOCK;
        let last = (first + BLOCK).min(positions.len());
        let mut copied = if block == 0 { 0 } else { self.layout.offset(first).unwrap_or(0) };
        let end = self.layout.offset(last).unwrap_or(bytes.len());
        let room = end.saturating_sub(copied) + 3 * USUAL_GROWTH * (last - first);
        let mut out = Vec::with_capacity(room);
        let mut more_decimals = 0;
        for vertex in first..last {
            let (Some(host), Some(moved), Some(offset)) =
                (hosts.get(vertex), positions.get(vertex), self.layout.offset(vertex))
            else {
                return Err(foreign_host());
            };
            if bits(*host) == bits(*moved) {
                continue;
            }
            if !moved.is_finite() {
                return Err(read_back(format!("vertex {vertex} moved to infinity or NaN")));
            }
            let mut cursor = Cursor::new(bytes, offset);
            for axis in 0..3 {
                let token = coordinate(&mut cursor).map_err(|_| foreign_host())?;
                if token.value.to_bits() != host[axis].to_bits() {
                    return Err(foreign_host());
                }
                let rounded = self.round_coordinate(host[axis], moved[axis]);
                // A coordinate that rounds to the host's value keeps the host's spelling.
                if rounded.to_bits() == host[axis].to_bits() {
                    continue;
                }
                out.extend_from_slice(bytes.get(copied..token.start).ok_or_else(foreign_host)?);
                let start = out.len();
                self.precision.of(host[axis]).spell(moved[axis], &mut out);
                let spelled = out.get(start..).unwrap_or_default();
                more_decimals += u64::from(decimals(spelled) > token.decimals);
                copied = cursor.offset();
            }
        }
        out.extend_from_slice(bytes.get(copied..end).ok_or_else(foreign_host)?);
        Ok(Written { bytes: out, more_decimals })
    }
}

/// Digits after the point of a text in fixed point.
fn decimals(text: &[u8]) -> usize {
    text.iter().position(|&byte| byte == b'.').map_or(0, |point| text.len() - point - 1)
}

fn bits(position: DVec3) -> [u64; 3] {
    position.to_array().map(f64::to_bits)
}

fn foreign_host() -> FormatError {
    read_back("these are not the bytes that the positions were read from".into())
}

fn read_back(reason: String) -> FormatError {
    FormatError::ReadBack { reason }
}

/// The diagonal of the bounding box of the surface. Loose vertices do not count: far away, they
/// would make the steps coarser. `None` once `stop` returns `true`.
fn diagonal(mesh: &Mesh, stop: Stop<'_>) -> Option<f64> {
    let positions = mesh.positions();
    let empty = || (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let grow = |(low, high): (DVec3, DVec3), (other_low, other_high): (DVec3, DVec3)| {
        (low.min(other_low), high.max(other_high))
    };
    let (mut low, mut high) = empty();
    for step in mesh.triangles().chunks(STEP) {
        if stop() {
            return None;
        }
        let bounds = step
            .par_iter()
            .flat_map_iter(|corners| corners.iter().copied())
            .filter_map(|corner| positions.get(usize::try_from(corner).ok()?))
            .fold(empty, |bounds, &position| grow(bounds, (position, position)))
            .reduce(empty, grow);
        (low, high) = grow((low, high), bounds);
    }
    Some((high - low).length())
}
