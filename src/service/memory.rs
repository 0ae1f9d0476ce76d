//! The memory that a job needs, computed from the counts of its mesh: a small upload may hold a
//! large mesh.
//!
//! The figures are the peak resident set of a service over generated meshes, less that of an idle
//! service (`benches/memory.sh`). The model must not be below them.

use crate::mesh::Mesh;

/// The purpose for which a mesh is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To be marked.
    Embed,
    /// To be compared with marks.
    Verify,
    /// To be inspected, with a rehearsal of the marking.
    Inspect,
    /// As the host that a suspect is compared with.
    Host,
}

/// Bytes that a comparison takes whatever the sizes: the reading of a relief at one pose
/// hypothesis.
const PER_COMPARISON: u64 = 64 << 20;

/// Most triangles of a mesh for which an inspection rehearses the marking: `forecast` does so
/// for no larger one.
const MOST_REHEARSED: u64 = 600_000;

impl Purpose {
    /// Bytes per vertex and per triangle. They were measured on closed meshes of 50,000 to 400,000
    /// vertices, with twice as many triangles. Marking took up to 966 bytes per vertex, 200 of them
    /// whatever the size. An inspection took 1,481 with a rehearsal and 162 without. A large
    /// suspect and its host together took 1,904. A host that fills its box took 2,382 together with
    /// its suspect: 262,144 vertices in 64 sheets, most of which are a node of the relief of their
    /// own.
    fn bytes(self, triangles: u64) -> [u64; 2] {
        match self {
            Self::Embed | Self::Verify => [400, 180],
            Self::Inspect if triangles <= MOST_REHEARSED => [700, 400],
            Self::Inspect => [110, 50],
            Self::Host => [900, 300],
        }
    }
}

/// Bytes that a job over a mesh needs, approximately.
pub(super) fn needed(mesh: &Mesh, purpose: Purpose) -> u64 {
    of(mesh.positions().len() as u64, mesh.triangles().len() as u64, purpose)
}

/// The same from the counts of vertices and triangles.
pub(super) fn of(vertices: u64, triangles: u64, purpose: Purpose) -> u64 {
    let [vertex, triangle] = purpose.bytes(triangles);
    let fixed = if purpose == Purpose::Verify { PER_COMPARISON } else { 0 };
    let by_size =
        vertices.saturating_mul(vertex).saturating_add(triangles.saturating_mul(triangle));
    by_size.saturating_add(fixed)
}
