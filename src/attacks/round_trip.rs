//! A round trip through other file formats.

use super::AttackError;
use crate::formats::{Asset, Limits};
use crate::mesh::Mesh;
use crate::sample::{to_glb, to_obj};

/// Writes the mesh as binary glTF (single precision), reads it, writes it as OBJ with six decimals
/// (as common exporters do), and reads it again.
///
/// # Errors
/// [`AttackError::Format`] when a coordinate does not fit into single precision, or when all of
/// the mesh is lost in six decimals.
pub fn glb_and_obj(mesh: &Mesh) -> Result<Mesh, AttackError> {
    let limits = Limits { max_bytes: usize::MAX, ..Limits::default() };
    let single = Asset::read(&to_glb(mesh), &limits)?.into_mesh();
    Ok(Asset::read(&to_obj(&single), &limits)?.into_mesh())
}
