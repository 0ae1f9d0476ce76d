//! The mesh that is attacked, with structures that several attacks need. Each structure is made at
//! first use, once for all attacks on the mesh.

use std::cell::OnceCell;

use super::AttackError::{self, Stopped};
use super::edges::Edges;
use super::smooth::Rings;
use crate::mesh::Mesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::stop::{Stop, go_on, never};
use crate::mesh::surface::Surface;

/// A mesh to be attacked.
///
/// It is not `Sync`, on purpose. Several threads may make a structure together. A thread that waits
/// for the others may take up another task, and that task must not wait for the same structure.
pub struct Target<'a> {
    mesh: &'a Mesh,
    surface: OnceCell<Surface>,
    edges: OnceCell<Edges>,
    around: OnceCell<Adjacency>,
    rings: OnceCell<Rings>,
    stop: Stop<'a>,
}

impl<'a> Target<'a> {
    /// A target for a mesh. No structure is made yet.
    #[must_use]
    pub fn new(mesh: &'a Mesh) -> Self {
        Self {
            mesh,
            surface: OnceCell::new(),
            edges: OnceCell::new(),
            around: OnceCell::new(),
            rings: OnceCell::new(),
            stop: &never,
        }
    }

    /// A target for a mesh, whose attacks end once `stop` returns `true`.
    #[must_use]
    pub fn until(mesh: &'a Mesh, stop: Stop<'a>) -> Self {
        Self { stop, ..Self::new(mesh) }
    }

    /// A target for the result of an attack, with the same `stop`.
    pub(super) fn same_stop<'b>(&'b self, mesh: &'b Mesh) -> Target<'b> {
        Target::until(mesh, self.stop)
    }

    /// Called in attacks that take long, to end them once `stop` returns `true`.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn go_on(&self) -> Result<(), AttackError> {
        go_on(self.stop).ok_or(Stopped)
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &'a Mesh {
        self.mesh
    }

    /// The welded surface, even if no triangle has an area.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn welded(&self) -> Result<&Surface, AttackError> {
        once(&self.surface, || Surface::new_until(self.mesh, self.stop).ok_or(Stopped))
    }

    /// The welded surface.
    ///
    /// # Errors
    /// [`AttackError::NoSurface`] when no triangle has an area; [`AttackError::Stopped`].
    pub fn surface(&self) -> Result<&Surface, AttackError> {
        let surface = self.welded()?;
        self.go_on()?;
        if surface.triangles.is_empty() { Err(AttackError::NoSurface) } else { Ok(surface) }
    }

    /// The edges of the surface.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn edges(&self) -> Result<&Edges, AttackError> {
        once(&self.edges, || Edges::new_until(&self.surface()?.triangles, self.stop).ok_or(Stopped))
    }

    /// The triangles around each vertex of the surface.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn around(&self) -> Result<&Adjacency, AttackError> {
        once(&self.around, || {
            let surface = self.surface()?;
            let (vertices, triangles) = (surface.positions.len(), &surface.triangles);
            Adjacency::new_until(vertices, triangles, self.stop).ok_or(Stopped)
        })
    }

    /// For each vertex of the surface, the vertices that it is averaged with.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn rings(&self) -> Result<&Rings, AttackError> {
        once(&self.rings, || Ok(Rings::new(self.surface()?, self.edges()?, self.around()?)))
    }
}

/// The content of a cell, made at first use. A failure is not stored.
fn once<T>(
    cell: &OnceCell<T>,
    make: impl FnOnce() -> Result<T, AttackError>,
) -> Result<&T, AttackError> {
    if let Some(made) = cell.get() {
        return Ok(made);
    }
    let made = make()?;
    Ok(cell.get_or_init(|| made))
}
