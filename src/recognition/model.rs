//! Hosts and suspects made ready for each other. What a comparison needs is built when first used.

use std::sync::OnceLock;

use crate::mesh::Mesh;
use crate::mesh::facing::{faces_inward, turned_over};
use crate::mesh::stop::{Stop, go_on, once, unstopped};
use crate::mesh::surface::Surface;
use crate::registration::{PreparedHost, PreparedSuspect, Shape};
use crate::relief::ReliefHost;

/// A host made ready for suspects. Keep it between suspects.
pub struct HostModel {
    mesh: Mesh,
    surface: Surface,
    faces_inward: Option<bool>,
    prepared: OnceLock<Option<PreparedHost>>,
    relief: OnceLock<Option<ReliefHost>>,
}

impl HostModel {
    /// Makes a host ready from its geometry.
    #[must_use]
    pub fn new(mesh: Mesh) -> Self {
        unstopped(|stop| Self::new_until(mesh, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(mesh: Mesh, stop: Stop<'_>) -> Option<Self> {
        let surface = Surface::new_until(&mesh, stop)?;
        let (faces_inward, prepared) = (faces_inward(&surface), OnceLock::new());
        Some(Self { mesh, surface, faces_inward, prepared, relief: OnceLock::new() })
    }

    /// The geometry of the file.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The host's surface with its carrier vertices.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// About how many bytes the model takes in memory, with everything that is built from it.
    #[must_use]
    pub fn bytes(&self) -> usize {
        // Positions, normals, one-rings, signatures and the search tree, as measured on the dragon.
        const VERTEX: usize = 420;
        const TRIANGLE: usize = 320;
        self.mesh.positions().len() * VERTEX + self.mesh.triangles().len() * TRIANGLE
    }

    /// The host made ready for reading its relief; `None` where its surface has none, and once
    /// `stop` returns `true`.
    pub fn relief(&self, stop: Stop<'_>) -> Option<&ReliefHost> {
        let prepare = || {
            let prepared = ReliefHost::new_until(self.surface.clone(), stop);
            go_on(stop).map(|()| prepared)
        };
        once(&self.relief, prepare)?.as_ref()
    }

    /// `None` where there is no shape, and once `stop` returns `true`.
    pub(super) fn prepared(&self, stop: Stop<'_>) -> Option<&PreparedHost> {
        let prepare = || {
            let shape = Shape::new_until(self.surface.clone(), stop);
            let prepared = shape.and_then(|shape| PreparedHost::new_until(shape, stop));
            go_on(stop).map(|()| prepared)
        };
        once(&self.prepared, prepare)?.as_ref()
    }
}

/// A suspect made ready for hosts.
pub struct SuspectModel<'a> {
    mesh: &'a Mesh,
    surface: &'a Surface,
    faces_inward: Option<bool>,
    prepared: OnceLock<Option<PreparedSuspect>>,
    /// The suspect with its triangles flipped.
    flipped: OnceLock<Flipped>,
}

struct Flipped {
    surface: Surface,
    prepared: OnceLock<Option<PreparedSuspect>>,
}

impl<'a> SuspectModel<'a> {
    /// Makes a suspect ready from its mesh and its surface.
    #[must_use]
    pub fn new(mesh: &'a Mesh, surface: &'a Surface) -> Self {
        let (faces_inward, prepared) = (faces_inward(surface), OnceLock::new());
        Self { mesh, surface, faces_inward, prepared, flipped: OnceLock::new() }
    }

    /// The geometry of the file.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        self.mesh
    }

    /// The suspect's surface with its carrier vertices. Its triangles face as the host's do where
    /// both have an inside.
    #[must_use]
    pub fn surface(&self, host_model: &HostModel) -> &Surface {
        self.flipped(host_model).map_or(self.surface, |flipped| &flipped.surface)
    }

    /// `None` where there is no shape, and once `stop` returns `true`.
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
        let prepared = self.flipped(host_model).map_or(&self.prepared, |flipped| &flipped.prepared);
        once(prepared, prepare)?.as_ref()
    }

    fn flipped(&self, host_model: &HostModel) -> Option<&Flipped> {
        let inside_out = self.faces_inward? != host_model.faces_inward?;
        let make = || Flipped { surface: turned_over(self.surface), prepared: OnceLock::new() };
        inside_out.then(|| self.flipped.get_or_init(make))
    }
}
