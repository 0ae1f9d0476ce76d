//! Registration: brings a suspect into its host's coordinates, and finds the hosts worth trying.
//!
//! A suspect may be a part of its host. It may be moved, rotated, scaled, mirrored, renumbered,
//! made noisy, smoothed or tessellated anew. In reading order:
//!
//! - [`shape`] makes a surface ready; [`similarity`] is what is looked for;
//! - [`by_vertices`](mod@by_vertices) finds suspect vertices that are host vertices;
//! - [`by_surface`](mod@by_surface) aligns suspects with another tessellation;
//! - [`prepared`] is what is made once per host or suspect; [`budget`] bounds the work;
//! - [`retrieval`] finds the hosts to try.
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one. The bound
//! on false positives rests on that: a pose that is found here may be scored, and counts once.

pub mod budget;
pub mod by_surface;
pub mod by_vertices;
pub mod prepared;
pub mod retrieval;
pub mod shape;
pub mod similarity;

pub use budget::{Allowed, Budget, Shares, WorkLimits};
pub use by_surface::surface::{by_surface, in_place};
pub use by_vertices::alignment::{by_vertices, suffices};
pub use prepared::{Alignment, Basis, Effort, PreparedHost, PreparedSuspect};
pub use retrieval::index::{GeometryIndex, Hit, Likeness};
pub use retrieval::sketch::{Probe, Sketch};
pub use shape::Shape;
pub use similarity::Similarity;
