//! Welding: vertices with bit-identical positions are one point of the surface.
//!
//! UV and normal seams repeat positions. The copies must move together, or the surface cracks.

use glam::DVec3;

use super::stop::{STEP, Stop, go_on, sorted, unstopped};

/// Longest probe sequence before hashing is abandoned. At load 1/2 and with ordinary input, the
/// expected longest run for 10^8 points is below 60. An upload whose coordinates were chosen to collide
/// falls back to sorting, which no input can slow down.
const MAX_PROBES: usize = 256;

/// The empty slot of the hash table.
const EMPTY: u32 = u32::MAX;

/// Which vertices coincide. Points are numbered by first occurrence, so the numbering depends on
/// the file alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Weld {
    /// Per vertex, its point.
    pub point_of: Vec<u32>,
    /// Per point, the first vertex that has its position.
    pub first_vertex: Vec<u32>,
}

/// Bits of a position with `-0.0` made `0.0`, which is the same coordinate.
fn key(p: DVec3) -> [u64; 3] {
    [(p.x + 0.0).to_bits(), (p.y + 0.0).to_bits(), (p.z + 0.0).to_bits()]
}

/// Folds the 128-bit products of the key's words (the mixing step of wyhash).
fn hash(key: [u64; 3]) -> u64 {
    let fold = |a: u64, b: u64| {
        let product = u128::from(a) * u128::from(b);
        let bytes = product.to_le_bytes();
        let (mut low, mut high) = ([0; 8], [0; 8]);
        low.copy_from_slice(&bytes[..8]);
        high.copy_from_slice(&bytes[8..]);
        u64::from_le_bytes(low) ^ u64::from_le_bytes(high)
    };
    let a = fold(key[0] ^ 0xa076_1d64_78bd_642f, key[1] ^ 0xe703_7ed1_a0b4_28db);
    fold(a ^ key[2], 0x8ebc_6af0_9c88_c6e3 ^ key[0])
}

/// Welds vertices at bit-identical positions (`0.0` and `-0.0` are the same).
///
/// `positions`: at most `u32::MAX - 1` of them, finite.
#[must_use]
pub fn weld(positions: &[DVec3]) -> Weld {
    unstopped(|stop| weld_until(positions, stop))
}

/// As [`weld`]; `None` once `stop` answers `true`.
#[must_use]
pub fn weld_until(positions: &[DVec3], stop: Stop<'_>) -> Option<Weld> {
    match by_hash(positions, stop)? {
        Hashed::Welded(weld) => Some(weld),
        Hashed::Crowded => by_sort(positions, stop),
    }
}

/// The outcome of hashing.
#[derive(Debug, PartialEq)]
enum Hashed {
    Welded(Weld),
    /// Too many keys fell into one run of slots.
    Crowded,
}

fn by_hash(positions: &[DVec3], stop: Stop<'_>) -> Option<Hashed> {
    let capacity = (positions.len() * 2).next_power_of_two().max(16);
    let mask = capacity - 1;
    let mut table = vec![EMPTY; capacity];
    let mut weld = Weld { point_of: Vec::with_capacity(positions.len()), first_vertex: Vec::new() };
    let mut vertex = 0_u32;
    for step in positions.chunks(STEP) {
        go_on(stop)?;
        for &position in step {
            let this = key(position);
            // The high bits are better mixed. Truncation to usize only drops hash bits.
            let mut slot = usize::try_from(hash(this) >> 20).unwrap_or(0) & mask;
            let mut probes = 0;
            let point = loop {
                let point = table[slot];
                if point == EMPTY {
                    // There are no more points than vertices, of which there are fewer than 2^32.
                    let point = u32::try_from(weld.first_vertex.len()).unwrap_or(EMPTY);
                    table[slot] = point;
                    weld.first_vertex.push(vertex);
                    break point;
                }
                let first = weld.first_vertex[point as usize];
                if key(positions[first as usize]) == this {
                    break point;
                }
                probes += 1;
                if probes > MAX_PROBES {
                    return Some(Hashed::Crowded);
                }
                slot = (slot + 1) & mask;
            };
            weld.point_of.push(point);
            vertex += 1;
        }
    }
    Some(Hashed::Welded(weld))
}

fn by_sort(positions: &[DVec3], stop: Stop<'_>) -> Option<Weld> {
    let count = u32::try_from(positions.len()).unwrap_or(u32::MAX);
    let place = |v: u32| (key(positions[v as usize]), v);
    let order = sorted((0..count).collect(), stop, |&a, &b| place(a).cmp(&place(b)))?;
    let mut first_of = vec![0_u32; positions.len()];
    let (mut first, mut before) = (0, None);
    for step in order.chunks(STEP) {
        go_on(stop)?;
        for &vertex in step {
            let this = key(positions[vertex as usize]);
            if before != Some(this) {
                (first, before) = (vertex, Some(this));
            }
            first_of[vertex as usize] = first;
        }
    }
    let mut weld = Weld { point_of: vec![0; positions.len()], first_vertex: Vec::new() };
    for (vertex, &first) in first_of.iter().enumerate() {
        if vertex % STEP == 0 {
            go_on(stop)?;
        }
        let first = first as usize;
        if first == vertex {
            weld.point_of[vertex] = u32::try_from(weld.first_vertex.len()).unwrap_or(EMPTY);
            weld.first_vertex.push(u32::try_from(vertex).unwrap_or(EMPTY));
        } else {
            weld.point_of[vertex] = weld.point_of[first];
        }
    }
    Some(weld)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::stop::never;

    #[test]
    fn copies_of_a_position_are_one_point_and_signed_zeros_too() {
        let p = [
            DVec3::new(0.0, 1.0, 2.0),
            DVec3::new(3.0, 1.0, 2.0),
            DVec3::new(-0.0, 1.0, 2.0),
            DVec3::new(3.0, 1.0, 2.0),
            DVec3::new(3.0, 1.0, 2.000_000_000_000_000_4),
        ];
        let expected = Weld { point_of: vec![0, 1, 0, 1, 2], first_vertex: vec![0, 1, 4] };
        assert_eq!(weld(&p), expected);
        assert_eq!(by_sort(&p, &never), Some(expected));
    }

    #[test]
    fn sorting_and_hashing_agree() {
        let p: Vec<DVec3> = (0..5000_u32)
            .map(|i| {
                let k = f64::from(i.wrapping_mul(2_654_435_761) % 1700);
                DVec3::new((k * 0.37).sin(), (k * 1.1).cos(), k % 7.0)
            })
            .collect();
        let sorted = by_sort(&p, &never).unwrap();
        assert_eq!(by_hash(&p, &never), Some(Hashed::Welded(sorted)));
    }
}
