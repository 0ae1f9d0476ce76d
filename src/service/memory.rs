//! Memory that a job needs, from what was found in its file: a small upload may be a large mesh.
//!
//! Measured as the peak resident set of a service over generated meshes, beyond that of an idle one
//! (`benches/memory.sh`); the model must not be below it.

use crate::mesh::Mesh;

/// What a mesh is read for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To be marked.
    Embed,
    /// To be compared with marks.
    Verify,
    /// To be looked at, with a mark rehearsed.
    Inspect,
    /// As a host that a suspect is compared with.
    Host,
}

/// Bytes that a comparison takes whatever the sizes: what is read of a relief at one pose hypothesis.
const PER_COMPARISON: u64 = 64 << 20;

/// Triangles up to which an inspection rehearses a mark: `forecast` looks at no more.
const MOST_REHEARSED: u64 = 600_000;

impl Purpose {
    /// Bytes per vertex and per triangle. On closed meshes of 50,000 to 400,000 vertices, which have
    /// twice as many triangles, marking took up to 966 bytes per vertex, 200 of them whatever the size, an
    /// inspection with a rehearsal 1,481 and without 162, and suspect and host together 1,904 where they
    /// are large. A host that fills its box (262,144 vertices in 64 sheets: most vertices are a node of
    /// the relief of their own) took 2,382 with its suspect.
    fn bytes(self, triangles: u64) -> [u64; 2] {
        match self {
            Self::Embed | Self::Verify => [400, 180],
            Self::Inspect if triangles <= MOST_REHEARSED => [700, 400],
            Self::Inspect => [110, 50],
            Self::Host => [900, 300],
        }
    }
}

/// Bytes that a job over a mesh needs, about.
pub(super) fn needed(mesh: &Mesh, purpose: Purpose) -> u64 {
    of(mesh.positions().len() as u64, mesh.triangles().len() as u64, purpose)
}

/// The same by its counts.
pub(super) fn of(vertices: u64, triangles: u64, purpose: Purpose) -> u64 {
    let [vertex, triangle] = purpose.bytes(triangles);
    let fixed = if purpose == Purpose::Verify { PER_COMPARISON } else { 0 };
    let by_size =
        vertices.saturating_mul(vertex).saturating_add(triangles.saturating_mul(triangle));
    by_size.saturating_add(fixed)
}
