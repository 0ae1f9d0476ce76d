//! The detector cascade: cheap detectors come first, expensive ones run while the verdict is open.
//!
//! A stage is a file with a type that is a [`Stage`], a name with an error share in `count`, and a
//! line in [`stages`]. What a stage chooses to score may depend on the suspect, the request and the
//! size of the registry, but never on codewords.

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

/// Most matches that are listed: somewhat more than the number of averaged copies that can still be
/// identified.
pub(super) const MOST_MATCHES: usize = 128;

/// The input of all stages.
pub(super) struct Case<'a> {
    pub(super) suspect: &'a Suspect,
    /// The marks that the suspect is compared with.
    pub(super) marks: &'a CodewordIndex,
    /// The marks that the request names.
    pub(super) named: Option<&'a Named>,
    pub(super) keys: &'a KeyRing,
    pub(super) stop: &'a Stop,
}

/// One detector.
pub(super) trait Stage: Sync {
    fn name(&self) -> StageName;

    /// The frame in which it reads.
    fn frame(&self) -> FrameName;

    /// Scores its hypotheses. Returns how many they are, and those that are `worth` a report.
    fn run(&self, case: &Case<'_>, worth: ReportLimits) -> Result<Tried, ServiceError>;
}

/// The outcome of a stage.
#[derive(Debug, Default)]
pub(super) struct Tried {
    pub(super) hypotheses: u64,
    pub(super) candidates: Vec<Candidate>,
}

/// A record whose mark the suspect may carry, with its best hypothesis.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) id: Uuid,
    pub(super) stage: StageName,
    pub(super) frame: FrameName,
    pub(super) candidate: Candidate,
    /// The factor on its bound for counted hypotheses: the hypotheses of the stage over the stage's
    /// error share.
    pub(super) counted: f64,
    /// The further factor on its bound, for what was tried before.
    pub(super) charge: Charge,
    pub(super) log10_fp: f64,
}

impl Found {
    /// The same finding with this charge.
    pub(super) fn charged(self, charge: Charge) -> Self {
        let log10_counted = (self.counted * charge.factor()).log10();
        // A bound that is not a number becomes 0 here, and matches nothing.
        let log10_fp = (self.candidate.log10_bound + log10_counted).min(0.0);
        Self { charge, log10_fp, ..self }
    }
}

/// The outcome of the cascade.
#[derive(Debug, Default)]
pub(super) struct CascadeOutcome {
    /// The stages in the order in which they ran, with the number of hypotheses of each.
    pub(super) tried: Vec<(StageName, u64)>,
    /// Best first; each record once.
    pub(super) found: Vec<Found>,
    /// For records that were found without their host: the share of the suspect's surface that lies
    /// on the host's, if it was measured.
    pub(super) on_host: BTreeMap<Uuid, f64>,
}

/// The stages of a depth that need only the suspect and the marks, in order.
pub(super) fn stages(depth: Depth) -> &'static [&'static dyn Stage] {
    match depth {
        Depth::Fast => &[&Blind, &LayoutSearch::NEAR],
        Depth::Standard | Depth::Exhaustive => {
            &[&Blind, &InPlace, &LayoutSearch::NEAR, &LayoutSearch::FULL]
        }
    }
}

/// The stages that come after the short list.
pub(super) fn late_stages(depth: Depth) -> &'static [&'static dyn Stage] {
    match depth {
        Depth::Fast | Depth::Standard => &[],
        Depth::Exhaustive => &[&LayoutSearch::WIDE],
    }
}

/// A run of the detector cascade, with its findings so far.
pub(super) struct Cascade {
    thresholds: Thresholds,
    charges: Charges,
    tried: Vec<(StageName, u64)>,
    best: BTreeMap<Uuid, Found>,
    on_host: BTreeMap<Uuid, f64>,
}

impl Cascade {
    /// A run before its first stage.
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

    /// The best of the records that match.
    pub(super) fn best_match(&self) -> Option<&Found> {
        let matches = self.best.values().filter(|found| found.log10_fp < self.thresholds.certain);
        matches.min_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp).then(a.id.cmp(&b.id)))
    }

    /// The bound that is worth a report when bounds are multiplied by `counted`.
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

    /// Notes the share of the suspect's surface that lies on the host of a record.
    pub(super) fn lies_on_host(&mut self, id: Uuid, share: f64) {
        self.on_host.insert(id, share);
    }

    /// Keeps a candidate if it is worth a report and is the best one for its record.
    pub(super) fn add(
        &mut self,
        stage: StageName,
        frame: FrameName,
        candidate: Candidate,
        counted: f64,
    ) {
        let id = Uuid::from_u128(candidate.id);
        // Most candidates match at no charge, so their charges are not asked for.
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
            // At least one hypothesis is counted: what is not worth a report then is not worth one
            // with more.
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
