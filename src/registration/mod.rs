//! Bringing a suspect into its host's coordinates, and finding the hosts worth trying.
//!
//! A suspect may be a part of the host, moved, turned, scaled, mirrored, renumbered, roughened,
//! smoothed or tessellated anew. In reading order: [`shape`] (a surface made ready), [`similarity`],
//! [`by_vertices`](mod@by_vertices) and [`by_surface`](mod@by_surface) (the two ways), [`prepared`] (what is made once per host or suspect),
//! [`budget`] (work that is counted), [`retrieval`] (which hosts to try).
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one, for the
//! bound on false positives rests on that: what is found here may be scored, and counts once.

pub mod budget;
pub mod by_surface;
pub mod by_vertices;
pub mod prepared;
pub mod retrieval;
pub mod shape;
pub mod similarity;

pub use budget::{Allowed, Budget, Shares, Within};
pub use by_surface::surface::{by_surface, in_place};
pub use by_vertices::alignment::{by_vertices, suffices};
pub use prepared::{Alignment, Basis, Effort, PreparedHost, PreparedSuspect};
pub use retrieval::index::{GeometryIndex, Hit, Likeness};
pub use retrieval::sketch::{Probe, Sketch};
pub use shape::Shape;
pub use similarity::Similarity;
