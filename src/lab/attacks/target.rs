//! The mesh that is attacked, and what several attacks want to know of it: each made when it is
//! first asked for, once for all attacks on the mesh.

use std::cell::OnceCell;

use super::AttackError;
use super::edges::Edges;
use super::smooth::Rings;
use crate::mesh::Mesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::surface::Surface;

/// A mesh to be attacked.
///
/// Not `Sync`, and meant so: what is made at first need may be made by several threads, and one that
/// waits for the others may take up another task meanwhile, which must not wait for the same thing.
pub struct Target<'a> {
    mesh: &'a Mesh,
    surface: OnceCell<Surface>,
    edges: OnceCell<Edges>,
    around: OnceCell<Adjacency>,
    rings: OnceCell<Rings>,
    stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl<'a> Target<'a> {
    /// Of a mesh; nothing is made yet.
    #[must_use]
    pub fn new(mesh: &'a Mesh) -> Self {
        Self {
            mesh,
            surface: OnceCell::new(),
            edges: OnceCell::new(),
            around: OnceCell::new(),
            rings: OnceCell::new(),
            stop: None,
        }
    }

    /// Of a mesh, as long as `stop` answers `false`.
    #[must_use]
    pub fn until(mesh: &'a Mesh, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { stop: Some(stop), ..Self::new(mesh) }
    }

    /// Of what an attack left, under the same `stop`.
    pub(super) fn same_stop<'b>(&'b self, mesh: &'b Mesh) -> Target<'b> {
        Target {
            stop: self.stop.map(|stop| stop as &(dyn Fn() -> bool + Sync)),
            ..Target::new(mesh)
        }
    }

    /// Asked in attacks that take long.
    ///
    /// # Errors
    /// [`AttackError::Stopped`].
    pub(super) fn go_on(&self) -> Result<(), AttackError> {
        if self.stop.is_some_and(|stop| stop()) { Err(AttackError::Stopped) } else { Ok(()) }
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &'a Mesh {
        self.mesh
    }

    /// The welded surface, also where no triangle has an area.
    pub(super) fn welded(&self) -> &Surface {
        self.surface.get_or_init(|| Surface::new(self.mesh))
    }

    /// The welded surface.
    ///
    /// # Errors
    /// [`AttackError::NoSurface`] when no triangle has an area.
    pub fn surface(&self) -> Result<&Surface, AttackError> {
        let surface = self.welded();
        self.go_on()?;
        if surface.triangles.is_empty() { Err(AttackError::NoSurface) } else { Ok(surface) }
    }

    /// The edges of the surface.
    pub(super) fn edges(&self) -> &Edges {
        self.edges.get_or_init(|| Edges::new(&self.welded().triangles))
    }

    /// The triangles around each vertex of the surface.
    pub(super) fn around(&self) -> &Adjacency {
        let of = |surface: &Surface| Adjacency::new(surface.positions.len(), &surface.triangles);
        self.around.get_or_init(|| of(self.welded()))
    }

    /// Whom each vertex of the surface is averaged with.
    pub(super) fn rings(&self) -> &Rings {
        self.rings.get_or_init(|| Rings::new(self.welded(), self.edges(), self.around()))
    }
}
