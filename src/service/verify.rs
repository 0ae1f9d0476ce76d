//! Verify: whose mark does this file carry?
//!
//! A verdict is a bound, not a feeling (design invariant 4): `log10_fp` bounds the probability
//! that a file which does not carry the mark scores so high, and every hypothesis that was scored
//! is counted, in whichever frame. What a request names restricts what is scored, and so what is
//! counted.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use uuid::Uuid;

use super::embed::now;
use super::known::{Found, codeword};
use super::verdict::{FileFacts, FrameName, Match, Verdict, Verification};
use super::{BATCH, Service, ServiceError, Spooled, Text};
use crate::formats::{Asset, Format};
use crate::jobs::{JobError, Stop};
use crate::registry::{Record, StoredVerification};
use crate::watermark::{Codeword, Suspect};

/// Matches listed at most.
const MOST_MATCHES: usize = 20;
/// Named records that are also scored in their host's own frame, newest first: one pass over the
/// norms each.
const MOST_IN_PLACE: usize = 1_000;

/// A suspect, and what it is compared with.
#[derive(Debug)]
pub struct VerifyRequest {
    /// The suspect.
    pub file: Spooled,
    /// Only this owner's marks.
    pub owner_id: Option<Text>,
    /// Only this mark.
    pub watermark_id: Option<Uuid>,
}

/// What the pool hands back.
struct Searched {
    format: Format,
    vertices: usize,
    triangles: usize,
    hypotheses: u64,
    /// One entry per record, its better frame.
    found: Vec<(Found, FrameName)>,
}

