//! Detection: from a suspect to soft bits, scores and bounds.
//!
//! In reading order: `suspect` and `profile` (sorted norms), `extract` (bits without expectation), `soft`
//! (bits with weights), `bound` (the exact tail of a score, rounded so that it is never below the truth),
//! `index` (many codewords at once), `synchronise` (where the bins of a damaged file lie), `matched` (vertex
//! by vertex against a host).
//!
//! Nothing that enters a weight may depend on a codeword: the bound rests on that.

pub(in crate::watermark) mod bound;
pub(in crate::watermark) mod extract;
pub(in crate::watermark) mod index;
pub(in crate::watermark) mod matched;
pub(in crate::watermark) mod profile;
pub(in crate::watermark) mod soft;
pub(in crate::watermark) mod suspect;
pub(in crate::watermark) mod synchronise;

pub use bound::{Tail, least_chernoff_score, least_score, log10_chernoff, log10_tail};
pub use extract::{Extraction, Reading, extract, extract_from_surface, extract_until};
pub use index::{Candidate, CodewordIndex, GroupKey, Hypothesis, ReportLimits, Search};
pub use matched::{Comparison, Correspondence, HostFilter};
pub use profile::Profile;
pub use soft::{Score, SoftBits};
pub use suspect::Suspect;
pub use synchronise::{LayoutEffort, Layouts, synchronise, synchronise_until};
