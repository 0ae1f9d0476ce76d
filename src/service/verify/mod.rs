//! Verify: whose mark does this file carry?
//!
//! A verdict is a bound (invariant I4): `log10_fp` bounds the probability that a file which does
//! not carry the mark scores so high, and every hypothesis that was scored is counted (`count`).
//! Detectors are stages of a cascade (`cascade`), one file each. The cheap ones come first; the
//! expensive ones run while the verdict is open. A request that names marks restricts what is
//! scored, and so what is counted.

mod blind;
mod cascade;
mod charge;
mod count;
mod existing;
mod host_cache;
mod host_search;
mod in_place;
mod judge;
mod layouts;
mod named;
mod overmarks;
mod questions;
mod recipients;
mod relief;
mod shortlist;

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

use super::memory::{self, Purpose};
use super::verdict::{ComparedHosts, Verification};
use super::{Service, ServiceError, Spooled, Text};
use crate::formats::{Asset, Format};
use crate::jobs::{Memory, Slot, Stop};
use crate::mesh::Mesh;
use crate::registration::Allowed;
use crate::registry::StoredVerification;
use crate::watermark::{CodewordIndex, Suspect};
use cascade::{Cascade, CascadeOutcome, Case, Found};
pub(super) use charge::Charge;
use charge::Charges;
pub(super) use host_cache::HostCache;
use host_search::{CandidateHost, HostSearch, effort};
use named::Named;
use overmarks::overmarks;
use questions::Questions;
use shortlist::{FetchedHost, ListedHost};

/// A suspect, and the marks that it is compared with.
#[derive(Debug)]
pub struct VerifyRequest {
    /// The suspect.
    pub file: Spooled,
    /// Only this owner's marks.
    pub owner_id: Option<Text>,
    /// Only this mark.
    pub watermark_id: Option<Uuid>,
    /// How much may be tried.
    pub depth: Depth,
}

/// How much a verification tries before it answers that there is no match.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Depth {
    /// The blind frame, and a small search around it.
    Fast,
    /// All detectors.
    #[default]
    Standard,
    /// All detectors, with a search that takes seconds.
    Exhaustive,
}

impl Depth {
    /// All depths, the least first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Standard, Self::Exhaustive];

    /// Its name in requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Standard => "standard",
            Self::Exhaustive => "exhaustive",
        }
    }
}

impl fmt::Display for Depth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Depth {
    type Err = &'static str;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|depth| depth.name() == name);
        named.ok_or("must be fast, standard or exhaustive")
    }
}

/// The results that the verdict is made of.
struct Searched {
    format: Format,
    vertices: usize,
    triangles: usize,
    outcome: CascadeOutcome,
    compared_hosts: ComparedHosts,
    /// Marks that the request does not ask about. Only what their records say of the marks that it
    /// does ask about is used.
    later: Vec<Found>,
    /// The records that the request names.
    named: Option<Arc<Named>>,
    questions: Questions,
}

/// What was read from the suspect's file.
struct Read {
    format: Format,
    mesh: Mesh,
}

/// What the first job passes to the second.
struct FirstJob {
    suspect: Suspect,
    /// All marks, and the marks that the request asks about.
    all: CodewordIndex,
    marks: CodewordIndex,
    cascade: Cascade,
    later: Vec<Found>,
    /// Hosts to compare with; empty when the verdict is clear or the depth allows none.
    listed: Vec<ListedHost>,
}

impl Service {
    /// Compares a suspect with the registered marks and keeps the verdict.
    ///
    /// # Errors
    /// [`ServiceError`] when the file cannot be read, or the request names what does not exist or
    /// cannot be searched for. Then no verdict is kept.
    pub async fn verify(
        self: &Arc<Self>,
        request: VerifyRequest,
    ) -> Result<Verification, ServiceError> {
        let named = self.named(&request).await?;
        let question = questions::identify(&request);
        let (depth, bytes) = (request.depth, request.file.bytes);
        let (service, file, named) = (self.clone(), request.file, named.map(Arc::new));
        let sha256 = hex::encode(file.sha256);
        let known = named.clone();
        // The slot is held until the verdict is kept, so that a verification that has begun is not
        // refused half-way.
        let slot = self.admit()?;
        let questions = self.questions(question, named.as_deref());
        let charges = questions.charges().clone();
        let (read, begun) = self
            .run(&slot, bytes, move |allowed| {
                let stop = || allowed.stop().now();
                let asset = Asset::read_until(&file.read()?, &service.config.limits, &stop)?;
                let (format, mesh) = (asset.format(), asset.into_mesh());
                allowed.need(memory::needed(&mesh, Purpose::Verify))?;
                let named = known.as_deref();
                let begun =
                    service.begin(&mesh, (named, charges.clone()), depth, allowed.stop())?;
                Ok((Read { format, mesh }, begun))
            })
            .await?;
        let asked = (named.clone(), questions);
        let searched = self.end(&slot, read, begun, asked, depth).await?;
        let verification = self.judge(searched, depth, sha256).await?;
        // A mark that the request names may have been found, and dropped because it was revoked
        // meanwhile.
        if verification.matches.is_empty() && named.is_some_and(|named| !self.searches(&named)) {
            return Err(revoked_meanwhile());
        }
        if self.only_reads {
            return Ok(verification);
        }
        let answer = serde_json::to_value(&verification)
            .map_err(|error| ServiceError::Internal(error.to_string()))?;
        let stored =
            StoredVerification { id: verification.id, created_at: verification.created_at, answer };
        self.registry.keep_verification(&stored).await?;
        Ok(verification)
    }

