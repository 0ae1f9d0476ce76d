//! The relief: a second layer of the mark, which lies in the surface itself (method section 8).
//!
//! Every carrier moves a little along the normal of the host, by a smooth field whose sign in each cell
//! of a cubic grid is drawn from the mark key. The field is read against the kept host, from any
//! vertices and triangles of the suspect.
//!
//! Pure. Must not know about files, records, registration or the blind layer; suspects come in the
//! host's coordinates. No weight may depend on a sign, because the bound rests on that.

mod cells;
mod estimate;
mod field;
mod heights;
mod host;
mod params;
mod reading;
mod refine;
mod regress;
mod signs;
mod smoothing;

pub use field::{CELL, Field, Share};
pub use heights::Work;
pub use host::ReliefHost;
pub use params::{Amplitude, Layers};
pub use reading::ReliefReading;
pub use signs::Signs;
