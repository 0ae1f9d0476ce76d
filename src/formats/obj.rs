//! Wavefront OBJ.
use glam::DVec3;

use super::{FormatError, Limits};
use crate::mesh::Mesh;

/// Where the coordinates stand.
#[derive(Debug)]
pub(super) struct Layout;

pub(super) fn read(_bytes: &[u8], _limits: &Limits) -> Result<(Mesh, Layout), FormatError> {
    Err(FormatError::Empty)
}

impl Layout {
    pub(super) fn round(&self, _host: &Mesh, _positions: &mut [DVec3]) {}
    pub(super) fn write(
        &self,
        _bytes: &[u8],
        _host: &Mesh,
        _positions: &[DVec3],
    ) -> Result<Vec<u8>, FormatError> {
        Err(FormatError::Empty)
    }
}
