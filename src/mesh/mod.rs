//! Positions and triangles, and the geometry that everything above is built from.
//!
//! Pure: slices in, values out. This module must not know about files, keys, watermarks or clocks. The
//! only threads are rayon's data parallelism, and no result depends on their number.

pub mod adjacency;
pub mod closest;
pub mod distortion;
pub mod facing;
pub mod linear;
pub mod mixing;
pub mod powers;
pub mod quadric;
pub mod quality;
pub mod sampling;
pub mod stop;
pub mod sum;
pub mod surface;
pub mod tree;
pub mod turning;
pub mod weld;

use glam::DVec3;

/// Why a list of positions and triangles is not a mesh.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// A position has a coordinate that is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not a finite number")]
    NonFiniteVertex {
        /// Index of the first such vertex.
        vertex: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {index}, but there are {vertices} vertices")]
    IndexOutOfRange {
        /// Index of the first such triangle.
        triangle: usize,
        /// The vertex that it names.
        index: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// There are no triangles, so there is no surface.
    #[error("the file has no triangles, so there is no surface to mark or read")]
    NoTriangles,
    /// More vertices or triangles than 32-bit indices can name.
    #[error("more than 2^32 - 1 vertices or triangles")]
    TooLarge,
}

/// A triangle mesh: finite positions, at least one triangle, every index in range.
///
/// Vertices are those of the file, in the file's order. Duplicates at UV or normal seams stay separate
/// here; [`surface::Surface`] welds them.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Takes positions (any unit) and triangles (indices into `positions`).
    ///
    /// # Errors
    /// [`MeshError`] when a coordinate is not finite, an index is out of range or there is no
    /// triangle.
    pub fn new(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        if u32::try_from(positions.len()).is_err() || u32::try_from(triangles.len()).is_err() {
            return Err(MeshError::TooLarge);
        }
        if triangles.is_empty() {
            return Err(MeshError::NoTriangles);
        }
        if let Some(vertex) = positions.iter().position(|p| !p.is_finite()) {
            return Err(MeshError::NonFiniteVertex { vertex });
        }
        let vertices = positions.len();
        let in_range = |i: u32| usize::try_from(i).is_ok_and(|i| i < vertices);
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&index) = corners.iter().find(|&&i| !in_range(i)) {
                return Err(MeshError::IndexOutOfRange { triangle, index, vertices });
            }
        }
        Ok(Self { positions, triangles })
    }

    /// Positions in file order, world space.
    #[must_use]
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Triangles as corner indices into [`Mesh::positions`].
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }
}
