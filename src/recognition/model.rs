//! Hosts and suspects made ready for each other.

use std::sync::OnceLock;

use crate::mesh::Mesh;
use crate::mesh::facing::{faces_inward, turned_over};
use crate::mesh::stop::{Stop, go_on, once, unstopped};
use crate::mesh::surface::Surface;
use crate::registration::{PreparedHost, PreparedSuspect, Shape};
use crate::relief::ReliefHost;

/// A host, ready for suspects; worth keeping between them.
pub struct HostModel {
    mesh: Mesh,
    surface: Surface,
    faces_inward: Option<bool>,
    prepared: OnceLock<Option<PreparedHost>>,
    relief: OnceLock<Option<ReliefHost>>,
}

impl HostModel {
    /// Takes a host's geometry over.
    #[must_use]
    pub fn new(mesh: Mesh) -> Self {
        unstopped(|stop| Self::new_until(mesh, stop))
    }

    /// The same; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(mesh: Mesh, stop: Stop<'_>) -> Option<Self> {
        let surface = Surface::new_until(&mesh, stop)?;
        let (faces_inward, prepared) = (faces_inward(&surface), OnceLock::new());
        Some(Self { mesh, surface, faces_inward, prepared, relief: OnceLock::new() })
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
        const VERTEX: usize = 420;
        const TRIANGLE: usize = 320;
        self.mesh.positions().len() * VERTEX + self.mesh.triangles().len() * TRIANGLE
    }

    /// What its relief is read with; `None` where there is none, and once `stop` answers `true`.
    pub fn relief(&self, stop: Stop<'_>) -> Option<&ReliefHost> {
        let prepare = || {
            let prepared = ReliefHost::new_until(self.surface.clone(), stop);
            go_on(stop).map(|()| prepared)
        };
        once(&self.relief, prepare)?.as_ref()
    }

    /// `None` where there is no shape, and once `stop` answers `true`.
    pub(super) fn prepared(&self, stop: Stop<'_>) -> Option<&PreparedHost> {
        let prepare = || {
            let shape = Shape::new_until(self.surface.clone(), stop);
            let prepared = shape.and_then(|shape| PreparedHost::new_until(shape, stop));
            go_on(stop).map(|()| prepared)
        };
        once(&self.prepared, prepare)?.as_ref()
    }
}

/// A suspect, ready for hosts.
pub struct SuspectModel<'a> {
    mesh: &'a Mesh,
    surface: &'a Surface,
    faces_inward: Option<bool>,
    prepared: OnceLock<Option<PreparedSuspect>>,
    /// With its triangles turned over.
    over: OnceLock<Over>,
}

struct Over {
    surface: Surface,
    prepared: OnceLock<Option<PreparedSuspect>>,
}

impl<'a> SuspectModel<'a> {
    /// A mesh and its carriers.
    #[must_use]
    pub fn new(mesh: &'a Mesh, surface: &'a Surface) -> Self {
        let (faces_inward, prepared) = (faces_inward(surface), OnceLock::new());
        Self { mesh, surface, faces_inward, prepared, over: OnceLock::new() }
    }

    /// Its geometry.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        self.mesh
    }

    /// Its carriers; with triangles that face as the host's do where both have an inside.
    #[must_use]
    pub fn surface(&self, host_model: &HostModel) -> &Surface {
        self.over(host_model).map_or(self.surface, |over| &over.surface)
    }

    /// `None` where there is no shape, and once `stop` answers `true`.
    pub(super) fn prepared(
        &self,
        host_model: &HostModel,
        stop: Stop<'_>,
    ) -> Option<&PreparedSuspect> {
        let prepare = || {
            let shape = Shape::new_until(self.surface(host_model).clone(), stop);
            let prepared = shape.and_then(|shape| PreparedSuspect::new_until(shape, stop));
            go_on(stop).map(|()| prepared)
        };
        let prepared = self.over(host_model).map_or(&self.prepared, |over| &over.prepared);
        once(prepared, prepare)?.as_ref()
    }

    fn over(&self, host_model: &HostModel) -> Option<&Over> {
        let inside_out = self.faces_inward? != host_model.faces_inward?;
        let make = || Over { surface: turned_over(self.surface), prepared: OnceLock::new() };
        inside_out.then(|| self.over.get_or_init(make))
    }
}
