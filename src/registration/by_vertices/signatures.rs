//! Vertex signatures: numbers that a vertex keeps when the mesh around it is cropped, moved,
//! rotated, scaled or renumbered, and that few other vertices have.
//!
//! A *connectivity* signature is made of the valences around the vertex in their cyclic order, ring
//! by ring. It is the refinement of Weisfeiler and Lehman, with the order that a surface gives its
//! neighbours. It uses no coordinates, so a mark, noise, smoothing and quantisation do not change
//! it. On scanned or simplified meshes a valence is worth 1.5 to 2 bits, and two rings have 18 of
//! them; on a regular grid a valence is worth nothing. A *metric* signature is made of the lengths
//! of the edges around the vertex relative to their sum. It distinguishes the vertices of a grid,
//! but does not survive noise.
//!
//! Sketches store signatures, so their meaning is fixed: any change here needs a new version of the
//! sketch.

use glam::DVec3;

use super::one_rings::{MAX_VALENCE, NONE, Rings};
use crate::mesh::mixing::mixed;
use crate::mesh::stop::{Stop, counted, in_steps_of, mapped, unstopped};

/// The sense in which one-rings are read. A mirror image, or a file whose triangles were all
/// flipped, has the signatures of the other sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sense {
    /// In the sense of the triangles' winding.
    Along,
    /// Against it.
    Against,
}

/// The signature of one vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Signature {
    /// The hash; 0 where the vertex has no signature, because its neighbourhood is open.
    pub hash: u64,
    /// The position in the one-ring at which the reading began, or [`Signature::ANY`] when several
    /// positions read the same.
    pub begin: u8,
}

impl Signature {
    /// The neighbourhood has a symmetry: it reads the same from several neighbours.
    pub const ANY: u8 = u8::MAX;
}

/// Quantisation steps of a metric signature: a length is a share of the sum of the lengths around
/// its vertex, 12 of them around a regular vertex. Coordinates stored in 32 bits change a share by
/// about 2e-5 of itself. With 1024 steps, rounding therefore changes 1 in 40 signatures.
const STEPS: f64 = 1024.0;

/// Mixes `x` into the hash `h`. Never 0.
#[must_use]
pub fn mix(h: u64, x: u64) -> u64 {
    mixed(h ^ x).max(1)
}

/// The signature of a cyclic sequence: the same for every starting position.
fn cyclic(seed: u64, sequence: &[u64]) -> Signature {
    let read = |from: usize| {
        let (head, tail) = sequence.split_at(from);
        tail.iter().chain(head).fold(seed, |h, &x| mix(h, x))
    };
    let Some(least) = sequence.iter().min() else { return Signature::default() };
    let begins = sequence.iter().enumerate().filter(|(_, x)| *x == least).map(|(i, _)| i);
    let mut best = Signature::default();
    for begin in begins {
        let hash = read(begin);
        if best.hash == 0 || hash < best.hash {
            best = Signature { hash, begin: u8::try_from(begin).unwrap_or(Signature::ANY) };
        } else if hash == best.hash {
            best.begin = Signature::ANY;
        }
    }
    best
}

/// Vertices between two calls of `stop`. Where all neighbours look the same, as on a grid, a
/// signature takes a microsecond or more.
const LONG: usize = 1 << 14;

/// Reads the one-ring of each vertex, with `value` per dart. A value of 0 leaves the vertex without
/// a signature.
fn read_rings(
    rings: &Rings,
    sense: Sense,
    stop: Stop<'_>,
    value: impl Fn(u32, usize) -> u64 + Sync,
) -> Option<Vec<Signature>> {
    in_steps_of(LONG, rings.vertices(), stop, |vertex| {
        let vertex = u32::try_from(vertex).unwrap_or(NONE);
        let darts = rings.darts(vertex);
        let mut values = [0; MAX_VALENCE];
        let values = &mut values[..darts.len()];
        for (place, dart) in values.iter_mut().zip(darts) {
            *place = value(vertex, dart);
        }
        if values.is_empty() || values.contains(&0) {
            return Signature::default();
        }
        if sense == Sense::Against {
            values.reverse();
        }
        let mut code = cyclic(values.len() as u64, values);
        if sense == Sense::Against && code.begin != Signature::ANY {
            let last = u8::try_from(values.len()).unwrap_or(1) - 1;
            code.begin = last - code.begin;
        }
        code
    })
}

