//! The relief of a host's marks, read from a suspect at a pose hypothesis.
//!
//! One reading serves all records of the host. The weights follow from suspect and host alone; each
//! record then costs one sum over the signs of its key.

use std::ops::ControlFlow;
use std::sync::Arc;

use rayon::prelude::*;

use super::super::ServiceError;
use super::super::known::mark_key;
use super::super::verdict::StageName;
use super::cascade::{Cascade, MOST_MATCHES};
use super::go_on;
use super::host_search::{CandidateHost, HostSearch};
use super::recipients::PoseContext;
use crate::recognition::{PoseHypothesis, SuspectModel, relief_at};
use crate::registry::Record;
use crate::relief::Signs;
use crate::watermark::{Candidate, Hypothesis, Score, SoftBits};

/// Scores the records of a host that have a relief; breaks when no further pose hypothesis is
/// needed.
pub(super) fn read(
    search: &HostSearch<'_>,
    candidate_host: &CandidateHost,
    (suspect_model, pose): (&SuspectModel<'_>, &PoseHypothesis),
    seen: &PoseContext<'_>,
    cascade: &mut Cascade,
) -> Result<ControlFlow<()>, ServiceError> {
    let asked = |record: &&Record| candidate_host.is_asked(record.id.as_u128());
    let with_relief = |record: &&Record| record.amplitude.is_some();
    let records: Vec<&Record> =
        candidate_host.records.iter().filter(asked).filter(with_relief).collect();
    // Marks of one host nearly always have the same amplitude. For a mark with another amplitude
    // the weights are less suitable, but not wrong.
    let Some(amplitude) = records.first().and_then(|record| record.amplitude) else {
        return Ok(ControlFlow::Continue(()));
    };
    let reading =
        relief_at(&candidate_host.host_model, suspect_model, pose, amplitude, seen.within);
    go_on(search.stop)?;
    cascade.tried(StageName::Relief, records.len() as u64);
    let Some(reading) = reading else { return Ok(ControlFlow::Continue(())) };
    let counted = (seen.counted)(StageName::Relief);
    let Some(least) = reading.least_score(cascade.worth(counted).log10_bound) else {
        return Ok(ControlFlow::Continue(()));
    };
    let cells = reading.signed_weights().len();
    let score = |record: &&Record| {
        let key = mark_key(search.keys, &record.key_id, &record.salt, &record.owner_id).ok()?;
        let signs = Signs::new(&key, cells);
        let t = reading.score(&signs);
        (t >= least).then(|| {
            let (bits_read, bits_agreeing) = reading.agreeing(&signs);
            (record.id.as_u128(), Score { t, bits_agreeing, bits_read })
        })
    };
    let mut scores: Vec<(u128, Score)> =
        records.par_iter().with_min_len(64).filter_map(score).collect();
    scores.sort_by(|a, b| b.1.t.total_cmp(&a.1.t).then(a.0.cmp(&b.0)));
    let soft = Arc::new(SoftBits::from_signed(reading.signed_weights().to_vec()));
    for (id, score) in scores.into_iter().take(MOST_MATCHES) {
        let hypothesis = Hypothesis { frame: seen.frame, soft: soft.clone() };
        let log10_bound = reading.log10_bound(score.t);
        let candidate = Candidate { id, log10_bound, score, hypothesis };
        cascade.add(StageName::Relief, seen.name, candidate, counted);
    }
    Ok(if cascade.is_open() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
}
