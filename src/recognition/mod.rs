//! Recognition: a suspect looked at as if it were (a part of) one host.
//!
//! A look is an assumption about where the suspect lies in the host's coordinates and which of its
//! vertices is which of the host's. From each look follow two readings: the bins in the host's own
//! frame ([`Look::frame_of`]) and the matched filter ([`crate::watermark::HostFilter`]). The cheap
//! looks come first.
//!
//! Pure. Looks follow from the two shapes alone: must not know codewords, or anything that depends
//! on one, for each look that is scored is counted, and the bound rests on its being chosen blindly.

mod agreement;
mod home;
mod look;
mod relief;

pub use agreement::share_on;
pub use home::{Home, Visitor};
pub use look::{Look, LookKind, looks};
pub use relief::{ReliefFound, relief_at, relief_of};
