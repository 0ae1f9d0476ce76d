//! Which triangles meet at a vertex, in one flat array.

use super::stop::{STEP, Stop, go_on, unstopped};

/// Triangles around each carrier, ascending, as compressed rows.
#[derive(Debug, Clone)]
pub struct Adjacency {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Adjacency {
    /// Counts, then fills, in two passes and two allocations.
    ///
    /// Indices in `triangles` must be below `vertices`. Three times the number of triangles must fit in
    /// a `u32`.
    #[must_use]
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        unstopped(|stop| Self::new_until(vertices, triangles, stop))
    }

    /// As [`Self::new`]; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(vertices: usize, triangles: &[[u32; 3]], stop: Stop<'_>) -> Option<Self> {
        let mut starts = vec![0_u32; vertices + 1];
        for step in triangles.chunks(STEP) {
            go_on(stop)?;
            for &v in step.iter().flatten() {
                starts[v as usize + 1] += 1;
            }
        }
        for v in 0..vertices {
            starts[v + 1] += starts[v];
        }
        go_on(stop)?;
        let mut next = starts.clone();
        let mut around = vec![0_u32; triangles.len() * 3];
        let mut numbered = (0_u32..).zip(triangles);
        for _ in triangles.chunks(STEP) {
            go_on(stop)?;
            for (t, corners) in numbered.by_ref().take(STEP) {
                for &v in corners {
                    let slot = &mut next[v as usize];
                    around[*slot as usize] = t;
                    *slot += 1;
                }
            }
        }
        Some(Self { starts, triangles: around })
    }

    /// Indices of the triangles at `vertex`.
    #[must_use]
    pub fn around(&self, vertex: usize) -> &[u32] {
        &self.triangles[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_triangle_stands_at_its_three_corners() {
        let triangles = [[0, 1, 2], [2, 1, 3], [3, 1, 0]];
        let adjacency = Adjacency::new(5, &triangles);
        assert_eq!(adjacency.around(1), &[0, 1, 2]);
        assert_eq!(adjacency.around(3), &[1, 2]);
        assert!(adjacency.around(4).is_empty());
    }
}
