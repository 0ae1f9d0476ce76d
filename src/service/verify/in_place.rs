//! The host's own frame, for marks that the request names. A suspect that was neither moved nor
//! scaled can be read there even when half of it has been cut away.

use std::sync::Arc;

use super::super::ServiceError;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::cascade::{Case, MOST_MATCHES, Stage, Tried};
use super::go_on;
use super::named::Named;
use crate::keys::KeyRing;
use crate::registry::Record;
use crate::watermark::{Candidate, Hypothesis, ReportLimits, Suspect};

/// Most records that are scored, those with the last ids first. Each costs one pass over the norms.
const MOST_RECORDS: usize = 1_000;

pub(super) struct InPlace;

impl Stage for InPlace {
    fn name(&self) -> StageName {
        StageName::InPlace
    }

    fn frame(&self) -> FrameName {
        FrameName::InPlace
    }

    fn run(&self, case: &Case<'_>, worth: ReportLimits) -> Result<Tried, ServiceError> {
        let mut tried = Tried::default();
        let records = case.named.map(Named::records).unwrap_or_default();
        for record in records.iter().rev().take(MOST_RECORDS) {
            go_on(case.stop)?;
            let candidate = score(case.suspect, record, case.keys)?;
            tried.hypotheses += 1;
            tried.candidates.extend(Some(candidate).filter(|c| c.log10_bound <= worth.log10_bound));
        }
        tried.candidates.sort_by(|a, b| a.log10_bound.total_cmp(&b.log10_bound));
        tried.candidates.truncate(MOST_MATCHES);
        Ok(tried)
    }
}

fn score(suspect: &Suspect, record: &Record, keys: &KeyRing) -> Result<Candidate, ServiceError> {
    let codeword = codeword(keys, &record.source())?;
    let modulation = record.method.modulation();
    let soft = suspect.read_in(&record.frame, codeword.layout_class(), record.bits, modulation);
    let score = soft.score(&codeword);
    Ok(Candidate {
        id: record.id.as_u128(),
        log10_bound: soft.log10_bound(score.t),
        score,
        hypothesis: Hypothesis { frame: record.frame, soft: Arc::new(soft) },
    })
}
