//! Mean curvature from the edges within a ball that lead away from its centre (D. Cohen-Steiner and
//! J.-M. Morvan, *Restricted Delaunay triangulations and normal cycle*, Symposium on Computational
//! Geometry 2003).

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::attacks::edges::Edges;
use crate::mesh::surface::{Surface, doubled_area};

/// A surface with its edges around each vertex.
pub struct Shape<'a> {
    pub surface: &'a Surface,
    /// For each vertex, where its entries in `spokes` begin. There is one entry per neighbour, with
    /// the signed angle at the edge between (0 at borders).
    starts: Vec<usize>,
    spokes: Vec<Spoke>,
}

/// An edge, from one of its ends.
#[derive(Debug, Clone, Copy)]
pub struct Spoke {
    /// The other end.
    pub to: u32,
    /// Angle between the triangles' normals as the arc sine of its sine, positive if the edge is
    /// convex.
    pub angle: f64,
}

impl<'a> Shape<'a> {
    pub fn new(surface: &'a Surface) -> Self {
        let edges = Edges::new(&surface.triangles);
        let mut starts = vec![0; surface.positions.len() + 1];
        for &v in edges.ends.iter().flatten() {
            starts[v as usize + 1] += 1;
        }
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        let mut next = starts.clone();
        let mut spokes = vec![Spoke { to: 0, angle: 0.0 }; 2 * edges.ends.len()];
        for (edge, &[a, b]) in edges.ends.iter().enumerate() {
            let angle = edges
                .inner_sides(edge, &surface.triangles)
                .map_or(0.0, |sides| signed_angle(surface, sides));
            for (from, to) in [(a, b), (b, a)] {
                let slot = &mut next[from as usize];
                spokes[*slot] = Spoke { to, angle };
                *slot += 1;
            }
        }
        Self { surface, starts, spokes }
    }

    pub fn spokes(&self, vertex: usize) -> &[Spoke] {
        &self.spokes[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// Longest side of the bounding box.
    pub fn longest_side(&self) -> f64 {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) =
            self.surface.positions.iter().fold(start, |(l, h), &p| (l.min(p), h.max(p)));
        (high - low).max_element()
    }
}

/// The angle by which the normal turns from the first side's triangle to the second's, about the
/// edge in the direction of the first side. It follows from its sine alone, as in the published
/// program: beyond a right angle it decreases again.
fn signed_angle(surface: &Surface, sides: [usize; 2]) -> f64 {
    let at = |v: u32| surface.positions[v as usize];
    let normal = |side: usize| {
        let [a, b, c] = surface.triangles[side / 3].map(at);
        doubled_area(a, b, c).normalize_or_zero()
    };
    let [n, m] = sides.map(normal);
    let corners = surface.triangles[sides[0] / 3];
    let k = sides[0] % 3;
    let along = (at(corners[(k + 1) % 3]) - at(corners[k])).normalize_or_zero();
    libm::asin(n.cross(m).dot(along).clamp(-1.0, 1.0))
}

/// For each vertex, half the sum of the absolute principal curvatures, in units of 1 / length.
pub fn mean_curvatures(shape: &Shape<'_>, radius: f64) -> Vec<f64> {
    (0..shape.surface.positions.len())
        .into_par_iter()
        .with_min_len(4096)
        .map_init(Inside::default, |inside, vertex| {
            let tensor = tensor(shape, vertex, radius, inside);
            let mut sizes = eigenvalues(&tensor).map(f64::abs);
            sizes.sort_unstable_by(f64::total_cmp);
            // The smallest eigenvalue belongs to the normal.
            f64::midpoint(sizes[1], sizes[2])
        })
        .collect()
}

/// The sum over edges of the angle, times the length within the ball, times the outer product of
/// the direction with itself, divided by the area of a disc of the ball's radius.
fn tensor(shape: &Shape<'_>, vertex: usize, radius: f64, inside: &mut Inside) -> DMat3 {
    let at = |v: u32| shape.surface.positions[v as usize];
    let mut sum = DMat3::ZERO;
    walk(shape, vertex, radius, inside, |from, spoke, share| {
        let edge = (at(spoke.to) - at(from)) * share;
        let length = edge.length();
        if length > 0.0 {
            let along = edge * (spoke.angle / length);
            sum += DMat3::from_cols(along * edge.x, along * edge.y, along * edge.z);
        }
    });
    sum * (1.0 / (PI * radius * radius))
}

/// The vertices inside a ball. It is reused from ball to ball, to save allocations.
#[derive(Debug, Default)]
pub struct Inside {
    /// In the order in which they were visited.
    pub list: Vec<u32>,
    /// For each vertex, the number of the last ball that contained it.
    balls: Vec<u32>,
    ball: u32,
}

impl Inside {
    fn begin(&mut self, vertices: usize, first: usize) {
        self.balls.resize(vertices, 0);
        self.ball = self.ball.wrapping_add(1);
        if self.ball == 0 {
            self.balls.fill(0);
            self.ball = 1;
        }
        self.list.clear();
        if let Ok(first) = u32::try_from(first) {
            self.add(first);
        }
    }

