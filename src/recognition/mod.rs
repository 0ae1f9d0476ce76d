//! Recognition: a suspect compared with one host, as if it were that host or a part of it.
//!
//! A pose hypothesis is an assumption about where the suspect lies in the host's coordinates, and
//! which of its vertices correspond to which of the host's. Each pose hypothesis gives two
//! readings: the bins in the host's own frame ([`PoseHypothesis::frame_of`]) and the matched filter
//! ([`crate::watermark::HostFilter`]). Inexpensive pose hypotheses come first.
//!
//! Pure. Pose hypotheses follow from the two shapes alone. Must not know codewords or anything that
//! depends on one. Each pose hypothesis that is scored is counted, and the bound rests on its being
//! chosen blindly.

mod agreement;
mod model;
mod pose;
mod relief;

pub use agreement::share_on;
pub use model::{HostModel, SuspectModel};
pub use pose::{PoseHypothesis, PoseKind, poses};
pub use relief::{ReliefFound, relief_at, relief_of};
