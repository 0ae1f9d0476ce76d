//! The edges of a triangle list, each once, with the triangles at each edge.

use crate::mesh::stop::{Stop, go_on, unstopped};

/// Number of vertices between two calls of `stop`.
const VERTICES: u32 = 1 << 15;

/// Stands for a triangle side that does not exist.
pub const NO_SIDE: usize = usize::MAX;

/// Edges, sorted by their corners.
pub struct Edges {
    /// The two corners, smaller index first.
    pub ends: Vec<[u32; 2]>,
    /// Number of triangles at the edge.
    pub count: Vec<usize>,
    /// The first two triangle sides at the edge. Side `3 t + k` runs from corner k of triangle t to
    /// the next corner.
    pub sides: Vec<[usize; 2]>,
    /// The edge of each side.
    pub of_side: Vec<usize>,
}

impl Edges {
    /// Collects the edges of `triangles`: a counting sort by the smaller corner, then a sort at
    /// each corner.
    pub fn new(triangles: &[[u32; 3]]) -> Self {
        unstopped(|stop| Self::new_until(triangles, stop))
    }

    /// As `new`; `None` once `stop` returns `true`.
    pub fn new_until(triangles: &[[u32; 3]], stop: Stop<'_>) -> Option<Self> {
        let mut sides = sides_by_smaller_corner(triangles, stop)?;
        let mut edges = Self {
            ends: Vec::with_capacity(sides.of.len() / 2),
            count: Vec::with_capacity(sides.of.len() / 2),
            sides: Vec::with_capacity(sides.of.len() / 2),
            of_side: vec![0; sides.of.len()],
        };
        for (vertex, bounds) in (0_u32..).zip(sides.starts.windows(2)) {
            if vertex.is_multiple_of(VERTICES) {
                go_on(stop)?;
            }
            let at = &mut sides.of[bounds[0]..bounds[1]];
            at.sort_unstable();
            for &mut (other, side) in at {
                edges.add([vertex, other], side);
            }
        }
        Some(edges)
    }

    fn add(&mut self, ends: [u32; 2], side: usize) {
        if self.ends.last() == Some(&ends) {
            let last = self.count.len() - 1;
            if self.count[last] == 1 {
                self.sides[last][1] = side;
            }
            self.count[last] += 1;
        } else {
            self.ends.push(ends);
            self.count.push(1);
            self.sides.push([side, NO_SIDE]);
        }
        self.of_side[side] = self.ends.len() - 1;
    }

    /// Edges with one triangle.
    pub fn borders(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.ends.iter().zip(&self.count).filter(|&(_, &count)| count == 1).map(|(&ends, _)| ends)
    }

    /// The two sides of an edge with exactly two triangles of the same orientation, whose sides run
    /// in opposite directions; else `None`.
    pub fn inner_sides(&self, edge: usize, triangles: &[[u32; 3]]) -> Option<[usize; 2]> {
        let sides = self.sides[edge];
        let starts = || sides.map(|side| corner(triangles, side));
        (self.count[edge] == 2 && starts()[0] != starts()[1]).then_some(sides)
    }
}

/// Sides with their larger corners, grouped by smaller corner in compressed rows.
struct Sides {
    starts: Vec<usize>,
    of: Vec<(u32, usize)>,
}

fn sides_by_smaller_corner(triangles: &[[u32; 3]], stop: Stop<'_>) -> Option<Sides> {
    let ends = |&[a, b, c]: &[u32; 3]| {
        [(a, b), (b, c), (c, a)].map(|(i, j)| (i.min(j) as usize, i.max(j)))
    };
    let vertices = triangles.iter().flatten().max().map_or(0, |&last| last as usize + 1);
    let mut starts = vec![0; vertices + 1];
    for (smaller, _) in triangles.iter().flat_map(ends) {
        starts[smaller + 1] += 1;
    }
    go_on(stop)?;
    for vertex in 0..vertices {
        starts[vertex + 1] += starts[vertex];
    }
    go_on(stop)?;
    let mut next = starts.clone();
    let mut of = vec![(0, 0); 3 * triangles.len()];
    for (side, (smaller, larger)) in triangles.iter().flat_map(ends).enumerate() {
        let slot = &mut next[smaller];
        of[*slot] = (larger, side);
        *slot += 1;
    }
    Some(Sides { starts, of })
}

/// The corner that a side starts from.
pub fn corner(triangles: &[[u32; 3]], side: usize) -> u32 {
    triangles[side / 3][side % 3]
}

/// The corner opposite a side.
pub fn opposite(triangles: &[[u32; 3]], side: usize) -> u32 {
    triangles[side / 3][(side % 3 + 2) % 3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_edge_stands_once_with_its_triangles() {
        let triangles = [[0, 1, 2], [2, 1, 3], [3, 1, 4], [1, 3, 5]];
        let edges = Edges::new(&triangles);
        assert_eq!(edges.ends.len(), 9);
        let find = |ends: [u32; 2]| edges.ends.iter().position(|&e| e == ends).unwrap();
        assert_eq!(edges.count[find([1, 2])], 2);
        assert_eq!(edges.count[find([1, 3])], 3);
        assert_eq!(edges.borders().count(), 7);
        let [first, second] = edges.inner_sides(find([1, 2]), &triangles).unwrap();
        assert_eq!((opposite(&triangles, first), opposite(&triangles, second)), (0, 3));
        assert!(edges.inner_sides(find([1, 3]), &triangles).is_none());
        for side in 0..12 {
            let apex = opposite(&triangles, side);
            let ends = edges.ends[edges.of_side[side]];
            assert!(!ends.contains(&apex) && ends.contains(&corner(&triangles, side)), "{side}");
        }
    }
}
