//! The marching cubes table, computed from its rules.

/// The edges of a cell: lower corner and axis. Bit `k` of a corner's number is its step along axis
/// `k`.
pub const EDGES: [(usize, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// The corners of each face, counterclockwise when viewed from outside.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// For each set of inside corners (bit `k` for corner `k`), the triangles, which face outward.
/// Their corners are numbers of edges.
pub struct Cases(Vec<Vec<[usize; 3]>>);

impl Cases {
    pub fn new() -> Self {
        Self((0..256).map(|case| loops(case).iter().flat_map(|l| triangles(l)).collect()).collect())
    }

    pub fn of(&self, case: usize) -> &[[usize; 3]] {
        &self.0[case]
    }
}

/// The edge between two neighbouring corners.
fn edge_between(a: usize, b: usize) -> usize {
    EDGES
        .iter()
        .position(|&(corner, axis)| corner == a.min(b) && corner | 1 << axis == a.max(b))
        .unwrap_or(0)
}

/// The closed polylines in which the surface meets the cell's faces. On each face, a segment
/// separates each run of inside corners from the other corners.
fn loops(case: usize) -> Vec<Vec<usize>> {
    let inside = |corner: usize| case >> corner & 1 == 1;
    // For each edge where a run of inside corners begins on a face, the edge where it ends on that
    // face. Neighbouring faces traverse their common edge in opposite directions, so each edge
    // begins a run on one face and ends a run on the other.
    let mut next = [usize::MAX; 12];
    for face in FACES {
        for k in 0..4 {
            let corner = |by: usize| face[(k + by) % 4];
            if !inside(corner(0)) && inside(corner(1)) {
                let end = (1..4).find(|&by| !inside(corner(by + 1))).unwrap_or(1);
                next[edge_between(corner(0), corner(1))] =
                    edge_between(corner(end), corner(end + 1));
            }
        }
    }
    let mut loops = Vec::new();
    for start in 0..12 {
        let mut line = Vec::new();
        let mut at = start;
        while next[at] != usize::MAX {
            line.push(at);
            at = std::mem::replace(&mut next[at], usize::MAX);
        }
        if !line.is_empty() {
            loops.push(line);
        }
    }
    loops
}

/// Whether two edges lie in one face.
fn share_a_face(a: usize, b: usize) -> bool {
    let corners = |edge: usize| {
        let (corner, axis) = EDGES[edge];
        [corner, corner | 1 << axis]
    };
    let all = [corners(a), corners(b)].concat();
    FACES.iter().any(|face| all.iter().all(|corner| face.contains(corner)))
}

/// Cuts a polygon into triangles whose inner sides lie in no face. Otherwise the neighbouring cell
/// could have the same side, which would then have four triangles. Every polygon of the table can
/// be cut in this way.
fn triangles(polygon: &[usize]) -> Vec<[usize; 3]> {
    cut(polygon).unwrap_or_default()
}

fn cut(polygon: &[usize]) -> Option<Vec<[usize; 3]>> {
    let count = polygon.len();
    if let [a, b, c] = *polygon {
        return Some(vec![[a, b, c]]);
    }
    (0..count).find_map(|ear| {
        let [before, after] = [polygon[(ear + count - 1) % count], polygon[(ear + 1) % count]];
        if count < 3 || share_a_face(before, after) {
            return None;
        }
        let mut rest = polygon.to_vec();
        rest.remove(ear);
        let mut all = cut(&rest)?;
        all.push([before, polygon[ear], after]);
        Some(all)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn every_case_is_cut_without_a_side_in_a_face() {
        for case in 0..256 {
            for polygon in loops(case) {
                let count = polygon.len();
                assert!(count >= 3, "{case}");
                assert_eq!(cut(&polygon).map(|all| all.len()), Some(count - 2), "{case}");
            }
            let crossed = EDGES
                .iter()
                .filter(|&&(corner, axis)| case >> corner & 1 != case >> (corner | 1 << axis) & 1)
                .count();
            assert_eq!(loops(case).concat().len(), crossed, "{case}");
        }
    }

    #[test]
    fn triangles_look_outward() {
        let middle = |edge: usize| {
            let (corner, axis) = EDGES[edge];
            let at = |k: usize| if corner >> k & 1 == 1 { 1.0 } else { 0.0 };
            let mut place = [at(0), at(1), at(2)];
            place[axis] = 0.5;
            DVec3::from_array(place)
        };
        for corner in 0..8 {
            let place: DVec3 = DVec3::from_array([0, 1, 2].map(|k| f64::from(corner >> k & 1)));
            for (case, sign) in [(1 << corner, 1.0), (255 ^ (1 << corner), -1.0)] {
                let [[a, b, c]] = Cases::new().of(case).try_into().unwrap();
                let [a, b, c] = [a, b, c].map(middle);
                let normal = (b - a).cross(c - a);
                assert!(sign * normal.dot(a - place) > 0.0, "{case}");
            }
        }
    }
}
