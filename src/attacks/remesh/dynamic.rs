//! A triangle mesh whose edges can be split, collapsed and flipped.

use glam::DVec3;
use smallvec::SmallVec;

use super::super::edges::Edges;
use super::super::{AttackError, compacted, index};
use crate::mesh::Mesh;
use crate::mesh::surface::{Surface, doubled_area};

/// The triangles around a vertex: mostly six, and rarely more than eight.
pub type Fan = SmallVec<[u32; 8]>;

/// Marks a removed triangle.
const GONE: [u32; 3] = [u32::MAX; 3];

/// Positions, triangles and their incidences. Removed triangles and vertices leave unused entries.
pub struct Dynamic {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Per vertex, its triangles.
    pub around: Vec<Fan>,
    /// Per vertex, the other ends of its feature edges: creases, borders, and edges with more than
    /// two triangles.
    pub features: Vec<Vec<u32>>,
    /// Per vertex, whether it lies on a border.
    pub border: Vec<bool>,
    /// Per vertex, a triangle of the old surface near it.
    pub below: Vec<u32>,
}

/// A triangle at an edge, and its corner opposite the edge.
#[derive(Debug, Clone, Copy)]
pub struct Wing {
    pub triangle: u32,
    pub apex: u32,
}

impl Dynamic {
    pub fn new(surface: &Surface, edges: &Edges, crease_degrees: f64) -> Self {
        let vertices = surface.positions.len();
        let mut this = Self {
            positions: surface.positions.clone(),
            triangles: surface.triangles.clone(),
            around: vec![Fan::new(); vertices],
            features: vec![Vec::new(); vertices],
            border: vec![false; vertices],
            below: vec![0; vertices],
        };
        for (t, triangle) in (0_u32..).zip(&surface.triangles) {
            for &vertex in triangle {
                this.around[vertex as usize].push(t);
                this.below[vertex as usize] = t;
            }
        }
        this.find_features(edges, crease_degrees.to_radians());
        this
    }

    fn find_features(&mut self, edges: &Edges, crease: f64) {
        for (edge, &[a, b]) in edges.ends.iter().enumerate() {
            let feature = match edges.inner_sides(edge, &self.triangles) {
                Some(sides) => {
                    let [n, m] = sides.map(|side| self.normal(index(side / 3)));
                    n.angle_between(m) > crease
                }
                None => true,
            };
            if feature {
                self.features[a as usize].push(b);
                self.features[b as usize].push(a);
            }
            if edges.count[edge] == 1 {
                self.border[a as usize] = true;
                self.border[b as usize] = true;
            }
        }
    }

    pub fn at(&self, vertex: u32) -> DVec3 {
        self.positions[vertex as usize]
    }

    pub fn length(&self, [a, b]: [u32; 2]) -> f64 {
        self.at(a).distance(self.at(b))
    }

    /// Twice the area vector of a triangle.
    pub fn normal(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.triangles[triangle as usize].map(|v| self.at(v));
        doubled_area(a, b, c)
    }

    /// Triangles that were not removed.
    pub fn living(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.triangles.iter().copied().filter(|&t| t != GONE)
    }

    pub fn area(&self) -> f64 {
        let area = |t: [u32; 3]| {
            let [a, b, c] = t.map(|v| self.at(v));
            doubled_area(a, b, c).length() / 2.0
        };
        self.living().map(area).sum()
    }

    /// Number of vertices with triangles.
    pub fn vertices(&self) -> usize {
        self.around.iter().filter(|triangles| !triangles.is_empty()).count()
    }