impl Service {
    /// Compares a suspect with the registered marks and keeps the verdict.
    ///
    /// # Errors
    /// [`ServiceError`]: the file cannot be read, or names a record that does not exist.
    pub async fn verify(
        self: &Arc<Self>,
        request: VerifyRequest,
    ) -> Result<Verification, ServiceError> {
        let named = self.named(&request).await?;
        let (service, mut file) = (self.clone(), request.file);
        let sha256 = hex::encode(file.sha256);
        let searched = self
            .run(file.bytes, move |stop| {
                let bytes = file.read()?;
                service.search(&bytes, named.as_deref(), stop)
            })
            .await?;
        let verification = self.judge(searched, sha256).await?;
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

    /// The live records that the request names, oldest first; `None` when it names nothing.
    async fn named(&self, request: &VerifyRequest) -> Result<Option<Vec<Record>>, ServiceError> {
        let owner_id = request.owner_id.as_ref().map(Text::as_str);
        if let Some(id) = request.watermark_id {
            let record =
                self.registry.record(id).await?.ok_or(ServiceError::UnknownWatermark(id))?;
            let theirs = owner_id.is_none_or(|owner_id| record.owner_id == owner_id);
            let live = record.revoked_at.is_none();
            return Ok(Some(Vec::from_iter((theirs && live).then_some(record))));
        }
        if owner_id.is_none() {
            return Ok(None);
        }
        let (mut all, mut after) = (Vec::new(), None);
        loop {
            let records = self.registry.live(owner_id, after, BATCH).await?;
            let Some(last) = records.last() else { return Ok(Some(all)) };
            after = Some(last.id);
            all.extend(records);
        }
    }

    /// On the pool: reads the suspect and scores every hypothesis.
    fn search(
        &self,
        bytes: &[u8],
        named: Option<&[Record]>,
        stop: &Stop,
    ) -> Result<Searched, ServiceError> {
        let asset = Asset::read(bytes, &self.config.limits)?;
        let format = asset.format();
        let mesh = asset.into_mesh();
        go_on(stop)?;
        let suspect = Suspect::new(&mesh)?;
        go_on(stop)?;
        let (hypotheses, found) = match named {
            None => {
                let (hypotheses, found) = self.known.read().search(&suspect, None, MOST_MATCHES);
                (hypotheses, found.into_iter().map(|found| (found, FrameName::Blind)).collect())
            }
            Some(records) => self.search_named(&suspect, records, stop)?,
        };
        let (vertices, triangles) = (mesh.positions().len(), mesh.triangles().len());
        Ok(Searched { format, vertices, triangles, hypotheses, found })
    }

    fn search_named(
        &self,
        suspect: &Suspect,
        records: &[Record],
        stop: &Stop,
    ) -> Result<(u64, Vec<(Found, FrameName)>), ServiceError> {
        let only: HashSet<u128> = records.iter().map(|record| record.id.as_u128()).collect();
        let (mut hypotheses, blind) = self.known.read().search(suspect, Some(&only), MOST_MATCHES);
        let mut best: HashMap<Uuid, (Found, FrameName)> =
            blind.into_iter().map(|found| (found.id, (found, FrameName::Blind))).collect();
        for record in records.iter().rev().take(MOST_IN_PLACE) {
            go_on(stop)?;
            let found = in_place(suspect, record, &codeword(&self.keys, record)?);
            hypotheses += 1;
            let entry = best.entry(record.id).or_insert((found, FrameName::InPlace));
            if found.log10_bound < entry.0.log10_bound {
                *entry = (found, FrameName::InPlace);
            }
        }
        Ok((hypotheses, best.into_values().collect()))
    }

    /// Counts the hypotheses, compares with the thresholds, names the owners.
    async fn judge(
        &self,
        searched: Searched,
        sha256: String,
    ) -> Result<Verification, ServiceError> {
        let certain = self.config.match_threshold_log10;
        let unclear = self.config.inconclusive_threshold_log10;
        // At most 2^53 hypotheses: exact.
        let counted = (searched.hypotheses.max(1) as f64).log10();
        let mut found = searched.found;
        found.sort_by(|(a, _), (b, _)| {
            a.log10_bound.total_cmp(&b.log10_bound).then(a.id.cmp(&b.id))
        });
        let mut matches = Vec::new();
        for (candidate, frame) in found.into_iter().take(MOST_MATCHES) {
            // (A bound that is no number becomes 0 here: it matches nothing.)
            let log10_fp = (candidate.log10_bound + counted).min(0.0);
            if log10_fp >= unclear {
                continue;
            }
            let record = self.registry.record(candidate.id).await?;
            // Revoked while we searched.
            let Some(record) = record.filter(|record| record.revoked_at.is_none()) else {
                continue;
            };
            matches.push(Match {
                watermark_id: record.id,
                owner_id: record.owner_id,
                recipient: record.recipient,
                label: record.label,
                registered_at: record.created_at,
                log10_fp,
                bits_agreeing: candidate.bits_agreeing,
                bits_read: candidate.bits_read,
                frame,
            });
        }
        let verdict = match matches.first() {
            Some(best) if best.log10_fp < certain => Verdict::Match,
            Some(_) => Verdict::Inconclusive,
            None => Verdict::NoMatch,
        };
        Ok(Verification {
            id: Uuid::now_v7(),
            created_at: now()?,
            verdict,
            threshold_log10: certain,
            inconclusive_threshold_log10: unclear,
            hypotheses: searched.hypotheses,
            matches,
            file: FileFacts {
                sha256,
                format: searched.format.extension().to_owned(),
                vertices: searched.vertices,
                triangles: searched.triangles,
            },
        })
    }
}

/// Scores one record in its host's own frame.
fn in_place(suspect: &Suspect, record: &Record, codeword: &Codeword) -> Found {
    let seen = suspect.in_frame(&record.frame);
    let soft = seen.read(codeword.lattice_class(), record.bits, record.method.modulation());
    let score = soft.score(codeword);
    Found {
        id: record.id,
        log10_bound: soft.log10_bound(score.t),
        bits_agreeing: score.bits_agreeing,
        bits_read: score.bits_read,
    }
}

fn go_on(stop: &Stop) -> Result<(), ServiceError> {
    if stop.now() { Err(JobError::DeadlinePassed.into()) } else { Ok(()) }
}
