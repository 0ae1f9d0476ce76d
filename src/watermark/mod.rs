//! The watermark: from keys to codewords, from codewords to moved vertices, and back.
//!
//! Pure and deterministic to the bit on any number of threads. This module must not know about files,
//! HTTP, the registry, clocks or random sources. Keys and messages come in as values.

pub mod bins;
mod capacity;
mod codeword;
mod detection;
mod embedding;
mod error;
mod params;

pub use bins::Frame;
pub use capacity::needed_bins;
pub use codeword::{Codeword, LAYOUT_CLASSES, MarkKey, Message, Schedule};
pub use detection::*;
pub use embedding::*;
pub use error::WatermarkError;
pub use params::{BitCount, EmbedParams, Method, Modulation, Placement, Shaping, Strength};
