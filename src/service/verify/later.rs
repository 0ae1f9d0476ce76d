//! Later marks: where the request asks about an older mark only, those laid over it are not asked
//! about. They are looked for all the same, in the blind frame, because their records may name the one
//! that is.

use super::super::ServiceError;
use super::super::verdict::{StageName, Thresholds};
use super::blind::Blind;
use super::charge::Charges;
use super::count::counted;
use super::ladder::{Case, Climb, Found, Stage};
use crate::watermark::CodewordIndex;

/// The marks that match, of `all`, best first; notes in `climb` how many were tried.
pub(super) fn later_marks(
    case: &Case<'_>,
    all: &CodewordIndex,
    thresholds: Thresholds,
    climb: &mut Climb,
) -> Result<Vec<Found>, ServiceError> {
    let name = StageName::LaterMarks;
    let mut later = Climb::new(thresholds, Charges::default());
    let everybody = Case { marks: all, named: None, ..*case };
    let tried = Blind.run(&everybody, later.worth(counted(name, 1)))?;
    climb.tried(name, tried.hypotheses);
    for candidate in tried.candidates {
        later.add(name, Blind.frame(), candidate, counted(name, tried.hypotheses));
    }
    let certain = |found: &Found| found.log10_fp < thresholds.certain;
    Ok(later.finish().found.into_iter().filter(certain).collect())
}
