//! Registration by vertices that suspect and host share: a crop, noise, smoothing and quantisation keep the
//! connectivity around a vertex.
//!
//! In reading order: `one_rings` and `signatures` (the connectivity and proportions around each vertex),
//! `consensus` (from pairs of points to a similarity), `vertices` (suspect vertices that are host vertices),
//! `refinement` (the last digits), `alignment` (the result, and whether it leaves nothing to search for).

pub mod alignment;
pub mod consensus;
pub mod one_rings;
pub mod refinement;
pub mod signatures;
pub mod vertices;
