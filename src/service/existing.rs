//! Marks that a host already carries: their owners, and what a request wants done about them.
//!
//! Must not know how marks are found.

use std::fmt;
use std::str::FromStr;

use uuid::Uuid;

use super::verify::Charge;
use super::{Service, ServiceError};
use crate::registry::ExistingMark;

/// What to do when the host already carries a registered mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnExisting {
    /// Refuse the request.
    Reject,
    /// Mark it, and name the found marks in the answer.
    #[default]
    Warn,
    /// Mark it, and do not name the found marks in the answer. The record names them, as always.
    Allow,
}

impl OnExisting {
    /// All values, the strictest first.
    pub const ALL: [Self; 3] = [Self::Reject, Self::Warn, Self::Allow];

    /// Its name in requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reject => "reject",
            Self::Warn => "warn",
            Self::Allow => "allow",
        }
    }

    /// Refuses if the found marks may not be there.
    pub(super) fn permits(self, found: &[CarriedMark]) -> Result<(), ServiceError> {
        if self == Self::Reject && !found.is_empty() {
            return Err(ServiceError::AlreadyMarked(found.iter().map(|seen| seen.id).collect()));
        }
        Ok(())
    }
}

impl fmt::Display for OnExisting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for OnExisting {
    type Err = &'static str;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|on_existing| on_existing.name() == name);
        named.ok_or("must be reject, warn or allow")
    }
}

/// A mark that was found on a host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CarriedMark {
    pub(super) id: Uuid,
    /// log10 of the false-positive bound, all hypotheses counted.
    pub(super) log10_fp: f64,
}

/// log10 of the bound on either of two errors, from log10 of each bound. The bound is their sum.
pub(super) fn either(a: f64, b: f64) -> f64 {
    let (more, less) = if a > b { (a, b) } else { (b, a) };
    (more + 10_f64.powf(less - more).ln_1p() / std::f64::consts::LN_10).min(0.0)
}

impl Service {
    /// The owners of these marks, and the marks that the hosts of these marks carried: those may be
    /// overwritten. A mark that was revoked in the meantime is listed too, because the host still
    /// carries it.
    pub(super) async fn owned(
        &self,
        seen: &[CarriedMark],
    ) -> Result<Vec<ExistingMark>, ServiceError> {
        let (mut marks, mut below) = (Vec::with_capacity(seen.len()), Vec::new());
        for &CarriedMark { id, log10_fp } in seen {
            let record = self.registry.record(id).await?;
            let record = record.ok_or(ServiceError::UnknownWatermark(id))?;
            // The search charged the record as if it had not been chosen.
            let charge = Charge::new(&self.registry.tally(id).await?, None, false);
            let more = charge.factor() / Charge::default().factor();
            let log10_fp = (log10_fp + libm::log10(more)).min(0.0);
            if log10_fp >= self.thresholds().certain {
                continue;
            }
            let theirs = record.existing_marks.into_iter().flatten();
            below.extend(
                theirs
                    .map(|mark| ExistingMark { log10_fp: either(mark.log10_fp, log10_fp), ..mark }),
            );
            marks.push(ExistingMark { watermark_id: id, owner_id: record.owner_id, log10_fp });
        }
        for mark in below {
            if marks.iter().all(|known| known.watermark_id != mark.watermark_id) {
                marks.push(mark);
            }
        }
        Ok(marks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_error_is_at_most_their_sum() {
        for (a, b, sum) in [(-9.0, -9.0, -8.698_970), (-300.0, -12.0, -12.0), (-0.1, -0.1, 0.0)] {
            assert!((either(a, b) - sum).abs() < 1e-6 && either(a, b) >= a.max(b), "{a} {b}");
        }
    }

    #[test]
    fn names_read_back_and_only_reject_refuses() {
        let found = [CarriedMark { id: Uuid::nil(), log10_fp: -12.0 }];
        for on_existing in OnExisting::ALL {
            assert_eq!(on_existing.to_string().parse(), Ok(on_existing));
            assert!(on_existing.permits(&[]).is_ok());
            assert_eq!(on_existing.permits(&found).is_err(), on_existing == OnExisting::Reject);
        }
        assert!("ignore".parse::<OnExisting>().is_err());
    }
}
