//! The geometry of a host, stored for detectors that compare a suspect with it.
//!
//! It has a container of its own, because every position must come back to the last bit. The
//! container holds the magic `QMG1`, the number of vertices and of triangles (u32, little endian),
//! then one zstd frame. The frame holds the positions (f64) and the corners (u32), little endian
//! and byte-shuffled: all first bytes, all second bytes, and so on. zstd compresses shuffled bytes
//! far better than interleaved floats. Pure; must not know where the bytes are kept. The decoder
//! treats the bytes as hostile: a backup can be damaged.

use std::io::{Read, Write};

use glam::DVec3;
use sha2::{Digest, Sha256};

use crate::mesh::stop::{STEP, Stop, counted, go_on, never, unstopped};
use crate::mesh::{Mesh, MeshError};

const MAGIC: &[u8; 4] = b"QMG1";
const HEADER_BYTES: usize = 12;
const KEY_LABEL: &[u8] = b"quadmark/1/geometry";
/// Vertices or triangles that are hashed at once.
const KEY_STEP: usize = 4096;
/// Bytes that are compressed, or read, between two queries of `stop`.
const PART: usize = 1 << 20;
/// Fast, and within a few per cent of the best level on shuffled floats.
const ZSTD_LEVEL: i32 = 3;

/// Why stored geometry cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum GeometryError {
    /// The bytes are not this container, or are cut off.
    #[error("stored geometry is damaged: {0}")]
    Damaged(&'static str),
    /// There are more vertices or triangles than the limits allow.
    #[error("stored geometry has more vertices or triangles than the limits allow")]
    TooLarge,
    /// The caller stopped the work.
    #[error("given up")]
    Stopped,
    /// zstd failed.
    #[error("stored geometry cannot be compressed or decompressed: {0}")]
    Zstd(#[from] std::io::Error),
    /// The numbers are not a mesh.
    #[error("stored geometry is damaged: {0}")]
    Mesh(#[from] MeshError),
}

/// The key under which a geometry is stored: a hash of its positions, to the last bit, and of its
/// triangles, both in order. Two files with the same geometry are one host, whatever their format.
/// The order counts because suspects are also compared vertex by vertex in file order.
#[must_use]
pub fn key(mesh: &Mesh) -> [u8; 32] {
    unstopped(|stop| key_until(mesh, stop))
}

/// The same; `None` once `stop` answers `true`.
#[must_use]
pub fn key_until(mesh: &Mesh, stop: Stop<'_>) -> Option<[u8; 32]> {
    let mut hash = Sha256::new();
    hash.update(KEY_LABEL);
    hash.update((mesh.positions().len() as u64).to_le_bytes());
    hash.update((mesh.triangles().len() as u64).to_le_bytes());
    let mut part = Vec::with_capacity(KEY_STEP * 24);
    for positions in mesh.positions().chunks(KEY_STEP) {
        go_on(stop)?;
        part.clear();
        part.extend(positions.iter().flat_map(DVec3::to_array).flat_map(f64::to_le_bytes));
        hash.update(&part);
    }
    for triangles in mesh.triangles().chunks(KEY_STEP) {
        go_on(stop)?;
        part.clear();
        part.extend(triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes()));
        hash.update(&part);
    }
    Some(hash.finalize().into())
}

/// Packs a mesh.
///
/// # Errors
/// [`GeometryError::Zstd`]; not expected.
pub fn pack(mesh: &Mesh) -> Result<Vec<u8>, GeometryError> {
    pack_until(mesh, &never)
}

/// The same, as long as `stop` answers `false`.
///
/// # Errors
/// Also [`GeometryError::Stopped`].
pub fn pack_until(mesh: &Mesh, stop: Stop<'_>) -> Result<Vec<u8>, GeometryError> {
    let heard = || go_on(stop).ok_or(GeometryError::Stopped);
    let (positions, triangles) = (mesh.positions(), mesh.triangles());
    let vertices = u32::try_from(positions.len()).map_err(|_| GeometryError::TooLarge)?;
    let faces = u32::try_from(triangles.len()).map_err(|_| GeometryError::TooLarge)?;
    let mut plain = vec![0; positions.len() * 24 + triangles.len() * 12];
    let (floats, corners) = plain.split_at_mut(positions.len() * 24);
    for (step, part) in positions.chunks(STEP).enumerate() {
        heard()?;
        let numbers = part.iter().flat_map(DVec3::to_array).map(f64::to_le_bytes);
        shuffle(floats, 3 * STEP * step, numbers);
    }
    for (step, part) in triangles.chunks(STEP).enumerate() {
        heard()?;
        let numbers = part.iter().flatten().map(|corner| corner.to_le_bytes());
        shuffle(corners, 3 * STEP * step, numbers);
    }
    let mut packed = Vec::with_capacity(HEADER_BYTES + plain.len() / 2);
    packed.extend_from_slice(MAGIC);
    packed.extend_from_slice(&vertices.to_le_bytes());
    packed.extend_from_slice(&faces.to_le_bytes());
    let mut encoder = zstd::stream::Encoder::new(packed, ZSTD_LEVEL)?;
    for part in plain.chunks(PART) {
        heard()?;
        encoder.write_all(part)?;
    }
    Ok(encoder.finish()?)
}

/// Unpacks a mesh of at most `max_vertices` and `max_triangles`.
///
/// # Errors
/// [`GeometryError`] for anything that [`pack`] did not write.
pub fn unpack(
    packed: &[u8],
    max_vertices: usize,
    max_triangles: usize,
) -> Result<Mesh, GeometryError> {
    unpack_until(packed, max_vertices, max_triangles, &never)
}

/// The same, as long as `stop` answers `false`.
///
/// # Errors
/// Also [`GeometryError::Stopped`].
pub fn unpack_until(
    packed: &[u8],
    max_vertices: usize,
    max_triangles: usize,
    stop: Stop<'_>,
) -> Result<Mesh, GeometryError> {
    let heard = || go_on(stop).ok_or(GeometryError::Stopped);
    let cut_off = GeometryError::Damaged("it is cut off");
    let (header, frame) = packed.split_at_checked(HEADER_BYTES).ok_or(cut_off)?;
    let (magic, counts) = header.split_at(MAGIC.len());
    if magic != MAGIC {
        return Err(GeometryError::Damaged("it does not begin with QMG1"));
    }
    let [vertices, faces] = [counts.first_chunk(), counts.last_chunk()].map(|bytes| {
        bytes.and_then(|bytes| usize::try_from(u32::from_le_bytes(*bytes)).ok()).unwrap_or(0)
    });
    if vertices > max_vertices || faces > max_triangles {
        return Err(GeometryError::TooLarge);
    }
    let float_bytes = vertices.checked_mul(24).ok_or(GeometryError::TooLarge)?;
    let corner_bytes = faces.checked_mul(12).ok_or(GeometryError::TooLarge)?;
    let length = float_bytes.checked_add(corner_bytes).ok_or(GeometryError::TooLarge)?;
    // The buffer grows with what the frame really holds. A header that promises gigabytes costs
    // nothing, and a frame that unpacks to more than its header says is stopped one byte later.
    let mut plain = Vec::new();
    let most = u64::try_from(length).map_err(|_| GeometryError::TooLarge)?.saturating_add(1);
    let mut decoder = zstd::stream::Decoder::new(frame)?.take(most);
    while decoder.by_ref().take(PART as u64).read_to_end(&mut plain)? > 0 {
        heard()?;
    }
    if plain.len() != length {
        return Err(GeometryError::Damaged("its length is not what its header says"));
    }
    let (floats, corners) = plain.split_at(float_bytes);
    let float = |index| f64::from_le_bytes(unshuffle(floats, vertices * 3, index));
    let corner = |index| u32::from_le_bytes(unshuffle(corners, faces * 3, index));
    let position = |v| DVec3::new(float(v * 3), float(v * 3 + 1), float(v * 3 + 2));
    let positions = counted(vertices, stop, position).ok_or(GeometryError::Stopped)?;
    let triangle = |t| [corner(t * 3), corner(t * 3 + 1), corner(t * 3 + 2)];
    let triangles = counted(faces, stop, triangle).ok_or(GeometryError::Stopped)?;
    Ok(Mesh::new(positions, triangles)?)
}

/// Writes byte `b` of number `i` to `b * count + i`. The numbers are those from `first` on.
fn shuffle<const N: usize>(plain: &mut [u8], first: usize, numbers: impl Iterator<Item = [u8; N]>) {
    let count = plain.len() / N;
    for (index, number) in (first..).zip(numbers) {
        for (byte, value) in number.into_iter().enumerate() {
            if let Some(place) = plain.get_mut(byte * count + index) {
                *place = value;
            }
        }
    }
}

fn unshuffle<const N: usize>(plain: &[u8], count: usize, index: usize) -> [u8; N] {
    std::array::from_fn(|byte| plain.get(byte * count + index).copied().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLENTY: usize = 50_000_000;

    fn triangle_with_awkward_floats() -> Mesh {
        let positions = vec![
            DVec3::new(-0.0, 0.1 + 0.2, f64::MIN_POSITIVE / 8.0),
            DVec3::new(f64::MAX, -1.0 / 3.0, 1e-300),
            DVec3::new(1.0, 2.0, f64::EPSILON),
            DVec3::new(7.0, 8.0, 9.0),
        ];
        Mesh::new(positions, vec![[0, 1, 2], [3, 2, 0]]).unwrap()
    }

    fn bits(mesh: &Mesh) -> Vec<u64> {
        mesh.positions().iter().flat_map(DVec3::to_array).map(f64::to_bits).collect()
    }

    #[test]
    fn every_bit_comes_back() {
        let mesh = triangle_with_awkward_floats();
        let again = unpack(&pack(&mesh).unwrap(), PLENTY, PLENTY).unwrap();
        assert_eq!(bits(&again), bits(&mesh));
        assert_eq!(again.triangles(), mesh.triangles());
    }

    #[test]
    fn a_key_stands_for_positions_and_triangles_in_order() {
        let mesh = triangle_with_awkward_floats();
        // Computed independently of this code, with Python's hashlib and struct.
        assert_eq!(
            hex::encode(key(&mesh)),
            "26ea24479bda1232aa688c3cacc33b9fe9be121a82b271f313e41b47e525dcf5"
        );
        assert_eq!(key(&mesh), key(&unpack(&pack(&mesh).unwrap(), PLENTY, PLENTY).unwrap()));
        let (positions, triangles) = (mesh.positions().to_vec(), mesh.triangles().to_vec());
        let mut swapped = positions.clone();
        swapped.swap(0, 1);
        let mut signed = positions.clone();
        signed[0].x = 0.0;
        let others = [
            (swapped, triangles.clone()),
            (signed, triangles.clone()),
            (positions.clone(), vec![[1, 2, 0], [3, 2, 0]]),
            (positions, vec![[3, 2, 0], [0, 1, 2]]),
        ];
        for (positions, triangles) in others {
            assert_ne!(key(&Mesh::new(positions, triangles).unwrap()), key(&mesh));
        }
    }

    #[test]
    fn every_prefix_is_refused() {
        let packed = pack(&triangle_with_awkward_floats()).unwrap();
        for length in 0..packed.len() {
            assert!(unpack(&packed[..length], PLENTY, PLENTY).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn no_changed_byte_panics() {
        let packed = pack(&triangle_with_awkward_floats()).unwrap();
        for place in 0..packed.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut damaged = packed.clone();
                damaged[place] = value;
                let _ = unpack(&damaged, PLENTY, PLENTY);
            }
        }
    }

    #[test]
    fn extra_bytes_counts_and_limits() {
        let mesh = triangle_with_awkward_floats();
        let packed = pack(&mesh).unwrap();
        let longer = [packed.as_slice(), b"extra"].concat();
        assert!(unpack(&longer, PLENTY, PLENTY).is_err());
        for (vertices, triangles) in [(3, 2), (4, 1)] {
            let refused = unpack(&packed, vertices, triangles);
            assert!(matches!(refused, Err(GeometryError::TooLarge)));
        }
        let mut promising = packed.clone();
        promising[4..8].copy_from_slice(&40_000_000_u32.to_le_bytes());
        assert!(unpack(&promising, PLENTY, PLENTY).is_err());
    }
}
