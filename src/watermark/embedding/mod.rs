//! Embedding: from a codeword to moved vertices.
//!
//! In reading order: `modulate` (which norms: `power_map`, or `compliance` and `allocation` for the least
//! distortion, with margins by `budget`), `placement` and `exact` (which points), `guard` (no triangle
//! turns over), `pass` (one pass over all bins), `embed` (the closed loop).
//!
//! Must not know how marks are detected, but for the blind reader that closes the loop.

pub(in crate::watermark) mod allocation;
pub(in crate::watermark) mod budget;
pub(in crate::watermark) mod compliance;
pub(in crate::watermark) mod embed;
pub(in crate::watermark) mod exact;
pub(in crate::watermark) mod fixed_point;
pub(in crate::watermark) mod guard;
pub(in crate::watermark) mod modulate;
pub(in crate::watermark) mod pass;
pub(in crate::watermark) mod placement;
pub(in crate::watermark) mod power_map;
pub(in crate::watermark) mod sorted;

pub use embed::{Embedding, embed};
pub use pass::Host;
