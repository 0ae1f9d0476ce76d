//! Overmarks: when a request asks about an older mark only, it does not ask about the marks laid
//! over that one. These are searched for all the same, in the blind frame, because their records
//! may name the older mark.

use super::super::ServiceError;
use super::super::verdict::{StageName, Thresholds};
use super::blind::Blind;
use super::cascade::{Cascade, Case, Found, Stage};
use super::charge::Charges;
use super::count::counted;
use crate::watermark::CodewordIndex;

/// The marks of `all` that match, best first. Notes in `cascade` how many hypotheses were scored.
pub(super) fn overmarks(
    case: &Case<'_>,
    all: &CodewordIndex,
    thresholds: Thresholds,
    cascade: &mut Cascade,
) -> Result<Vec<Found>, ServiceError> {
    let name = StageName::Overmarks;
    let mut later = Cascade::new(thresholds, Charges::default());
    let everybody = Case { marks: all, named: None, ..*case };
    let tried = Blind.run(&everybody, later.worth(counted(name, 1)))?;
    cascade.tried(name, tried.hypotheses);
    for candidate in tried.candidates {
        later.add(name, Blind.frame(), candidate, counted(name, tried.hypotheses));
    }
    let certain = |found: &Found| found.log10_fp < thresholds.certain;
    Ok(later.finish().found.into_iter().filter(certain).collect())
}
