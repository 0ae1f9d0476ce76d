//! Bringing a suspect into its host's coordinates, and finding the hosts worth trying.
//!
//! A suspect may be a part of the host, moved, turned, scaled, mirrored, renumbered, roughened,
//! smoothed or tessellated anew. In reading order: [`shape`] (a surface made ready), [`rings`]
//! and [`codes`] (what a crop leaves untouched: the connectivity and proportions around each
//! vertex), [`similarity`] and [`consensus`] (from pairs of points to a similarity), [`twins`]
//! (suspect vertices that are host vertices), [`polish`] (the last digits); [`align`], [`discs`],
//! [`moments`], [`spin`], [`parts`], [`nearest`] and [`surface`] for what has another tessellation, [`symmetry`] for hosts that lie on
//! themselves in several ways;
//! [`prepared`] and [`register`](mod@register) (all of it, in order); [`sketch`], [`outline`] and
//! [`index`] (which hosts to try).
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one, for the
//! bound on false positives rests on that: what is found here may be scored, and counts once.

pub mod align;
pub mod budget;
pub mod codes;
pub mod consensus;
pub mod discs;
pub mod index;
pub mod moments;
pub mod nearest;
pub mod newton;
pub mod outline;
pub mod parts;
pub mod polish;
pub mod prepared;
pub mod register;
pub mod rings;
pub mod scatter;
pub mod shape;
pub mod similarity;
pub mod sketch;
pub mod spin;
pub mod surface;
pub mod symmetry;
pub mod twins;

pub use budget::{Allowed, Budget, Shares, Within};
pub use index::{GeometryIndex, Hit, Likeness};
pub use prepared::{Alignment, Basis, Effort, PreparedHost, PreparedSuspect};
pub use register::{by_twins, register, suffices};
pub use shape::Shape;
pub use similarity::Similarity;
pub use sketch::{Probe, Sketch};
pub use surface::{by_surface, in_place};
