//! Registration by the surface, for what has another tessellation.
//!
//! In reading order: `samples` (points that stand for a surface), `moments` (guesses for wholes), `spin` and
//! `partial` (guesses for parts), `surfels` and `nearest` (closest points), `icp` with `gauss_newton`
//! (trimmed alignment), `surface` (all of it, in order), `symmetry` (hosts that lie on themselves in several
//! ways).

pub mod gauss_newton;
pub mod icp;
pub mod moments;
pub mod nearest;
pub mod partial;
pub mod samples;
pub mod spin;
pub mod surface;
pub mod surfels;
pub mod symmetry;
