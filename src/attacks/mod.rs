//! Attacks on a marked mesh, one family per file. Each attack is a pure function of a mesh, its
//! parameters and a seed.
//!
//! Vertices with the same position are one point (`mesh::weld`) and are moved together. Otherwise
//! seams would crack, which no attacker wants. Attacks that make new triangles give the welded
//! surface, without stray vertices, triangles without area and the file's seams.
//!
//! Must not know about files on disk, clocks or what is measured afterwards.

mod attack;
pub mod collude;
pub mod cotangent;
pub mod crop;
pub(crate) mod edges;
pub mod fragment;
mod isosurface;
pub mod named;
pub mod noise;
pub mod pipeline;
pub mod quantise;
pub mod random;
pub mod re_mark;
pub mod remesh;
pub mod reorder;
pub mod round_trip;
pub mod scan;
pub mod similarity;
pub mod simplify;
pub mod smooth;
pub mod spikes;
pub mod subdivide;
mod target;
pub mod voxel;

use glam::DVec3;

use crate::formats::FormatError;
use crate::mesh::surface::NO_CARRIER;
use crate::mesh::{Mesh, MeshError};
use crate::watermark::WatermarkError;

pub use attack::{Attack, Context};
pub use named::Named;
pub use target::Target;

/// Why an attack gives no mesh.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AttackError {
    /// The result is not a valid mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The mesh cannot be marked again.
    #[error(transparent)]
    Watermark(#[from] WatermarkError),
    /// The mesh does not survive a file format.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Copies to be averaged are not copies of one mesh.
    #[error("the copies differ in their triangles or numbers of vertices")]
    CopiesDiffer,
    /// The caller asked it to stop.
    #[error("stopped")]
    Stopped,
    /// There is no surface to work on.
    #[error("no triangle of the mesh has an area")]
    NoSurface,
}

/// A count as an index. Meshes have fewer than 2^32 vertices and triangles
/// ([`MeshError::TooLarge`]).
fn index(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// `share` of `count`, rounded; 0 for a negative share.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and count")]
fn share_of(count: usize, share: f64) -> usize {
    (count as f64 * share.clamp(0.0, 1.0)).round() as usize
}

/// The mesh with its carrier vertices at `positions`; other vertices stay.
fn with_carriers_at(target: &Target<'_>, positions: &[DVec3]) -> Result<Mesh, AttackError> {
    let (mesh, surface) = (target.mesh(), target.surface()?);
    let at = |(vertex, &carrier): (&DVec3, &u32)| {
        if carrier == NO_CARRIER { *vertex } else { positions[carrier as usize] }
    };
    let moved = mesh.positions().iter().zip(&surface.carrier_of).map(at).collect();
    Ok(Mesh::new(moved, mesh.triangles().to_vec())?)
}

/// A mesh of `triangles` and those of `positions` that they use, in the old order.
fn compacted(positions: &[DVec3], mut triangles: Vec<[u32; 3]>) -> Result<Mesh, AttackError> {
    const UNUSED: u32 = u32::MAX;
    let mut new_index = vec![UNUSED; positions.len()];
    for &vertex in triangles.iter().flatten() {
        new_index[vertex as usize] = 0;
    }
    let mut used = Vec::new();
    for (new, &position) in new_index.iter_mut().zip(positions) {
        if *new != UNUSED {
            *new = index(used.len());
            used.push(position);
        }
    }
    for triangle in &mut triangles {
        *triangle = triangle.map(|vertex| new_index[vertex as usize]);
    }
    Ok(Mesh::new(used, triangles)?)
}

#[cfg(test)]
mod tests;