/// Connectivity signatures of all vertices, from the valences up to `radius` rings away. `radius`
/// is at least 1.
#[must_use]
pub fn connectivity(rings: &Rings, sense: Sense, radius: usize) -> Vec<Signature> {
    unstopped(|stop| connectivity_until(rings, sense, radius, stop))
}

/// Like [`connectivity`]; `None` once `stop` returns `true`.
#[must_use]
pub fn connectivity_until(
    rings: &Rings,
    sense: Sense,
    radius: usize,
    stop: Stop<'_>,
) -> Option<Vec<Signature>> {
    let mut seen = mapped(rings.heads(), stop, |_, &head| match rings.ring(head).len() {
        0 => 0,
        n => mix(1, n as u64),
    })?;
    for _ in 1..radius {
        seen = farther(rings, sense, &seen, stop)?;
    }
    read_rings(rings, sense, stop, |_, dart| seen[dart])
}

/// Per dart, a hash of the valences behind its head, one ring farther than in `seen`.
fn farther(rings: &Rings, sense: Sense, seen: &[u64], stop: Stop<'_>) -> Option<Vec<u64>> {
    mapped(rings.heads(), stop, |dart, &head| {
        let back = rings.backs()[dart];
        if back == NONE {
            return 0;
        }
        let darts = rings.darts(head);
        let ring = &seen[darts.clone()];
        let (before, after) = ring.split_at(back as usize - darts.start);
        let after = &after[1..];
        let fold = |h: u64, &x: &u64| if h == 0 || x == 0 { 0 } else { mix(h, x) };
        let valence = ring.len() as u64;
        match sense {
            Sense::Along => after.iter().chain(before).fold(valence, fold),
            Sense::Against => before.iter().rev().chain(after.iter().rev()).fold(valence, fold),
        }
    })
}

/// Metric signatures of all vertices, from the lengths of the spokes and of the rim around each.
#[must_use]
pub fn metric(rings: &Rings, positions: &[DVec3], sense: Sense) -> Vec<Signature> {
    unstopped(|stop| metric_until(rings, positions, sense, stop))
}

/// Like [`metric`]; `None` once `stop` returns `true`.
#[must_use]
pub fn metric_until(
    rings: &Rings,
    positions: &[DVec3],
    sense: Sense,
    stop: Stop<'_>,
) -> Option<Vec<Signature>> {
    let at = |v: u32| positions[v as usize];
    let around = counted(rings.vertices(), stop, |v| {
        let v = u32::try_from(v).unwrap_or(NONE);
        let ring = rings.ring(v);
        let spokes: f64 = ring.iter().map(|&u| at(u).distance(at(v))).sum();
        let next = ring.iter().cycle().skip(1);
        spokes + ring.iter().zip(next).map(|(&u, &w)| at(u).distance(at(w))).sum::<f64>()
    })?;
    read_rings(rings, sense, stop, |v, dart| {
        let darts = rings.darts(v);
        let next = if dart + 1 == darts.end { darts.start } else { dart + 1 };
        let before = if dart == darts.start { darts.end - 1 } else { dart - 1 };
        let head = at(rings.heads()[dart]);
        let share = |length: f64| step(STEPS * length / around[v as usize]);
        let [left, right] = [next, before].map(|d| share(at(rings.heads()[d]).distance(head)));
        // Each rim edge is read once with each of its ends, so that both senses read the same.
        let (first, second) = if sense == Sense::Along { (left, right) } else { (right, left) };
        mix(mix(mix(2, share(head.distance(at(v)))), first), second)
    })
}