    fn add(&mut self, vertex: u32) {
        let ball = &mut self.balls[vertex as usize];
        if *ball != self.ball {
            *ball = self.ball;
            self.list.push(vertex);
        }
    }
}

/// Visits, from `vertex` outward, the edges that begin in the ball around it and lead away from its
/// centre: `visit(start, edge, share of the edge inside)`. The vertices that are reached within the
/// ball are written to `inside`.
///
/// An edge whose point nearest to the centre lies between its ends is visited from neither end. The
/// definition includes such edges. The published program leaves them out, and so do the published
/// values.
pub fn walk(
    shape: &Shape<'_>,
    vertex: usize,
    radius: f64,
    inside: &mut Inside,
    mut visit: impl FnMut(u32, Spoke, f64),
) {
    let at = |v: u32| shape.surface.positions[v as usize];
    let centre = shape.surface.positions[vertex];
    inside.begin(shape.surface.positions.len(), vertex);
    let mut next = 0;
    while let Some(&from) = inside.list.get(next) {
        let start = at(from);
        for &spoke in shape.spokes(from as usize) {
            let edge = at(spoke.to) - start;
            if next > 0 && edge.dot(start - centre) <= 0.0 {
                continue;
            }
            let share = share_inside(start - centre, edge, radius);
            visit(from, spoke, share);
            if share >= 1.0 {
                inside.add(spoke.to);
            }
        }
        next += 1;
    }
}

/// The share of `edge` that lies inside a ball; 1 if all of it does. `start` is relative to the
/// ball's centre.
fn share_inside(start: DVec3, edge: DVec3, radius: f64) -> f64 {
    let a = edge.length_squared();
    let b = edge.dot(start);
    let c = start.length_squared() - radius * radius;
    let root = b * b - a * c;
    if a <= 0.0 || root < 0.0 {
        return 0.0;
    }
    ((root.sqrt() - b) / a).clamp(0.0, 1.0)
}

/// Eigenvalues of a symmetric matrix in closed form (O. K. Smith, *Eigenvalues of a symmetric 3 x 3
/// matrix*, Communications of the ACM 4(4), 1961).
fn eigenvalues(m: &DMat3) -> [f64; 3] {
    let mean = (m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0;
    let centred = *m - DMat3::from_diagonal(DVec3::splat(mean));
    let squares = centred.x_axis.length_squared()
        + centred.y_axis.length_squared()
        + centred.z_axis.length_squared();
    let scale = (squares / 6.0).sqrt();
    if scale <= 0.0 {
        return [mean; 3];
    }
    let half = (centred * (1.0 / scale)).determinant() / 2.0;
    let angle = libm::acos(half.clamp(-1.0, 1.0)) / 3.0;
    [0.0, 1.0, 2.0].map(|k| mean + 2.0 * scale * libm::cos(angle + k * TAU / 3.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    /// A tube or a ball as a fine grid over the unit square.
    fn grid(m: u32, n: u32, place: impl Fn(f64, f64) -> DVec3) -> Surface {
        let at = |i: u32, j: u32| place(f64::from(i) / f64::from(m), f64::from(j) / f64::from(n));
        let positions = (0..m).flat_map(|i| (0..=n).map(move |j| (i, j)));
        let positions = positions.map(|(i, j)| at(i, j)).collect();
        let v = |i: u32, j: u32| (i % m) * (n + 1) + j;
        let cells = (0..m).flat_map(|i| (0..n).map(move |j| (i, j)));
        let triangles = cells
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [v(i, j), v(i + 1, j), v(i + 1, j + 1), v(i, j + 1)];
                // Alternating diagonals, so that no direction is favoured.
                if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
            })
            .collect();
        Surface::new(&Mesh::new(positions, triangles).unwrap())
    }

    #[test]
    fn spheres_and_cylinders_have_their_curvature() {
        // The mesh is fine compared with the ball. Edges that pass its centre are left out; the
        // shorter the edges, the fewer they are.
        let sphere = grid(320, 160, |u, v| {
            let (a, b) = (TAU * u, PI * (0.1 + 0.8 * v));
            2.0 * DVec3::new(a.cos() * b.sin(), a.sin() * b.sin(), b.cos())
        });
        let cylinder = grid(160, 320, |u, v| {
            DVec3::new(2.0 * (TAU * u).cos(), 2.0 * (TAU * u).sin(), 6.0 * v)
        });
        for (surface, expected) in [(&sphere, 0.5), (&cylinder, 0.25)] {
            let shape = Shape::new(surface);
            let curvatures = mean_curvatures(&shape, 0.5);
            // Away from the borders.
            let inner = surface.positions.iter().zip(&curvatures);
            let middle = if expected < 0.3 { 3.0 } else { 0.0 };
            let inner: Vec<f64> =
                inner.filter(|(p, _)| (p.z - middle).abs() < 0.8).map(|(_, c)| *c).collect();
            let mean = inner.iter().sum::<f64>() / inner.len() as f64;
            assert!((mean / expected - 1.0).abs() < 0.08, "{mean} for {expected}");
        }
    }

    /// Two triangles that meet at the x axis, the second folded by an angle.
    #[test]
    fn angles_are_known_by_their_sines() {
        for (fold, expected) in [(0.5, 0.5), (1.5, 1.5), (2.0, PI - 2.0), (-0.7, -0.7)] {
            let (sine, cosine) = f64::sin_cos(fold);
            let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.0, -cosine, -sine)];
            let mesh = Mesh::new(positions, vec![[0, 1, 2], [1, 0, 3]]).unwrap();
            let surface = Surface::new(&mesh);
            let shape = Shape::new(&surface);
            let angles = shape.spokes.iter().map(|spoke| spoke.angle);
            let largest = angles.fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
            assert!((largest - expected).abs() < 1e-9, "{largest} for a fold of {fold}");
        }
    }

    #[test]
    fn eigenvalues_are_those_of_the_matrix() {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, -1.2, 2.0);
        let m = turn * DMat3::from_diagonal(DVec3::new(3.0, -1.0, 0.5)) * turn.transpose();
        let mut values = eigenvalues(&m);
        values.sort_unstable_by(f64::total_cmp);
        for (value, expected) in values.iter().zip([-1.0, 0.5, 3.0]) {
            assert!((value - expected).abs() < 1e-12, "{values:?}");
        }
    }
}
