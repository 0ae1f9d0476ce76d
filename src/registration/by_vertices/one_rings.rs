//! The one-ring of each vertex: its neighbours in the order in which its triangles turn around it.

use rayon::prelude::*;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::stop::{Stop, go_on, unstopped};

/// Vertices with more neighbours count as open. In real meshes, no vertex with a distinctive
/// signature has more than 20. The limit keeps the work below 32 steps per triangle corner on any
/// upload, such as a fan of a million triangles around one vertex.
pub const MAX_VALENCE: usize = 32;

/// No dart.
pub const NONE: u32 = u32::MAX;

/// Vertices per task.
const BLOCK: usize = 4096;

/// One-rings of all vertices in one flat array. An entry is a *dart*: the step from the ring's
/// vertex to that neighbour. A vertex is *open*, and its ring empty, if its triangles do not close
/// around it exactly once: at a border, where the surface is not a manifold, or where windings
/// contradict each other.
#[derive(Debug, Clone)]
pub struct Rings {
    starts: Vec<u32>,
    heads: Vec<u32>,
    /// Per dart the dart back, or [`NONE`] where the neighbour is open.
    backs: Vec<u32>,
}

impl Rings {
    /// Collects the rings of all vertices.
    ///
    /// Indices in `triangles` are below `vertices`, and three times the number of triangles fits in
    /// a `u32`.
    #[must_use]
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        unstopped(|stop| Self::new_until(vertices, triangles, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(vertices: usize, triangles: &[[u32; 3]], stop: Stop<'_>) -> Option<Self> {
        let around = Adjacency::new_until(vertices, triangles, stop)?;
        let blocks: Vec<(Vec<u32>, Vec<u32>)> = (0..vertices.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let (mut lengths, mut heads) = (Vec::with_capacity(BLOCK), Vec::new());
                if stop() {
                    return (lengths, heads);
                }
                for vertex in block * BLOCK..((block + 1) * BLOCK).min(vertices) {
                    lengths.push(walk(vertex, around.around(vertex), triangles, &mut heads));
                }
                (lengths, heads)
            })
            .collect();
        go_on(stop)?;
        let mut starts = Vec::with_capacity(vertices + 1);
        let mut heads = Vec::with_capacity(triangles.len() * 3);
        let mut start = 0;
        starts.push(start);
        for (lengths, part) in blocks {
            for length in lengths {
                start += length;
                starts.push(start);
            }
            heads.extend_from_slice(&part);
            go_on(stop)?;
        }
        let mut rings = Self { starts, heads, backs: Vec::new() };
        rings.backs = rings.find_backs(stop)?;
        Some(rings)
    }

    fn find_backs(&self, stop: Stop<'_>) -> Option<Vec<u32>> {
        let back = |(vertex, &head): (u32, &u32)| {
            let place = self.ring(head).iter().position(|&u| u == vertex);
            let place = place.and_then(|place| u32::try_from(place).ok());
            place.map_or(NONE, |place| self.starts[head as usize] + place)
        };
        let count = u32::try_from(self.starts.len() - 1).unwrap_or(NONE);
        let starts: Vec<u32> = (0..count).step_by(BLOCK).collect();
        let block = |&start: &u32| -> Vec<u32> {
            let vertices = (start..count).take(if stop() { 0 } else { BLOCK });
            vertices
                .flat_map(|v| self.ring(v).iter().map(move |head| (v, head)))
                .map(back)
                .collect()
        };
        let blocks: Vec<Vec<u32>> = starts.par_iter().map(block).collect();
        let mut backs = Vec::with_capacity(self.heads.len());
        for part in blocks {
            go_on(stop)?;
            backs.extend_from_slice(&part);
        }
        Some(backs)
    }

    /// The neighbours of `vertex`, in the sense of its triangles' winding; empty if the vertex is
    /// open.
    #[must_use]
    pub fn ring(&self, vertex: u32) -> &[u32] {
        &self.heads[self.darts(vertex)]
    }

    /// The darts that leave `vertex`.
    #[must_use]
    pub fn darts(&self, vertex: u32) -> std::ops::Range<usize> {
        let vertex = vertex as usize;
        self.starts[vertex] as usize..self.starts[vertex + 1] as usize
    }

    /// Per dart the neighbour that it leads to.
    #[must_use]
    pub fn heads(&self) -> &[u32] {
        &self.heads
    }

    /// Per dart the dart back, or [`NONE`].
    #[must_use]
    pub fn backs(&self) -> &[u32] {
        &self.backs
    }

    /// How many vertices there are, open or not.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Appends the ring of `vertex` to `heads` and returns its length: 0 if it is open.
fn walk(vertex: usize, around: &[u32], triangles: &[[u32; 3]], heads: &mut Vec<u32>) -> u32 {
    if !(3..=MAX_VALENCE).contains(&around.len()) {
        return 0;
    }
    let mut sides = [[NONE; 2]; MAX_VALENCE];
    for (side, &t) in sides.iter_mut().zip(around) {
        let [a, b, c] = triangles[t as usize];
        *side = if a as usize == vertex {
            [b, c]
        } else if b as usize == vertex {
            [c, a]
        } else {
            [a, b]
        };
    }
    let sides = &sides[..around.len()];
    let begin = heads.len();
    let [first, mut next] = sides[0];
    heads.push(first);
    while next != first {
        let step = sides.iter().find(|side| side[0] == next);
        match step {
            Some(&[_, after]) if heads.len() - begin < sides.len() => {
                heads.push(next);
                next = after;
            }
            _ => {
                heads.truncate(begin);
                return 0;
            }
        }
    }
    if heads.len() - begin < sides.len() {
        heads.truncate(begin);
        return 0;
    }
    u32::try_from(around.len()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four triangles around vertex 0, not in order.
    const FAN: [[u32; 3]; 4] = [[0, 1, 2], [4, 0, 3], [0, 4, 1], [2, 3, 0]];

    #[test]
    fn a_closed_fan_is_walked_in_the_sense_of_its_triangles() {
        let rings = Rings::new(5, &FAN);
        assert_eq!(rings.ring(0), &[1, 2, 3, 4]);
        assert!((1..5).all(|v| rings.ring(v).is_empty()));
        assert_eq!(rings.backs(), &[NONE; 4]);
    }

    #[test]
    fn darts_lead_back_on_a_closed_surface() {
        let tetrahedron = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
        let rings = Rings::new(4, &tetrahedron);
        for v in 0..4 {
            for dart in rings.darts(v) {
                let back = rings.backs()[dart] as usize;
                assert!(rings.darts(rings.heads()[dart]).contains(&back));
                assert_eq!(rings.heads()[back], v);
            }
        }
    }

    #[test]
    fn borders_contradictions_repetitions_and_huge_fans_are_open() {
        let border = &FAN[..3];
        let contradiction = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 4, 3]];
        let twice = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2], [0, 2, 3], [0, 3, 1]];
        let two_fans = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 4, 5], [0, 5, 6], [0, 6, 4]];
        for triangles in [border, &contradiction, &twice, &two_fans] {
            assert!(Rings::new(7, triangles).ring(0).is_empty(), "{triangles:?}");
        }
        let huge: Vec<[u32; 3]> = (1..=200).map(|i| [0, i, i % 200 + 1]).collect();
        assert!(Rings::new(201, &huge).ring(0).is_empty());
    }
}