    /// A verdict as it was answered.
    ///
    /// # Errors
    /// [`ServiceError::UnknownVerification`].
    pub async fn verification(&self, id: Uuid) -> Result<serde_json::Value, ServiceError> {
        let found = self.registry.verification(id).await?;
        Ok(found.ok_or(ServiceError::UnknownVerification(id))?.answer)
    }

    /// On the pool: runs the stages that need only the suspect and the marks.
    fn begin(
        &self,
        mesh: &Mesh,
        (named, charges): (Option<&Named>, Charges),
        depth: Depth,
        stop: &Stop,
    ) -> Result<FirstJob, ServiceError> {
        go_on(stop)?;
        let suspect = Suspect::new_until(mesh, &|| stop.now());
        go_on(stop)?;
        let suspect = suspect?;
        let all = self.known.marks();
        let marks = match named {
            None => all.clone(),
            Some(named) => all.only(named.ids()),
        };
        if named.is_some() && marks.is_empty() {
            return Err(revoked_meanwhile());
        }
        let mut cascade = Cascade::new(self.thresholds(), charges);
        let case = Case { suspect: &suspect, marks: &marks, named, keys: &self.keys, stop };
        cascade.run(&case, cascade::stages(depth))?;
        let others = depth != Depth::Fast && !marks.is_empty() && marks.len() < all.len();
        let later = if others && cascade.is_open() {
            overmarks(&case, &all, self.thresholds(), &mut cascade)?
        } else {
            Vec::new()
        };
        let listed = if cascade.is_open() && depth != Depth::Fast && !marks.is_empty() {
            self.shortlist(&suspect, named, depth, stop)?
        } else {
            Vec::new()
        };
        Ok(FirstJob { suspect, all, marks, cascade, later, listed })
    }

    /// Compares the suspect with the hosts of the short list, if there are any, and runs the late
    /// stages.
    async fn end(
        self: &Arc<Self>,
        slot: &Slot,
        Read { format, mesh }: Read,
        begun: FirstJob,
        (named, questions): (Option<Arc<Named>>, Questions),
        depth: Depth,
    ) -> Result<Searched, ServiceError> {
        let FirstJob { suspect, all, marks, mut cascade, later, mut listed } = begun;
        let (vertices, triangles) = (mesh.positions().len(), mesh.triangles().len());
        let asked = named.clone();
        let of = |cascade: Cascade, compared_hosts: ComparedHosts| {
            let outcome = cascade.finish();
            Searched {
                format,
                vertices,
                triangles,
                outcome,
                compared_hosts,
                later,
                named: asked,
                questions,
            }
        };
        if depth == Depth::Fast {
            return Ok(of(cascade, ComparedHosts::default()));
        }
        if let Some(found) = cascade.best_match() {
            listed = Vec::from_iter(self.host_of(found.id).await?);
            if listed.is_empty() {
                return Ok(of(cascade, ComparedHosts::default()));
            }
        }
        let hosts = self.fetch(listed, named.as_deref()).await?;
        let compared_hosts = ComparedHosts {
            hosts: hosts.len(),
            elements: hosts.iter().map(FetchedHost::elements).sum(),
        };
        let beyond = Memory::Beyond(hosts.iter().map(FetchedHost::memory).sum());
        let service = self.clone();
        let cascade = self
            .pool
            .run(slot, beyond, move |allowed| -> Result<Cascade, ServiceError> {
                let stop = allowed.stop();
                service.search(hosts, (&mesh, &suspect, &all), depth, stop, &mut cascade)?;
                let named = named.as_deref();
                let (suspect, marks, keys) = (&suspect, &marks, &service.keys);
                let case = Case { suspect, marks, named, keys, stop };
                cascade.run(&case, cascade::late_stages(depth))?;
                Ok(cascade)
            })
            .await??;
        Ok(of(cascade, compared_hosts))
    }
}

impl Service {
    /// On the pool: compares the suspect with hosts.
    fn search(
        &self,
        hosts: Vec<FetchedHost>,
        (mesh, suspect, all): (&Mesh, &Suspect, &CodewordIndex),
        depth: Depth,
        stop: &Stop,
        cascade: &mut Cascade,
    ) -> Result<(), ServiceError> {
        let candidate_host: Result<Vec<Option<CandidateHost>>, ServiceError> =
            hosts.into_iter().map(|listed| self.candidate_host(listed, stop)).collect();
        let hosts: Vec<CandidateHost> = candidate_host?.into_iter().flatten().collect();
        let (keys, host_cache, hosts) = (&self.keys, &self.host_cache, hosts.as_slice());
        let allowed = Allowed::of(effort(depth));
        HostSearch { mesh, suspect, all, hosts, keys, host_cache, depth, allowed, stop }
            .run(cascade)
    }
}

fn revoked_meanwhile() -> ServiceError {
    ServiceError::NothingToCompare("what the request asks about was revoked meanwhile".to_owned())
}

fn go_on(stop: &Stop) -> Result<(), ServiceError> {
    if stop.now() { Err(stop.reason().into()) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_read_back() {
        for depth in Depth::ALL {
            assert_eq!(depth.to_string().parse(), Ok(depth));
        }
        assert!("deep".parse::<Depth>().is_err());
    }
}
