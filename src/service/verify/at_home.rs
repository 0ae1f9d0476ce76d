//! The dear detectors: a suspect is brought home to the hosts of a short list and read there, in the
//! host's own frame and by the matched filter.
//!
//! What may be scored is fixed before anything is: each host has a share of the error probability by
//! its rank on the short list, each look at it a share of that, and within a look each record of the
//! host counts. So it is no matter where the search ends, or for which of many recipients' copies the
//! filter (the dearest) is really run.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::super::ServiceError;
use super::super::hosts::HostKey;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::count::share;
use super::homes::Homes;
use super::ladder::{Climb, MOST_MATCHES};
use super::{Depth, go_on};
use crate::jobs::Stop;
use crate::keys::KeyRing;
use crate::mesh::Mesh;
use crate::recognition::{Home, Look, LookKind, Visitor, looks};
use crate::registration::Effort;
use crate::registry::Record;
use crate::watermark::{Candidate, CodewordIndex, Frame, GroupKey, Hypothesis, Suspect, Worth};

/// Fewer vertices than this that are known one by one say too little for the matched filter.
const LEAST_SIGHTINGS: usize = 32;

/// A host of the short list.
pub(super) struct Housed {
    pub(super) key: HostKey,
    pub(super) home: Arc<Home>,
    /// Ids of its records that are asked about, ascending.
    pub(super) ids: Vec<u128>,
    /// Some of them, newest first; at least one.
    pub(super) records: Vec<Record>,
}

/// What is compared.
pub(super) struct Visit<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) suspect: &'a Suspect,
    pub(super) marks: &'a CodewordIndex,
    /// Likeliest first.
    pub(super) hosts: &'a [Housed],
    pub(super) keys: &'a KeyRing,
    pub(super) homes: &'a Homes,
    pub(super) depth: Depth,
    pub(super) stop: &'a Stop,
}

/// How many recipients' copies of a host are run through the matched filter at a look.
fn most_filtered(depth: Depth) -> usize {
    if depth == Depth::Exhaustive { 64 } else { 8 }
}

fn effort(depth: Depth) -> Effort {
    if depth == Depth::Exhaustive { Effort::Thorough } else { Effort::Whole }
}

impl Visit<'_> {
    /// Looks at host after host until a mark is recognised.
    pub(super) fn run(&self, climb: &mut Climb) -> Result<(), ServiceError> {
        let visitor = Visitor::new(self.mesh, self.suspect.surface());
        let mut rank_share = 0.5;
        for housed in self.hosts {
            go_on(self.stop)?;
            let marks = self.marks.only(&housed.ids);
            let Some(frame) = housed.records.first().map(|record| record.frame) else { continue };
            let mut failed = None;
            let mut see =
                |look: Look| match self.read(housed, &marks, &frame, &look, rank_share, climb) {
                    Ok(()) if climb.is_open() => ControlFlow::Continue(()),
                    Ok(()) => ControlFlow::Break(()),
                    Err(error) => {
                        failed = Some(error);
                        ControlFlow::Break(())
                    }
                };
            let stop = || self.stop.now();
            let end = looks(&housed.home, &visitor, effort(self.depth), &stop, &mut see);
            if let Some(error) = failed {
                return Err(error);
            }
            go_on(self.stop)?;
            if end.is_break() {
                return Ok(());
            }
            rank_share *= 0.5;
        }
        Ok(())
    }

    fn read(
        &self,
        housed: &Housed,
        marks: &CodewordIndex,
        frame: &Frame,
        look: &Look,
        rank_share: f64,
        climb: &mut Climb,
    ) -> Result<(), ServiceError> {
        go_on(self.stop)?;
        let name = match look.kind {
            LookKind::InPlace | LookKind::Near => FrameName::InPlace,
            LookKind::SameOrder | LookKind::Registered(_) => FrameName::Registered,
        };
        let counted = |stage: StageName| {
            housed.ids.len() as f64 / (share(stage) * rank_share * look.kind.share())
        };
        let there = look.frame_of(frame);
        let stage = StageName::HostFrames;
        let candidates = self.in_frame(marks, &there, climb.worth(counted(stage)));
        climb.tried(stage, marks.len() as u64);
        let likely: Vec<u128> = candidates.iter().map(|candidate| candidate.id).collect();
        for candidate in candidates {
            climb.add(stage, name, candidate, counted(stage));
        }
        if !climb.is_open() || look.sightings.len() < LEAST_SIGHTINGS {
            return Ok(());
        }
        let stage = StageName::MatchedFilter;
        let mut chosen: Vec<&Record> = housed.records.iter().collect();
        chosen.sort_by_key(|record| {
            likely.iter().position(|&id| id == record.id.as_u128()).unwrap_or(usize::MAX)
        });
        for record in chosen.into_iter().take(most_filtered(self.depth)) {
            go_on(self.stop)?;
            let candidate = self.filtered(housed, record, &there, look)?;
            climb.tried(stage, 1);
            climb.add(stage, name, candidate, counted(stage));
            if !climb.is_open() {
                break;
            }
        }
        Ok(())
    }

    /// Every record of the host, scored in its frame.
    fn in_frame(&self, marks: &CodewordIndex, frame: &Frame, worth: Worth) -> Vec<Candidate> {
        let profile = self.suspect.in_frame(frame);
        let read = |key: GroupKey| {
            let soft = Arc::new(profile.read(key.class, key.bits, key.modulation));
            vec![Hypothesis { frame: *frame, soft }]
        };
        marks.search(&read, Worth { most: MOST_MATCHES, ..worth }).candidates
    }

    fn filtered(
        &self,
        housed: &Housed,
        record: &Record,
        frame: &Frame,
        look: &Look,
    ) -> Result<Candidate, ServiceError> {
        let codeword = codeword(self.keys, &record.source())?;
        let filter = self.homes.filter((housed.key, &housed.home), record, &codeword)?;
        let (soft, _) = filter.read(&look.sightings);
        let score = soft.score(&codeword);
        Ok(Candidate {
            id: record.id.as_u128(),
            log10_bound: soft.log10_bound(score.t),
            score,
            hypothesis: Hypothesis { frame: *frame, soft: Arc::new(soft) },
        })
    }
}
