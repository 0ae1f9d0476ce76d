//! Bringing a suspect into its host's coordinates, and finding the hosts worth trying.
//!
//! A suspect may be a part of the host, moved, turned, scaled, mirrored, renumbered, roughened,
//! smoothed or tessellated anew. In reading order: [`shape`] (a surface made ready), [`one_rings`]
//! and [`signatures`] (what a crop leaves untouched: the connectivity and proportions around each
//! vertex), [`similarity`] and [`consensus`] (from pairs of points to a similarity), [`vertices`]
//! (suspect vertices that are host vertices), [`refinement`] (the last digits); [`icp`], [`surfels`],
//! [`moments`], [`spin`], [`partial`], [`nearest`] and [`surface`] for what has another tessellation, [`symmetry`] for hosts that lie on
//! themselves in several ways;
//! [`prepared`] and [`alignment`] (all of it, in order); [`sketch`], [`descriptor`] and
//! [`index`] (which hosts to try).
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one, for the
//! bound on false positives rests on that: what is found here may be scored, and counts once.

pub mod alignment;
pub mod budget;
pub mod consensus;
pub mod descriptor;
pub mod gauss_newton;
pub mod icp;
pub mod index;
pub mod moments;
pub mod nearest;
pub mod one_rings;
pub mod partial;
pub mod prepared;
pub mod refinement;
pub mod samples;
pub mod shape;
pub mod signatures;
pub mod similarity;
pub mod sketch;
pub mod spin;
pub mod surface;
pub mod surfels;
pub mod symmetry;
pub mod vertices;

pub use alignment::{by_vertices, suffices};
pub use budget::{Allowed, Budget, Shares, Within};
pub use index::{GeometryIndex, Hit, Likeness};
pub use prepared::{Alignment, Basis, Effort, PreparedHost, PreparedSuspect};
pub use shape::Shape;
pub use similarity::Similarity;
pub use sketch::{Probe, Sketch};
pub use surface::{by_surface, in_place};
