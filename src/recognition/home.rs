//! Hosts and suspects made ready for each other.

use std::sync::OnceLock;

use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::registration::{PreparedHost, PreparedSuspect, Shape};

/// A host, ready for suspects; worth keeping between them.
pub struct Home {
    mesh: Mesh,
    surface: Surface,
    prepared: OnceLock<Option<PreparedHost>>,
}

impl Home {
    /// Takes a host's geometry over.
    #[must_use]
    pub fn new(mesh: Mesh) -> Self {
        Self { surface: Surface::new(&mesh), mesh, prepared: OnceLock::new() }
    }

    /// Its geometry.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Its carriers.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Bytes that it takes in memory with all that is made of it, about.
    #[must_use]
    pub fn bytes(&self) -> usize {
        // Positions, normals, rings, codes and the search tree, as measured on the dragon.
        const VERTEX: usize = 300;
        const TRIANGLE: usize = 200;
        self.mesh.positions().len() * VERTEX + self.mesh.triangles().len() * TRIANGLE
    }

    pub(super) fn prepared(&self) -> Option<&PreparedHost> {
        let prepare = || Shape::new(self.surface.clone()).map(PreparedHost::new);
        self.prepared.get_or_init(prepare).as_ref()
    }
}

/// A suspect, ready for hosts.
pub struct Visitor<'a> {
    mesh: &'a Mesh,
    surface: &'a Surface,
    prepared: OnceLock<Option<PreparedSuspect>>,
}

impl<'a> Visitor<'a> {
    /// A mesh and its carriers.
    #[must_use]
    pub fn new(mesh: &'a Mesh, surface: &'a Surface) -> Self {
        Self { mesh, surface, prepared: OnceLock::new() }
    }

    /// Its geometry.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        self.mesh
    }

    /// Its carriers.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        self.surface
    }

    pub(super) fn prepared(&self) -> Option<&PreparedSuspect> {
        let prepare = || Shape::new(self.surface.clone()).map(PreparedSuspect::new);
        self.prepared.get_or_init(prepare).as_ref()
    }
}
