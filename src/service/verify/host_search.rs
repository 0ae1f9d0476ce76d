//! The expensive detectors: a suspect is brought into the coordinates of hosts of a short list and read there, in the
//! host's own frame and by the matched filter (`recipients`).
//!
//! What may be scored is fixed before anything is: each host has a share of the error probability by
//! its place on the short list (`shortlist::shares`), each pose hypothesis at it a share of that, and within a pose hypothesis each record of the
//! host counts. So it is no matter where the search ends, or for which of many recipients' copies the
//! filter (the most expensive) is really run.

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
use crate::registration::{Allowed, Effort, Within};
use crate::registry::Record;
use crate::watermark::{
    Candidate, CodewordIndex, Frame, GroupKey, Hypothesis, Profile, ReportLimits, Suspect,
};

/// Fewer vertices than this that are known one by one say too little for the matched filter.
const LEAST_CORRESPONDENCES: usize = 32;

/// Share of its strength that a statistic of a sound mark has at least, and share of the bins of
/// which that is expected. (The embedder gives up to a tenth of the bins less where more would be
/// expensive; in the mean of two copies it is a quarter to a half of them.)
const SOUND: f64 = 0.6;
const SOUND_BINS: f64 = 0.9;

/// A host of the short list.
pub(super) struct CandidateHost {
    pub(super) key: HostKey,
    pub(super) host_model: Arc<HostModel>,
    /// The part of the error probability that it may spend.
    pub(super) share: f64,
    /// Ids of its records that are asked about, ascending.
    pub(super) ids: Vec<u128>,
    /// Its live records, asked about or not, oldest first (of very many the newest); at least one.
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

/// What is compared.
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
    /// Work of registration, over all hosts.
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
    /// Looks at host after host until a mark is recognised. Where one is already, for which other
    /// recipients there are, until they are looked for.
    pub(super) fn run(&self, cascade: &mut Cascade) -> Result<(), ServiceError> {
        let suspect_model = SuspectModel::new(self.mesh, self.suspect.surface());
        if let Some(found) = cascade.best_match() {
            let (id, sound) = (found.id, self.is_sound(found)?);
            self.compare_shapes(id, &suspect_model, cascade)?;
            // The list is the host of what was found: other records of it are other recipients.
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
            let within = Within { budget: &budget, stop: &stop };
            let mut see = |pose: PoseHypothesis| match self.read(
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
                &mut see,
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

    /// Notes whether the suspect has the shape of a record's host at all: the record was found without.
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
        let within = Within { budget: &budget, stop: &stop };
        let share = share_on(&candidate_host.host_model, suspect_model, effort(self.depth), within);
        go_on(self.stop)?;
        if let Some(share) = share {
            cascade.lies_on_host(id, share);
        }
        Ok(())
    }

    /// Whether what was found looks like one mark and no mean of several: nearly all of its bins are
    /// as far from neutral as the embedder put them.
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

    /// Breaks when all is said.
    fn read(
        &self,
        candidate_host: &CandidateHost,
        (suspect_model, pose): (&SuspectModel<'_>, &PoseHypothesis),
        within: Within<'_>,
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
            | PoseKind::Turned(_) => FrameName::Registered,
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

    /// The host's records that score better than chance in its frame, best first.
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
        // What does not match is ranked, too; no bound is above one.
        marks.search(&read, ReportLimits { log10_bound: 0.0, most: usize::MAX }).candidates
    }
}
