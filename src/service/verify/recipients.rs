//! The matched filter, run for the records of one host at one pose hypothesis, one record after the
//! other.
//!
//! What it adds to the relief was measured on 20 suspects per attack (two keys, ten meshes), in
//! place. It decides 19 of those with 6 or 5 bits a coordinate, 18 of those with noise of 2 %, and
//! 2 to 4 of the smoothed ones.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::super::ServiceError;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::cascade::Cascade;
use super::host_search::{CandidateHost, HostSearch};
use super::{Depth, go_on};
use crate::recognition::{PoseHypothesis, PoseKind};
use crate::registration::WorkLimits;
use crate::registry::Record;
use crate::watermark::{Candidate, Codeword, Frame, HostFilter, Hypothesis, SoftBits};

/// Most records of a host that are run through the matched filter at one pose hypothesis.
fn most_filtered(depth: Depth) -> usize {
    if depth == Depth::Exhaustive { 64 } else { 10 }
}

/// The assumptions of a pose hypothesis, and the factors on bounds there.
pub(super) struct PoseContext<'a> {
    pub(super) name: FrameName,
    /// The host's frame in the suspect's coordinates.
    pub(super) frame: Frame,
    pub(super) counted: &'a dyn Fn(StageName) -> f64,
    /// The work that the comparison with the host may still do.
    pub(super) within: WorkLimits<'a>,
}

/// A record, its codeword, and the filter for it on the host.
struct Filtered<'a> {
    record: &'a Record,
    codeword: Codeword,
    filter: Arc<HostFilter>,
}

/// The records of a host, and the correspondences of a pose hypothesis.
pub(super) struct Recipients<'a> {
    search: &'a HostSearch<'a>,
    candidate_host: &'a CandidateHost,
    pose: &'a PoseHypothesis,
    /// The records that the request asks about, likeliest first.
    asked: Vec<&'a Record>,
}

impl<'a> Recipients<'a> {
    /// `ranking` holds the ids of records, those with the best score in the host's frame first.
    pub(super) fn new(
        search: &'a HostSearch<'a>,
        candidate_host: &'a CandidateHost,
        ranking: &[u128],
        pose: &'a PoseHypothesis,
    ) -> Self {
        let has_blind = |record: &&Record| record.layers.has_blind();
        let ranked = ranking.iter().filter_map(|&id| candidate_host.record(id)).filter(has_blind);
        let ranked: Vec<&Record> = ranked.collect();
        let is_ranked = |record: &&Record| ranked.iter().any(|known| known.id == record.id);
        // The rest, newest first: the bins of a heavily damaged suspect say nothing.
        let rest = candidate_host.records.iter().rev();
        let rest = rest.filter(has_blind).filter(|record| !is_ranked(record));
        let asked = ranked.iter().copied().chain(rest);
        let asked = asked.filter(|record| candidate_host.is_asked(record.id.as_u128()));
        let asked = asked.take(most_filtered(search.depth)).collect();
        Self { search, candidate_host, pose, asked }
    }

    /// Scores the records; breaks when no further pose hypothesis is needed. One filter at a time
    /// is in use: on a large host each takes as much memory as the suspect.
    pub(super) fn read(
        &self,
        seen: &PoseContext<'_>,
        cascade: &mut Cascade,
    ) -> Result<ControlFlow<()>, ServiceError> {
        let turned = match self.pose.kind {
            PoseKind::InPlace => None,
            _ => Some(self.pose.similarity.rotation),
        };
        for record in &self.asked {
            go_on(self.search.stop)?;
            let filtered = self.filtered(record)?;
            let stop = || self.search.stop.now();
            let reading = filtered.filter.compare_until(&self.pose.correspondences, turned, &stop);
            go_on(self.search.stop)?;
            cascade.tried(StageName::MatchedFilter, 1);
            score(StageName::MatchedFilter, &filtered, reading.alone(), seen, cascade);
        }
        Ok(if cascade.is_open() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
    }

    fn filtered(&self, record: &'a Record) -> Result<Filtered<'a>, ServiceError> {
        let codeword = codeword(self.search.keys, &record.source())?;
        let host = (self.candidate_host.key, &*self.candidate_host.host_model);
        let filter = self.search.host_cache.filter(
            host,
            record,
            codeword.layout_class(),
            self.search.stop,
        )?;
        Ok(Filtered { record, codeword, filter })
    }
}

/// Scores a record and adds it to the cascade.
fn score(
    stage: StageName,
    of: &Filtered<'_>,
    soft: SoftBits,
    seen: &PoseContext<'_>,
    cascade: &mut Cascade,
) {
    let score = soft.score(&of.codeword);
    let candidate = Candidate {
        id: of.record.id.as_u128(),
        log10_bound: soft.log10_bound(score.t),
        score,
        hypothesis: Hypothesis { frame: seen.frame, soft: Arc::new(soft) },
    };
    cascade.add(stage, seen.name, candidate, (seen.counted)(stage));
}
