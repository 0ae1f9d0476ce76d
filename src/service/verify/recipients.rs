//! The matched filter for the records of one host, from one look, one after the other.
//!
//! What it is for beside the relief: of 20 suspects each (two keys, ten meshes), in place, it decides 19 of
//! those with 6 or 5 bits a coordinate, 18 of those with noise of 2 %, and 2 to 4 of smoothed ones.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::super::ServiceError;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::at_home::{Housed, Visit};
use super::ladder::Climb;
use super::{Depth, go_on};
use crate::recognition::{Look, LookKind};
use crate::registration::Within;
use crate::registry::Record;
use crate::watermark::{Candidate, Codeword, Frame, HostFilter, Hypothesis, SoftBits};

/// How many recipients' copies of a host are run through the matched filter at a look.
fn most_filtered(depth: Depth) -> usize {
    if depth == Depth::Exhaustive { 64 } else { 10 }
}

/// What a look assumes, and what a stage's bound of a record is multiplied by there.
pub(super) struct Seen<'a> {
    pub(super) name: FrameName,
    /// The host's frame in the suspect's coordinates.
    pub(super) frame: Frame,
    pub(super) counted: &'a dyn Fn(StageName) -> f64,
    /// What looking at the host may still take.
    pub(super) within: Within<'a>,
}

/// A record's filter on the host and its codeword.
struct Filtered<'a> {
    record: &'a Record,
    codeword: Codeword,
    filter: Arc<HostFilter>,
}

/// The records of a host, and where a look has its carriers.
pub(super) struct Recipients<'a> {
    visit: &'a Visit<'a>,
    housed: &'a Housed,
    look: &'a Look,
    /// The records that are asked about, likeliest first.
    asked: Vec<&'a Record>,
}

impl<'a> Recipients<'a> {
    /// `ranking` are ids, those that score best in the host's frame first.
    pub(super) fn new(
        visit: &'a Visit<'a>,
        housed: &'a Housed,
        ranking: &[u128],
        look: &'a Look,
    ) -> Self {
        let has_blind = |record: &&Record| record.layers.has_blind();
        let ranked = ranking.iter().filter_map(|&id| housed.record(id)).filter(has_blind);
        let ranked: Vec<&Record> = ranked.collect();
        let is_ranked = |record: &&Record| ranked.iter().any(|known| known.id == record.id);
        // (The rest, newest first: bins say nothing of a suspect that is much damaged.)
        let rest = housed.records.iter().rev();
        let rest = rest.filter(has_blind).filter(|record| !is_ranked(record));
        let asked = ranked.iter().copied().chain(rest);
        let asked = asked.filter(|record| housed.is_asked(record.id.as_u128()));
        let asked = asked.take(most_filtered(visit.depth)).collect();
        Self { visit, housed, look, asked }
    }

    /// Scores them; breaks when all is said. One filter at a time is in use: on a large host each
    /// takes as much memory as the suspect.
    pub(super) fn read(
        &self,
        seen: &Seen<'_>,
        climb: &mut Climb,
    ) -> Result<ControlFlow<()>, ServiceError> {
        let turned = match self.look.kind {
            LookKind::InPlace => None,
            _ => Some(self.look.similarity.rotation),
        };
        for record in &self.asked {
            go_on(self.visit.stop)?;
            let filtered = self.filtered(record)?;
            let stop = || self.visit.stop.now();
            let reading = filtered.filter.compare_until(&self.look.sightings, turned, &stop);
            go_on(self.visit.stop)?;
            climb.tried(StageName::MatchedFilter, 1);
            score(StageName::MatchedFilter, &filtered, reading.alone(), seen, climb);
        }
        Ok(if climb.is_open() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
    }

    fn filtered(&self, record: &'a Record) -> Result<Filtered<'a>, ServiceError> {
        let codeword = codeword(self.visit.keys, &record.source())?;
        let host = (self.housed.key, &*self.housed.home);
        let filter =
            self.visit.homes.filter(host, record, codeword.lattice_class(), self.visit.stop)?;
        Ok(Filtered { record, codeword, filter })
    }
}

/// Scores a record and adds it to the ladder.
fn score(stage: StageName, of: &Filtered<'_>, soft: SoftBits, seen: &Seen<'_>, climb: &mut Climb) {
    let score = soft.score(&of.codeword);
    let candidate = Candidate {
        id: of.record.id.as_u128(),
        log10_bound: soft.log10_bound(score.t),
        score,
        hypothesis: Hypothesis { frame: seen.frame, soft: Arc::new(soft) },
    };
    climb.add(stage, seen.name, candidate, (seen.counted)(stage));
}
