//! Which hosts of a registry are worth trying.
//!
//! In reading order: `descriptor` (of a whole shape), `sketch` (that, and hashes of vertex neighbourhoods),
//! `index` (many sketches in memory).

pub mod descriptor;
pub mod index;
pub mod sketch;
