//! Generated meshes for the README, the tests and the benchmarks.
//!
//! Each is a closed surface whose norms are spread over its whole radial range, as those of a real
//! object are. No licence applies to it.

mod files;

use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use crate::mesh::{Mesh, MeshError};

pub use files::{to_glb, to_obj};

/// A shape that can be generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sample {
    /// A toothed wheel with a bore: flat faces, sharp edges, crowded norms.
    Gear,
    /// A tube along a torus knot: smooth, curved everywhere.
    Knot,
    /// A bumpy ball: an organic shape of many scales.
    Blob,
}

impl Sample {
    /// All shapes.
    pub const ALL: [Self; 3] = [Self::Gear, Self::Knot, Self::Blob];

    /// The shape with about `vertices` vertices (at least a few hundred).
    ///
    /// # Errors
    /// [`MeshError::TooLarge`] when 32-bit indices do not suffice.
    pub fn mesh(self, vertices: u32) -> Result<Mesh, MeshError> {
        match self {
            Self::Gear => gear(vertices),
            Self::Knot => knot(vertices),
            Self::Blob => blob(vertices),
        }
    }
}

impl fmt::Display for Sample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gear => "gear",
            Self::Knot => "knot",
            Self::Blob => "blob",
        })
    }
}

impl FromStr for Sample {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|sample| sample.to_string() == name);
        named.ok_or_else(|| format!("unknown sample {name:?}: it is gear, knot or blob"))
    }
}

/// A bumpy ball: sums of waves on the sphere, quads of a subdivided cube projected outward.
fn blob(vertices: u32) -> Result<Mesh, MeshError> {
    // Six faces of n x n quads share their borders: 6 n^2 + 2 vertices.
    let n = (f64::from(vertices.max(200)) / 6.0).sqrt().round();
    let radius = |d: DVec3| {
        let wave = |k: f64, a: f64, shift: f64| {
            a * libm::sin(k * d.x + shift)
                * libm::cos(k * d.y - 2.0 * shift)
                * libm::sin(k * d.z + 0.5)
        };
        1.0 + 0.35 * d.y + wave(3.0, 0.4, 0.3) + wave(7.0, 0.12, 1.7) + wave(23.0, 0.015, 0.9)
    };
    grid_cube(n, |d| d * radius(d))
}

/// A cube of `n` x `n` quads a face, borders shared, each point mapped from its direction.
fn grid_cube(n: f64, place: impl Fn(DVec3) -> DVec3) -> Result<Mesh, MeshError> {
    let axes = [
        (DVec3::X, DVec3::Y, DVec3::Z),
        (DVec3::NEG_X, DVec3::Z, DVec3::Y),
        (DVec3::Y, DVec3::Z, DVec3::X),
        (DVec3::NEG_Y, DVec3::X, DVec3::Z),
        (DVec3::Z, DVec3::X, DVec3::Y),
        (DVec3::NEG_Z, DVec3::Y, DVec3::X),
    ];
    let steps = || std::iter::successors(Some(0.0), |i| Some(i + 1.0)).take_while(move |&i| i <= n);
    let mut builder = Builder::default();
    for (normal, u, v) in axes {
        let point = |i: f64, j: f64| {
            // Tangent spacing evens the areas out.
            let warp = |k: f64| libm::tan(std::f64::consts::FRAC_PI_4 * (2.0 * k / n - 1.0));
            (normal + u * warp(i) + v * warp(j)).normalize()
        };
        for i in steps().take_while(|&i| i < n) {
            for j in steps().take_while(|&j| j < n) {
                builder.quad(
                    [(i, j), (i + 1.0, j), (i + 1.0, j + 1.0), (i, j + 1.0)]
                        .map(|(i, j)| place(point(i, j))),
                );
            }
        }
    }
    builder.finish()
}

