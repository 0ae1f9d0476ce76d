//! The cascade of detectors: the cheap ones first, the expensive ones while the verdict is open.
//!
//! A stage is a file with a type that is a [`Stage`], a name with its share in `count`, and a line
//! in [`stages`]. What a stage chooses to score may depend on the suspect, the request and the
//! registry's size, never on codewords.

use std::collections::BTreeMap;

use uuid::Uuid;

use super::super::ServiceError;
use super::super::verdict::{FrameName, StageName, Thresholds};
use super::blind::Blind;
use super::charge::{Charge, Charges};
use super::count::counted;
use super::in_place::InPlace;
use super::layouts::LayoutSearch;
use super::named::Named;
use super::{Depth, go_on};
use crate::jobs::Stop;
use crate::keys::KeyRing;
use crate::watermark::{Candidate, CodewordIndex, ReportLimits, Suspect};

/// Matches listed at most: somewhat more than copies can be averaged that are still told apart.
pub(super) const MOST_MATCHES: usize = 128;

/// What all stages look at.
pub(super) struct Case<'a> {
    pub(super) suspect: &'a Suspect,
    /// The marks that it is compared with.
    pub(super) marks: &'a CodewordIndex,
    /// What the request names.
    pub(super) named: Option<&'a Named>,
    pub(super) keys: &'a KeyRing,
    pub(super) stop: &'a Stop,
}

/// One detector.
pub(super) trait Stage: Sync {
    fn name(&self) -> StageName;

    /// In which frame it reads.
    fn frame(&self) -> FrameName;

    /// Scores its hypotheses: how many, and those that are `worth` a report.
    fn run(&self, case: &Case<'_>, worth: ReportLimits) -> Result<Tried, ServiceError>;
}

/// The outcome of a stage.
#[derive(Debug, Default)]
pub(super) struct Tried {
    pub(super) hypotheses: u64,
    pub(super) candidates: Vec<Candidate>,
}

/// A record that may have marked the suspect, by its best hypothesis.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) id: Uuid,
    pub(super) stage: StageName,
    pub(super) frame: FrameName,
    pub(super) candidate: Candidate,
    /// What its bound is multiplied by: the hypotheses of the stage over its share.
    pub(super) counted: f64,
    /// What it is multiplied by, too.
    pub(super) charge: Charge,
    pub(super) log10_fp: f64,
}

impl Found {
    /// The same with this charge.
    pub(super) fn charged(self, charge: Charge) -> Self {
        let log10_counted = (self.counted * charge.factor()).log10();
        // A bound that is no number becomes 0 here: it matches nothing.
        let log10_fp = (self.candidate.log10_bound + log10_counted).min(0.0);
        Self { charge, log10_fp, ..self }
    }
}

/// The outcome of the cascade.
#[derive(Debug, Default)]
pub(super) struct CascadeOutcome {
    /// Stages in the order in which they ran, with the hypotheses that each scored.
    pub(super) tried: Vec<(StageName, u64)>,
    /// Best first, each record once.
    pub(super) found: Vec<Found>,
    /// Of records that were found without their host: which share of the suspect's surface lies on the
    /// host's, where that was looked at.
    pub(super) on_host: BTreeMap<Uuid, f64>,
}

/// The stages of a depth that need nothing but the suspect and the marks, in order.
pub(super) fn stages(depth: Depth) -> &'static [&'static dyn Stage] {
    match depth {
        Depth::Fast => &[&Blind, &LayoutSearch::NEAR],
        Depth::Standard | Depth::Exhaustive => {
            &[&Blind, &InPlace, &LayoutSearch::NEAR, &LayoutSearch::FULL]
        }
    }
}

/// Those that come after the short list.
pub(super) fn late_stages(depth: Depth) -> &'static [&'static dyn Stage] {
    match depth {
        Depth::Fast | Depth::Standard => &[],
        Depth::Exhaustive => &[&LayoutSearch::WIDE],
    }
}

/// A cascade of detectors and what it has found so far.
pub(super) struct Cascade {
    thresholds: Thresholds,
    charges: Charges,
    tried: Vec<(StageName, u64)>,
    best: BTreeMap<Uuid, Found>,
    on_host: BTreeMap<Uuid, f64>,
}

impl Cascade {
    /// At the foot.
    pub(super) fn new(thresholds: Thresholds, charges: Charges) -> Self {
        Self {
            thresholds,
            charges,
            tried: Vec::new(),
            best: BTreeMap::new(),
            on_host: BTreeMap::new(),
        }
    }

    /// Whether no record matches yet.
    pub(super) fn is_open(&self) -> bool {
        self.best.values().all(|found| found.log10_fp >= self.thresholds.certain)
    }

    /// The record that matches best.
    pub(super) fn best_match(&self) -> Option<&Found> {
        let matches = self.best.values().filter(|found| found.log10_fp < self.thresholds.certain);
        matches.min_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp).then(a.id.cmp(&b.id)))
    }

    /// What is worth a report when the bound is multiplied by `counted`.
    pub(super) fn worth(&self, counted: f64) -> ReportLimits {
        ReportLimits {
            log10_bound: self.thresholds.inconclusive - counted.log10(),
            most: MOST_MATCHES,
        }
    }

    /// Notes that a stage scored so many hypotheses.
    pub(super) fn tried(&mut self, stage: StageName, hypotheses: u64) {
        match self.tried.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += hypotheses,
            None if hypotheses > 0 => self.tried.push((stage, hypotheses)),
            None => {}
        }
    }

    /// Notes which share of the suspect's surface lies on the host of a record.
    pub(super) fn lies_on_host(&mut self, id: Uuid, share: f64) {
        self.on_host.insert(id, share);
    }

    /// Keeps a candidate if it is the best of its record and worth a report.
    pub(super) fn add(
        &mut self,
        stage: StageName,
        frame: FrameName,
        candidate: Candidate,
        counted: f64,
    ) {
        let id = Uuid::from_u128(candidate.id);
        // Most are no match whatever they are charged for, and need not be asked about.
        if candidate.log10_bound + counted.log10() >= self.thresholds.inconclusive {
            return;
        }
        let charge = self.charges.of(id);
        let found =
            Found { id, stage, frame, candidate, counted, charge, log10_fp: 0.0 }.charged(charge);
        let known = self.best.get(&id).map_or(f64::INFINITY, |known| known.log10_fp);
        if found.log10_fp < known.min(self.thresholds.inconclusive) {
            self.best.insert(id, found);
        }
    }

    /// Runs stage after stage until some record matches.
    pub(super) fn run(
        &mut self,
        case: &Case<'_>,
        stages: &[&dyn Stage],
    ) -> Result<(), ServiceError> {
        for stage in stages {
            if !self.is_open() {
                return Ok(());
            }
            go_on(case.stop)?;
            let name = stage.name();
            // One hypothesis at least is counted: what is not worth a report then is not with more.
            let Tried { hypotheses, candidates } = stage.run(case, self.worth(counted(name, 1)))?;
            self.tried(name, hypotheses);
            for candidate in candidates {
                self.add(name, stage.frame(), candidate, counted(name, hypotheses));
            }
        }
        Ok(())
    }

    /// What was found, best first.
    pub(super) fn finish(self) -> CascadeOutcome {
        let mut found: Vec<Found> = self.best.into_values().collect();
        found.sort_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp).then(a.id.cmp(&b.id)));
        CascadeOutcome { tried: self.tried, found, on_host: self.on_host }
    }
}
