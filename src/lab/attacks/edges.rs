//! The edges of a triangle list, each once, with the triangles at it.

use rayon::slice::ParallelSliceMut;

/// No such triangle side.
pub const NO_SIDE: usize = usize::MAX;

/// Edges in the order of their corners.
pub struct Edges {
    /// The two corners, smaller index first.
    pub ends: Vec<[u32; 2]>,
    /// How many triangles stand at the edge.
    pub count: Vec<usize>,
    /// The first two sides that are this edge: side `3 t + k` runs from corner k of triangle t to
    /// the next.
    pub sides: Vec<[usize; 2]>,
    /// Per side, its edge.
    pub of_side: Vec<usize>,
}

impl Edges {
    /// Sorts the sides of `triangles`.
    pub fn new(triangles: &[[u32; 3]]) -> Self {
        let mut sides: Vec<([u32; 2], usize)> = Vec::with_capacity(3 * triangles.len());
        for (triangle, &[a, b, c]) in triangles.iter().enumerate() {
            for (k, (i, j)) in [(a, b), (b, c), (c, a)].into_iter().enumerate() {
                sides.push(([i.min(j), i.max(j)], 3 * triangle + k));
            }
        }
        sides.par_sort_unstable();
        let mut edges = Self {
            ends: Vec::with_capacity(sides.len() / 2),
            count: Vec::with_capacity(sides.len() / 2),
            sides: Vec::with_capacity(sides.len() / 2),
            of_side: vec![0; sides.len()],
        };
        for (ends, side) in sides {
            let known = edges.ends.last() == Some(&ends);
            if known {
                let last = edges.count.len() - 1;
                if edges.count[last] == 1 {
                    edges.sides[last][1] = side;
                }
                edges.count[last] += 1;
            } else {
                edges.ends.push(ends);
                edges.count.push(1);
                edges.sides.push([side, NO_SIDE]);
            }
            edges.of_side[side] = edges.ends.len() - 1;
        }
        edges
    }

    /// Edges with one triangle.
    pub fn borders(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.ends.iter().zip(&self.count).filter(|&(_, &count)| count == 1).map(|(&ends, _)| ends)
    }

    /// The two sides of an edge where exactly two triangles meet that agree on the outside: the
    /// sides run against each other.
    pub fn inner_sides(&self, edge: usize, triangles: &[[u32; 3]]) -> Option<[usize; 2]> {
        let sides = self.sides[edge];
        let starts = || sides.map(|side| corner(triangles, side));
        (self.count[edge] == 2 && starts()[0] != starts()[1]).then_some(sides)
    }
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
