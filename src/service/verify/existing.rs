//! The marks of a host that is about to be marked: the ladder at its least depth.
//!
//! Looks at all live marks, whoever asks. Must not know what is done about what it finds.

use super::super::existing::Seen;
use super::super::{Service, ServiceError};
use super::Depth;
use super::charge::Charges;
use super::ladder::Found;
use crate::jobs::Stop;
use crate::mesh::Mesh;

impl Service {
    /// On the pool: the live marks that a host carries for certain (below the threshold of a
    /// match), best first.
    pub(in super::super) fn marks_on(
        &self,
        host: &Mesh,
        stop: &Stop,
    ) -> Result<Vec<Seen>, ServiceError> {
        if self.known.len() == 0 {
            return Ok(Vec::new());
        }
        let certain = self.thresholds().certain;
        let seen = |found: Found| {
            let Found { id, log10_fp, .. } = found;
            (log10_fp < certain).then_some(Seen { id, log10_fp })
        };
        match self.begin(host, (None, Charges::default()), Depth::Fast, stop) {
            Ok(begun) => Ok(begun.climb.finish().found.into_iter().filter_map(seen).collect()),
            // A surface that cannot be read cannot be marked either, and marking says why.
            Err(ServiceError::Watermark(_)) => Ok(Vec::new()),
            Err(error) => Err(error),
        }
    }
}