/// A (2, 3) torus knot with a tube whose radius swells along it.
fn knot(vertices: u32) -> Result<Mesh, MeshError> {
    let around = (f64::from(vertices.max(200)) / 16.0).sqrt().round().max(3.0);
    let along = (f64::from(vertices.max(200)) / around).round();
    let path = |s: f64| {
        let t = TAU * s;
        let r = 2.0 + 0.8 * libm::cos(3.0 * t);
        DVec3::new(r * libm::cos(2.0 * t), r * libm::sin(2.0 * t), 0.9 * libm::sin(3.0 * t))
    };
    let point = |s: f64, a: f64| {
        let step = 1e-4;
        let tangent = (path(s + step) - path(s - step)).normalize();
        let bend = path(s + step) + path(s - step) - 2.0 * path(s);
        let normal = (bend - tangent * bend.dot(tangent)).normalize();
        let ring = normal * libm::cos(TAU * a) + tangent.cross(normal) * libm::sin(TAU * a);
        path(s) + ring * (0.32 + 0.06 * libm::sin(TAU * 7.0 * s) + 0.01 * libm::cos(TAU * 5.0 * a))
    };
    wrapped_grid(along, around, point)
}

/// A wheel of 18 teeth with a bore, extruded, its flanks finely divided.
fn gear(vertices: u32) -> Result<Mesh, MeshError> {
    // The closed profile of a slice through the rim is swept around the axis.
    let around = (f64::from(vertices.max(400)) * 2.2).sqrt().round();
    let profile = (f64::from(vertices.max(400)) / around).round().max(8.0);
    let point = |a: f64, p: f64| {
        let tooth = libm::sin(18.0 * TAU * a);
        let rim = 1.0 + 0.09 * (4.0 * tooth).clamp(-1.0, 1.0);
        // A rectangle walked once: outer face, top, bore, bottom.
        let (bore, half) = (0.35, 0.18);
        let (r, z) = match 4.0 * p {
            q if q < 1.0 => (rim, half * (2.0 * q - 1.0)),
            q if q < 2.0 => (rim + (bore - rim) * (q - 1.0), half),
            q if q < 3.0 => (bore, half * (1.0 - 2.0 * (q - 2.0))),
            q => (bore + (rim - bore) * (q - 3.0), -half),
        };
        DVec3::new(r * libm::cos(TAU * a), r * libm::sin(TAU * a), z)
    };
    wrapped_grid(around, profile, point)
}

/// A torus-like grid of `m` x `n` quads over [0, 1)^2.
fn wrapped_grid(m: f64, n: f64, point: impl Fn(f64, f64) -> DVec3) -> Result<Mesh, MeshError> {
    let mut builder = Builder::default();
    let mut i = 0.0;
    while i < m {
        let mut j = 0.0;
        while j < n {
            let next = |k: f64, of: f64| if k + 1.0 < of { k + 1.0 } else { 0.0 };
            let corners = [(i, j), (next(i, m), j), (next(i, m), next(j, n)), (i, next(j, n))];
            builder.quad(corners.map(|(i, j)| point(i / m, j / n)));
            j += 1.0;
        }
        i += 1.0;
    }
    builder.finish()
}

/// Collects quads, sharing corners at equal positions.
#[derive(Default)]
struct Builder {
    index: std::collections::HashMap<[i64; 3], u32>,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Builder {
    fn corner(&mut self, p: DVec3) -> u32 {
        // Corners computed along two borders differ in their last bits; a millionth is far below
        // any edge of these shapes.
        #[expect(clippy::cast_possible_truncation)]
        let cell = (p * 1e6).round().to_array().map(|x| x as i64);
        let next = u32::try_from(self.positions.len()).unwrap_or(u32::MAX);
        let index = *self.index.entry(cell).or_insert(next);
        if index == next {
            self.positions.push(p);
        }
        index
    }

    fn quad(&mut self, corners: [DVec3; 4]) {
        let [a, b, c, d] = corners.map(|p| self.corner(p));
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    fn finish(self) -> Result<Mesh, MeshError> {
        Mesh::new(self.positions, self.triangles)
    }
}
