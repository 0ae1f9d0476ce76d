//! Out into another file format and back.

use super::AttackError;
use crate::formats::{Asset, Limits};
use crate::mesh::Mesh;
use crate::sample::{to_glb, to_obj};

/// Written as binary glTF (single precision), read, written as OBJ with six decimals (as common
/// exporters do), and read again.
///
/// # Errors
/// [`AttackError::Format`] when a coordinate does not fit into single precision, or when all of
/// the mesh is lost in six decimals.
pub fn glb_and_obj(mesh: &Mesh) -> Result<Mesh, AttackError> {
    let limits = Limits { max_bytes: usize::MAX, ..Limits::default() };
    let single = Asset::read(&to_glb(mesh), &limits)?.into_mesh();
    Ok(Asset::read(&to_obj(&single), &limits)?.into_mesh())
}
