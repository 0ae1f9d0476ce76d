//! Uniform remeshing.

mod dynamic;
mod ground;
mod passes;

use super::{AttackError, Target};
use crate::mesh::Mesh;
use dynamic::Dynamic;
use ground::Ground;

/// Parameters of remeshing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Remeshing {
    /// Vertices of the result as a share of the carrier vertices before.
    pub share: f64,
    /// Rounds of split, collapse, flip, relax and project.
    pub rounds: usize,
    /// Edges whose triangles meet at more than this angle (degrees) are features: they stay edges,
    /// as borders do.
    pub crease_degrees: f64,
}

impl Remeshing {
    /// To a share of the vertices, with ten rounds and creases from 30 degrees (`MeshLab`'s
    /// defaults).
    #[must_use]
    pub fn to_share(share: f64) -> Self {
        Self { share, rounds: 10, crease_degrees: 30.0 }
    }
}

/// Exponent of the correction of the goal length, per round, from the number of vertices. Edges
/// follow their goal only after some rounds, and a full correction would oscillate.
const CORRECTION: f64 = 0.35;

/// Replaces the triangles by nearly equilateral ones of one size, with `share` of the vertices
/// (Botsch and Kobbelt, *A remeshing approach to multiresolution modeling*, SGP 2004). Edges longer
/// than 4/3 of a goal length are split, and edges shorter than 4/5 are collapsed. Edges are flipped
/// towards six neighbours per vertex. Vertices are relaxed along the surface and projected onto the
/// original one. The goal length follows from the area and the number of vertices. It is corrected
/// each round by the number that resulted.
///
/// Luo and Bors 2009, fig. 9, resample uniformly to shares of 1.0 to 0.2 with another program
/// (Attene and Falcidieno, *`ReMESH`*, SMI 2006).
///
/// # Errors
/// [`AttackError::NoSurface`], or [`AttackError::Mesh`] when nothing is left.
pub fn remesh(target: &Target<'_>, how: &Remeshing) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let old = Ground::new(surface, target.around()?);
    let goal_count = (how.share * surface.positions.len() as f64).max(4.0);
    let mut now = Dynamic::new(surface, target.edges()?, how.crease_degrees);
    // Two triangles of area sqrt(3)/4 l^2 per vertex.
    let mut length = (2.0 * now.area() / (3_f64.sqrt() * goal_count)).sqrt();
    for _ in 0..how.rounds {
        passes::split(&mut now, 4.0 / 3.0 * length);
        passes::collapse(&mut now, 0.8 * length, 4.0 / 3.0 * length);
        passes::flip(&mut now);
        passes::relax(&mut now, &old);
        length *= libm::pow(now.vertices() as f64 / goal_count, CORRECTION);
    }
    now.finish()
}
