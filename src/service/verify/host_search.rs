//! The expensive detectors: a suspect is registered to the hosts of a short list, and is read in
//! each host's own frame and by the matched filter (`recipients`).
//!
//! What may be scored is fixed before anything is scored. Each host has an error share by its rank
//! on the short list (`shortlist::shares`). Each pose hypothesis of the host has a share of that,
//! and within a pose hypothesis each record of the host counts. So it does not matter where the
//! search ends, or for which of many recipients' copies the filter, the most expensive detector, is
//! really run.

use std::ops::ControlFlow;
use std::sync::Arc;

use uuid::Uuid;

use super::super::ServiceError;
use super::super::hosts::HostKey;
use super::super::known::codeword;
use super::super::verdict::{FrameName, StageName};
use super::cascade::{Cascade, Found, MOST_MATCHES};
use super::count::share;
use super::host_cache::HostCache;
use super::recipients::{PoseContext, Recipients};
use super::{Depth, go_on, relief};
use crate::jobs::Stop;
use crate::keys::KeyRing;
use crate::mesh::Mesh;
use crate::recognition::{HostModel, PoseHypothesis, PoseKind, SuspectModel, poses, share_on};
use crate::registration::{Allowed, Effort, WorkLimits};
use crate::registry::Record;
use crate::watermark::{
    Candidate, CodewordIndex, Frame, GroupKey, Hypothesis, Profile, ReportLimits, Suspect,
};

/// Fewest correspondences for the matched filter: fewer say too little.
const LEAST_CORRESPONDENCES: usize = 32;

/// A bin is sound if its statistic has at least the share `SOUND` of the mark's strength. A sound
/// mark is expected to have at least the share `SOUND_BINS` of sound bins. The embedder moves up to
/// a tenth of the bins less, where more would be expensive. In the mean of two copies, a quarter to
/// a half of the bins are not sound.
const SOUND: f64 = 0.6;
const SOUND_BINS: f64 = 0.9;

/// A host of the short list.
pub(super) struct CandidateHost {
    pub(super) key: HostKey,
    pub(super) host_model: Arc<HostModel>,
    /// The part of the error probability that the host may spend.
    pub(super) share: f64,
    /// Ids of its records that the request asks about, ascending.
    pub(super) ids: Vec<u128>,
    /// Its live records, asked about or not, oldest first; at least one. Of very many, the newest.
    pub(super) records: Vec<Record>,
}

impl CandidateHost {
    /// A record by its id.
    pub(super) fn record(&self, id: u128) -> Option<&Record> {
        let at = self.records.binary_search_by_key(&id, |record| record.id.as_u128()).ok()?;
        self.records.get(at)
    }

    /// Whether the request asks about a record.
    pub(super) fn is_asked(&self, id: u128) -> bool {
        self.ids.binary_search(&id).is_ok()
    }
}

/// What is compared with what.
pub(super) struct HostSearch<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) suspect: &'a Suspect,
    /// All live marks.
    pub(super) all: &'a CodewordIndex,
    /// Likeliest first.
    pub(super) hosts: &'a [CandidateHost],
    pub(super) keys: &'a KeyRing,
    pub(super) host_cache: &'a HostCache,
    pub(super) depth: Depth,
    /// The work that registration may do, over all hosts.
    pub(super) allowed: Allowed,
    pub(super) stop: &'a Stop,
}

pub(super) fn effort(depth: Depth) -> Effort {
    if depth == Depth::Exhaustive { Effort::Thorough } else { Effort::Whole }
}

/// Vertices and triangles together.
fn elements(mesh: &Mesh) -> u64 {
    mesh.positions().len() as u64 + mesh.triangles().len() as u64
}