    /// The edges that `wanted` accepts, each once, in the order of their ends.
    pub fn edges(&self, wanted: impl Fn([u32; 2]) -> bool) -> Vec<[u32; 2]> {
        let sides = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
        let ordered = |[a, b]: [u32; 2]| [a.min(b), a.max(b)];
        let mut edges: Vec<[u32; 2]> =
            self.living().flat_map(sides).map(ordered).filter(|&edge| wanted(edge)).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Of [`edges`](Self::edges), those with an end among the vertices from `first` on.
    pub fn edges_from(&self, first: u32, wanted: impl Fn([u32; 2]) -> bool) -> Vec<[u32; 2]> {
        let mut edges = Vec::new();
        let mut list = Vec::new();
        for vertex in first..index(self.around.len()) {
            self.neighbours(vertex, &mut list);
            let own = list.iter().map(|&other| [vertex.min(other), vertex.max(other)]);
            edges.extend(own.filter(|&edge| wanted(edge)));
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    pub fn is_feature(&self, [a, b]: [u32; 2]) -> bool {
        self.features[a as usize].contains(&b)
    }

    /// The number of triangles at an edge, and the first two of them.
    pub fn wings(&self, [a, b]: [u32; 2]) -> (usize, [Wing; 2]) {
        let mut wings = [Wing { triangle: 0, apex: 0 }; 2];
        let mut count = 0;
        for &triangle in &self.around[a as usize] {
            let corners = self.triangles[triangle as usize];
            if corners.contains(&b) {
                let apex = corners.into_iter().find(|&c| c != a && c != b).unwrap_or(a);
                if let Some(wing) = wings.get_mut(count) {
                    *wing = Wing { triangle, apex };
                }
                count += 1;
            }
        }
        (count, wings)
    }

    /// The other triangle at the edge that `triangle` runs along from a to b. `None` unless there
    /// is exactly one other triangle and it runs from b to a.
    pub fn across(&self, triangle: u32, [a, b]: [u32; 2]) -> Option<Wing> {
        let mut others = self.around[a as usize].iter().filter_map(|&other| {
            let corners = self.triangles[other as usize];
            (other != triangle && corners.contains(&b)).then_some((other, corners))
        });
        let (triangle, [x, y, z]) = others.next()?;
        let apex =
            [([x, y], z), ([y, z], x), ([z, x], y)].into_iter().find(|(side, _)| *side == [b, a]);
        let wing = Wing { triangle, apex: apex?.1 };
        others.next().is_none().then_some(wing)
    }

    /// Neighbours of a vertex, ascending, into `list`.
    pub fn neighbours(&self, vertex: u32, list: &mut Vec<u32>) {
        list.clear();
        for &t in &self.around[vertex as usize] {
            list.extend(self.triangles[t as usize].into_iter().filter(|&c| c != vertex));
        }
        list.sort_unstable();
        list.dedup();
    }

    /// Whether there is an edge between two vertices.
    pub fn are_joined(&self, a: u32, b: u32) -> bool {
        self.around[a as usize].iter().any(|&t| self.triangles[t as usize].contains(&b))
    }

    /// Splits an edge by a new vertex at `place`. Each triangle at the edge becomes two.
    pub fn split(&mut self, [a, b]: [u32; 2], place: DVec3) {
        let middle = index(self.positions.len());
        let triangles: Fan = self.around[a as usize]
            .iter()
            .copied()
            .filter(|&t| self.triangles[t as usize].contains(&b))
            .collect();
        self.positions.push(place);
        self.border.push(triangles.len() == 1);
        self.below.push(self.below[a as usize]);
        self.features.push(Vec::new());
        let mut around = Fan::new();
        for t in triangles {
            let old = self.triangles[t as usize];
            let new = index(self.triangles.len());
            self.triangles[t as usize] = replaced(old, b, middle);
            self.triangles.push(replaced(old, a, middle));
            rename(&mut self.around[b as usize], t, new);
            if let Some(apex) = old.into_iter().find(|&c| c != a && c != b) {
                self.around[apex as usize].push(new);
            }
            around.extend([t, new]);
        }
        self.around.push(around);
        if self.is_feature([a, b]) {
            rename(&mut self.features[a as usize], b, middle);
            rename(&mut self.features[b as usize], a, middle);
            self.features[middle as usize] = vec![a, b];
        }
    }

    /// Merges `gone` into `kept`, which moves to `place`. The caller has checked the link
    /// condition, so that the result is a surface.
    pub fn collapse(&mut self, gone: u32, kept: u32, place: DVec3) {
        let triangles = std::mem::take(&mut self.around[gone as usize]);
        for t in triangles {
            let corners = self.triangles[t as usize];
            if corners.contains(&kept) {
                for corner in corners {
                    self.around[corner as usize].retain(|other| *other != t);
                }
                self.triangles[t as usize] = GONE;
            } else {
                self.triangles[t as usize] = replaced(corners, gone, kept);
                self.around[kept as usize].push(t);
            }
        }
        for end in std::mem::take(&mut self.features[gone as usize]) {
            self.features[end as usize].retain(|&other| other != gone);
            if end != kept && !self.features[kept as usize].contains(&end) {
                self.features[kept as usize].push(end);
                self.features[end as usize].push(kept);
            }
        }
        self.border[kept as usize] |= self.border[gone as usize];
        self.positions[kept as usize] = place;
    }

    /// Flips the edge a-b of two triangles to the edge between their apexes. `first` runs from a to
    /// b.
    pub fn flip(&mut self, [a, b]: [u32; 2], first: Wing, second: Wing) {
        self.triangles[first.triangle as usize] = [a, second.apex, first.apex];
        self.triangles[second.triangle as usize] = [second.apex, b, first.apex];
        self.around[b as usize].retain(|t| *t != first.triangle);
        self.around[a as usize].retain(|t| *t != second.triangle);
        self.around[second.apex as usize].push(first.triangle);
        self.around[first.apex as usize].push(second.triangle);
    }

    pub fn finish(self) -> Result<Mesh, AttackError> {
        let triangles = self.living().collect();
        compacted(&self.positions, triangles)
    }
}

fn replaced(corners: [u32; 3], old: u32, new: u32) -> [u32; 3] {
    corners.map(|c| if c == old { new } else { c })
}

fn rename(list: &mut [u32], old: u32, new: u32) {
    for item in list {
        if *item == old {
            *item = new;
        }
    }
}
