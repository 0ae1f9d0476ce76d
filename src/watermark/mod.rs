//! The watermark: from keys to codewords, from codewords to moved vertices, and back.
//!
//! Pure and deterministic to the bit on any number of threads. This module must not know about files,
//! HTTP, the registry, clocks or random sources. Keys and messages come in as values.

mod allocation;
pub mod bins;
mod bound;
mod budget;
mod capacity;
mod codeword;
mod compliance;
mod embed;
mod error;
mod exact;
mod extract;
mod fixed_point;
mod guard;
mod index;
mod matched;
mod modulate;
mod params;
mod pass;
mod placement;
mod power_map;
mod profile;
mod soft;
mod sorted;
mod suspect;
mod synchronise;

pub use bins::Frame;
pub use bound::{Tail, least_chernoff_score, least_score, log10_chernoff, log10_tail};
pub use capacity::needed_bins;
pub use codeword::{Codeword, LAYOUT_CLASSES, MarkKey, Message, Schedule};
pub use embed::{Embedding, embed};
pub use error::WatermarkError;
pub use extract::{Extraction, Reading, extract, extract_from_surface, extract_until};
pub use index::{Candidate, CodewordIndex, GroupKey, Hypothesis, Search, Worth};
pub use matched::{Comparison, Correspondence, HostFilter};
pub use params::{BitCount, EmbedParams, Method, Modulation, Placement, Shaping, Strength};
pub use pass::Host;
pub use profile::Profile;
pub use soft::{Score, SoftBits};
pub use suspect::Suspect;
pub use synchronise::{LayoutEffort, Layouts, synchronise, synchronise_until};