impl HostSearch<'_> {
    /// Compares the suspect with host after host until a mark is recognised. If a mark is
    /// recognised already and does not look like one copy alone, its host is searched once for
    /// other recipients.
    pub(super) fn run(&self, cascade: &mut Cascade) -> Result<(), ServiceError> {
        let suspect_model = SuspectModel::new(self.mesh, self.suspect.surface());
        if let Some(found) = cascade.best_match() {
            let (id, sound) = (found.id, self.is_sound(found)?);
            self.compare_shapes(id, &suspect_model, cascade)?;
            // The list is the host of the found record: its other records are other recipients.
            let alone = self.hosts.iter().all(|candidate_host| candidate_host.records.len() == 1);
            if sound || alone {
                return Ok(());
            }
        }
        let hosts = self
            .hosts
            .iter()
            .map(|candidate_host| elements(candidate_host.host_model.mesh()))
            .collect();
        let mut shares = self.allowed.shares(elements(self.mesh), hosts);
        for candidate_host in self.hosts {
            go_on(self.stop)?;
            let mut failed = None;
            let budget = shares.deal();
            let stop = || self.stop.now();
            let within = WorkLimits { budget: &budget, stop: &stop };
            let mut on_pose = |pose: PoseHypothesis| match self.read(
                candidate_host,
                (&suspect_model, &pose),
                within,
                cascade,
            ) {
                Ok(flow) => flow,
                Err(error) => {
                    failed = Some(error);
                    ControlFlow::Break(())
                }
            };
            let end = poses(
                &candidate_host.host_model,
                &suspect_model,
                effort(self.depth),
                within,
                &mut on_pose,
            );
            shares.took(&budget);
            if let Some(error) = failed {
                return Err(error);
            }
            go_on(self.stop)?;
            if end.is_break() || !cascade.is_open() {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Notes whether the suspect has the shape of a record's host, for a record that was found
    /// without its host.
    fn compare_shapes(
        &self,
        id: Uuid,
        suspect_model: &SuspectModel<'_>,
        cascade: &mut Cascade,
    ) -> Result<(), ServiceError> {
        let Some(candidate_host) =
            self.hosts.iter().find(|candidate_host| candidate_host.record(id.as_u128()).is_some())
        else {
            return Ok(());
        };
        let sizes = vec![elements(candidate_host.host_model.mesh())];
        let budget = self.allowed.shares(elements(self.mesh), sizes).deal();
        let stop = || self.stop.now();
        let within = WorkLimits { budget: &budget, stop: &stop };
        let share = share_on(&candidate_host.host_model, suspect_model, effort(self.depth), within);
        go_on(self.stop)?;
        if let Some(share) = share {
            cascade.lies_on_host(id, share);
        }
        Ok(())
    }

    /// Whether a found mark looks like one copy and not like a mean of several: nearly all of its
    /// bins are as far from neutral as the embedder put them.
    fn is_sound(&self, found: &Found) -> Result<bool, ServiceError> {
        let records = self.hosts.iter().flat_map(|candidate_host| &candidate_host.records);
        let Some(record) = records.into_iter().find(|record| record.id == found.id) else {
            return Ok(true);
        };
        let codeword = codeword(self.keys, &record.source())?;
        let profile = self.profile(&found.candidate.hypothesis.frame)?;
        let modulation = record.method.modulation();
        let bins = profile.bins(codeword.layout_class(), record.bits, modulation);
        let (read, least) = (bins.iter().flatten(), SOUND * record.strength.get());
        let sound = read.clone().filter(|off| off.abs() >= least).count();
        Ok(sound as f64 >= SOUND_BINS * read.count() as f64)
    }

    fn profile(&self, frame: &Frame) -> Result<Profile, ServiceError> {
        let profile = self.suspect.in_frame_until(frame, &|| self.stop.now());
        profile.ok_or_else(|| self.stop.reason().into())
    }

    /// Reads the suspect at one pose hypothesis. Breaks when no further pose hypothesis is needed.
    fn read(
        &self,
        candidate_host: &CandidateHost,
        (suspect_model, pose): (&SuspectModel<'_>, &PoseHypothesis),
        within: WorkLimits<'_>,
        cascade: &mut Cascade,
    ) -> Result<ControlFlow<()>, ServiceError> {
        go_on(self.stop)?;
        let Some(frame) = candidate_host.records.first().map(|record| pose.frame_of(&record.frame))
        else {
            return Ok(ControlFlow::Break(()));
        };
        let name = match pose.kind {
            PoseKind::InPlace | PoseKind::Near => FrameName::InPlace,
            PoseKind::SameOrder
            | PoseKind::FewVertices
            | PoseKind::Registered(_)
            | PoseKind::Symmetric(_) => FrameName::Registered,
        };
        let profile = self.profile(&frame)?;
        let ranked = self.in_frame(candidate_host, &profile);
        cascade.tried(StageName::HostFrame, candidate_host.ids.len() as u64);
        let ranking: Vec<u128> = ranked.iter().map(|candidate| candidate.id).collect();
        let counted = |stage: StageName| {
            candidate_host.ids.len() as f64
                / (share(stage) * candidate_host.share * pose.kind.share())
        };
        let asked = ranked.into_iter().filter(|candidate| candidate_host.is_asked(candidate.id));
        for candidate in asked.take(MOST_MATCHES) {
            cascade.add(StageName::HostFrame, name, candidate, counted(StageName::HostFrame));
        }
        if let Some(found) = cascade.best_match()
            && (candidate_host.records.len() == 1 || self.is_sound(found)?)
        {
            return Ok(ControlFlow::Break(()));
        }
        let seen = PoseContext { name, frame, counted: &counted, within };
        if relief::read(self, candidate_host, (suspect_model, pose), &seen, cascade)?.is_break() {
            return Ok(ControlFlow::Break(()));
        }
        if pose.correspondences.len() < LEAST_CORRESPONDENCES {
            return Ok(ControlFlow::Continue(()));
        }
        Recipients::new(self, candidate_host, &ranking, pose).read(&seen, cascade)
    }

    /// The host's records that score better than chance in this frame, best first.
    fn in_frame(&self, candidate_host: &CandidateHost, profile: &Profile) -> Vec<Candidate> {
        let frame = profile.frame();
        let mut ids: Vec<u128> = candidate_host.records.iter().map(|r| r.id.as_u128()).collect();
        ids.extend(&candidate_host.ids);
        ids.sort_unstable();
        ids.dedup();
        let marks = self.all.only(&ids);
        let read = |key: GroupKey| {
            let soft = Arc::new(profile.read(key.class, key.bits, key.modulation));
            vec![Hypothesis { frame, soft }]
        };
        // Records that do not match are ranked too; no bound is above one.
        marks.search(&read, ReportLimits { log10_bound: 0.0, most: usize::MAX }).candidates
    }
}
