//! Bringing a suspect into its host's coordinates, and finding the hosts worth trying.
//!
//! A suspect may be a part of the host, moved, turned, scaled, mirrored, renumbered, roughened,
//! smoothed or tessellated anew. In reading order: [`shape`] (a surface made ready), [`rings`]
//! and [`codes`] (what a crop leaves untouched: the connectivity and proportions around each
//! vertex), [`similarity`] and [`consensus`] (from pairs of points to a similarity), [`twins`]
//! (suspect vertices that are host vertices).
//!
//! Pure: knows geometry alone. Must not know codewords or anything that depends on one, for the
//! bound on false positives rests on that: what is found here may be scored, and counts once.

pub mod codes;
pub mod consensus;
pub mod linear;
pub mod newton;
pub mod polish;
pub mod rings;
pub mod shape;
pub mod similarity;
pub mod twins;
