//! The matched filter for the records of one host, from one look: each mark alone, then beside the
//! others (recipients who averaged their copies), then below a later one (whoever set it).
//!
//! Which others a record is read beside follows from their codewords and the suspect, never from its
//! own: the [`BESIDE`] that score best without it. Which lattice it is read below follows from the
//! suspect alone.

use std::ops::ControlFlow;
use std::sync::Arc;

use glam::DVec3;
use uuid::Uuid;

use super::super::ServiceError;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::at_home::{Housed, Visit};
use super::ladder::Climb;
use super::{Depth, go_on};
use crate::recognition::{Look, LookKind};
use crate::registry::Record;
use crate::watermark::{
    Candidate, Codeword, Comparison, Frame, HostFilter, Hypothesis, Profile, SoftBits,
};

/// Others that a mark is read beside.
const BESIDE: usize = 9;

/// How many recipients' copies of a host are run through the matched filter at a look, and of
/// these how many below a later mark.
fn most_filtered(depth: Depth) -> (usize, usize) {
    if depth == Depth::Exhaustive { (64, 16) } else { (10, 2) }
}

/// What a look assumes, and what a stage's bound of a record is multiplied by there.
pub(super) struct Seen<'a> {
    pub(super) name: FrameName,
    /// The host's frame in the suspect's coordinates.
    pub(super) frame: Frame,
    /// The suspect in that frame.
    pub(super) profile: &'a Profile,
    pub(super) counted: &'a mut dyn FnMut(StageName, u128) -> Result<f64, ServiceError>,
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
    /// The records that score best in the host's frame, one more than each is read beside.
    best: Vec<&'a Record>,
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
        let asked = asked.take(most_filtered(visit.depth).0).collect();
        let best = ranked.into_iter().take(BESIDE + 1).collect();
        Self { visit, housed, look, best, asked }
    }

    /// Scores them; breaks when all is said. One filter at a time is in use: on a large host each
    /// takes as much memory as the suspect.
    pub(super) fn read(
        &self,
        seen: &mut Seen<'_>,
        climb: &mut Climb,
    ) -> Result<ControlFlow<()>, ServiceError> {
        let turned = match self.look.kind {
            LookKind::InPlace => None,
            _ => Some(self.look.similarity.rotation),
        };
        let expected = self.expected()?;
        let (_, below) = most_filtered(self.visit.depth);
        for (rank, record) in self.asked.iter().enumerate() {
            go_on(self.visit.stop)?;
            let filtered = self.filtered(record)?;
            let stop = || self.visit.stop.now();
            let reading = filtered.filter.compare_until(&self.look.sightings, turned, &stop);
            go_on(self.visit.stop)?;
            climb.tried(StageName::MatchedFilter, 1);
            score(StageName::MatchedFilter, &filtered, reading.alone(), seen, climb)?;
            let others = expected.iter().filter(|(id, _)| *id != record.id);
            let others: Vec<&[DVec3]> = others.map(|(_, at)| at.as_slice()).take(BESIDE).collect();
            if !others.is_empty() {
                let soft = reading.beside(&others);
                climb.tried(StageName::BesideOthers, 1);
                score(StageName::BesideOthers, &filtered, soft, seen, climb)?;
            }
            if rank < below && climb.is_open() {
                // (Counted whether or not it can be read, which depends on lattice classes.)
                climb.tried(StageName::BelowAnother, 1);
                if let Some(soft) = self.below(&filtered, &reading, seen)? {
                    score(StageName::BelowAnother, &filtered, soft, seen, climb)?;
                }
            }
        }
        Ok(if climb.is_open() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
    }

    /// Where the marks of the likeliest records put the carriers; none where there is one record only.
    fn expected(&self) -> Result<Vec<(Uuid, Vec<DVec3>)>, ServiceError> {
        if self.housed.records.len() == 1 {
            return Ok(Vec::new());
        }
        let expected = |record: &&'a Record| {
            go_on(self.visit.stop)?;
            let Filtered { codeword, filter, .. } = self.filtered(record)?;
            Ok((record.id, filter.expected(&codeword)))
        };
        self.best.iter().map(expected).collect()
    }

    fn below(
        &self,
        Filtered { record, codeword, .. }: &Filtered<'_>,
        reading: &Comparison<'_>,
        seen: &Seen<'_>,
    ) -> Result<Option<SoftBits>, ServiceError> {
        let class = later_class(seen.profile, record, codeword.lattice_class());
        let host = (self.housed.key, &*self.housed.home);
        Ok(reading.under(&*self.visit.homes.filter(host, record, class, self.visit.stop)?))
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
fn score(
    stage: StageName,
    of: &Filtered<'_>,
    soft: SoftBits,
    seen: &mut Seen<'_>,
    climb: &mut Climb,
) -> Result<(), ServiceError> {
    let score = soft.score(&of.codeword);
    let candidate = Candidate {
        id: of.record.id.as_u128(),
        log10_bound: soft.log10_bound(score.t),
        score,
        hypothesis: Hypothesis { frame: seen.frame, soft: Arc::new(soft) },
    };
    let counted = (seen.counted)(stage, candidate.id)?;
    climb.add(stage, seen.name, candidate, counted);
    Ok(())
}

/// The lattice class, other than a record's own, whose bins are farthest from neutral: that of a
/// later mark, if there is one.
fn later_class(profile: &Profile, record: &Record, own: u8) -> u8 {
    let modulation = record.method.modulation();
    let size = |class: u8| -> f64 {
        let bins = profile.bins(class, record.bits, modulation);
        bins.iter().flatten().map(|off| off.abs()).sum()
    };
    let sizes = (0..=u8::MAX).filter(|&class| class != own).map(|class| (size(class), class));
    let largest = |a: &(f64, u8), b: &(f64, u8)| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1));
    sizes.max_by(largest).map_or(own, |(_, class)| class)
}
