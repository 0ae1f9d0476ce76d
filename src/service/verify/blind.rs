//! The blind frame: the suspect's own centre and extremes, against every mark.

use std::sync::Arc;

use super::super::ServiceError;
use super::super::verdict::{FrameName, StageName};
use super::cascade::{Case, Stage, Tried};
use super::layouts::stricter;
use crate::watermark::{GroupKey, Hypothesis, ReportLimits};

pub(super) struct Blind;

impl Stage for Blind {
    fn name(&self) -> StageName {
        StageName::Blind
    }

    fn frame(&self) -> FrameName {
        FrameName::Blind
    }

    fn run(&self, case: &Case<'_>, worth: ReportLimits) -> Result<Tried, ServiceError> {
        let frame = case.suspect.frame();
        let read = |key: GroupKey| {
            let soft = Arc::new(case.suspect.read(key.class, key.bits, key.modulation));
            vec![Hypothesis { frame, soft }]
        };
        let search = case.marks.search(&read, stricter(worth, case.marks.len()));
        Ok(Tried { hypotheses: search.hypotheses, candidates: search.candidates })
    }
}
