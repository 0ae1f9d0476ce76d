//! Recognition: a suspect looked at as if it were (a part of) one host.
//!
//! A pose hypothesis is an assumption about where the suspect lies in the host's coordinates and which of its
//! vertices is which of the host's. From each pose hypothesis follow two readings: the bins in the host's own
//! frame ([`PoseHypothesis::frame_of`]) and the matched filter ([`crate::watermark::HostFilter`]). The cheap
//! ones come first.
//!
//! Pure. Looks follow from the two shapes alone: must not know codewords, or anything that depends
//! on one, for each pose hypothesis that is scored is counted, and the bound rests on its being chosen blindly.

mod agreement;
mod model;
mod pose;
mod relief;

pub use agreement::share_on;
pub use model::{HostModel, SuspectModel};
pub use pose::{PoseHypothesis, PoseKind, poses};
pub use relief::{ReliefFound, relief_at, relief_of};
