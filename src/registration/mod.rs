//! Registration: brings a suspect into its host's coordinates, and finds the hosts worth trying.
//!
//! A suspect may be a part of its host. It may be moved, rotated, scaled, mirrored, renumbered,
//! made noisy, smoothed or tessellated anew. In reading order:
//!
//! - [`shape`] makes a surface ready; [`one_rings`] and [`signatures`] describe the connectivity
//!   and the proportions around each vertex, which a crop leaves as they are;
//! - [`similarity`] and [`consensus`] go from pairs of points to a similarity; [`vertices`] finds
//!   suspect vertices that are host vertices; [`refinement`] adds the last digits;
//! - [`samples`], [`icp`], [`gauss_newton`], [`surfels`], [`moments`], [`spin`], [`partial`],
//!   [`nearest`] and [`surface`] align suspects with another tessellation;
//! - [`symmetry`] finds the rotations that map a host onto itself;
//! - [`budget`] bounds the work; [`prepared`] and [`alignment`] put all of it together;
//! - [`sketch`], [`descriptor`] and [`index`] find the hosts to try.
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one. The bound
//! on false positives rests on that: a pose that is found here may be scored, and counts once.

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