/// The nearest whole number; shares are below 1, and NaN becomes 0.
fn step(x: f64) -> u64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of a sum of lengths: from 0 to STEPS, or NaN, which becomes 0"
    )]
    let step = x.round() as u64;
    step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;

    fn blob() -> Surface {
        Surface::new(&Sample::Blob.mesh(1500).unwrap())
    }

    fn reversed(triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
        triangles.iter().map(|&[a, b, c]| [c, b, a]).collect()
    }

    #[test]
    fn a_cyclic_sequence_may_begin_anywhere() {
        let sequence = [5, 2, 9, 2, 7, 1];
        let codes: Vec<Signature> = (0..6)
            .map(|turn| {
                let mut turned = sequence;
                turned.rotate_left(turn);
                cyclic(3, &turned)
            })
            .collect();
        assert!(codes.iter().all(|code| code.hash == codes[0].hash));
        assert_eq!(codes.iter().map(|code| code.begin).collect::<Vec<_>>(), [5, 4, 3, 2, 1, 0]);
        assert_ne!(cyclic(3, &[5, 2, 9, 2, 1, 7]).hash, codes[0].hash);
        assert_eq!(cyclic(3, &[4, 8, 4, 8]).begin, Signature::ANY);
    }

    #[test]
    fn the_other_sense_reads_the_mirror_image() {
        let surface = blob();
        let n = surface.positions.len();
        let rings = Rings::new(n, &surface.triangles);
        let mirrored = Rings::new(n, &reversed(&surface.triangles));
        let hashes = |codes: Vec<Signature>| codes.into_iter().map(|c| c.hash).collect::<Vec<_>>();
        for radius in 1..4 {
            let there = hashes(connectivity(&rings, Sense::Along, radius));
            assert_eq!(there, hashes(connectivity(&mirrored, Sense::Against, radius)));
        }
        let there = metric(&rings, &surface.positions, Sense::Along);
        let back = metric(&mirrored, &surface.positions, Sense::Against);
        assert_eq!(hashes(there.clone()), hashes(back.clone()));
        // And both begin at the same neighbour.
        for (v, (a, b)) in (0..).zip(there.iter().zip(&back)) {
            if a.begin != Signature::ANY {
                assert_eq!(rings.ring(v)[a.begin as usize], mirrored.ring(v)[b.begin as usize]);
            }
        }
    }

    #[test]
    fn metric_codes_survive_a_similarity_and_tell_vertices_apart() {
        let surface = blob();
        let rings = Rings::new(surface.positions.len(), &surface.triangles);
        let here = metric(&rings, &surface.positions, Sense::Along);
        let moved: Vec<DVec3> = surface.positions.iter().map(|&p| awkward(7.0).apply(p)).collect();
        let there = metric(&rings, &moved, Sense::Along);
        let same = here.iter().zip(&there).filter(|(a, b)| a == b).count();
        assert!(same * 100 > here.len() * 99, "{same} of {}", here.len());
        let mut hashes: Vec<u64> = here.iter().map(|code| code.hash).collect();
        hashes.sort_unstable();
        hashes.dedup();
        assert!(hashes.len() * 10 > here.len() * 9, "{} of {}", hashes.len(), here.len());
    }

    #[test]
    fn an_open_neighbourhood_has_no_code() {
        let surface = blob();
        let n = surface.positions.len();
        let whole = connectivity(&Rings::new(n, &surface.triangles), Sense::Along, 2);
        let rings = Rings::new(n, &surface.triangles[..surface.triangles.len() / 2]);
        let part = connectivity(&rings, Sense::Along, 2);
        let kept = part.iter().filter(|code| code.hash != 0).count();
        assert!(kept > n / 4 && kept < n / 2, "{kept} of {n}");
        assert!(part.iter().zip(&whole).all(|(a, b)| a.hash == 0 || a == b));
    }
}
