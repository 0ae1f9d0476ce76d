//! The answer: names the owners of what was found and says what it rests on.

use uuid::Uuid;

use super::super::embed::now;
use super::super::verdict::{FileFacts, FrameFacts, How, Match, TriedStage, Verdict, Verification};
use super::super::{Service, ServiceError};
use super::count::share;
use super::ladder::{Found, MOST_MATCHES};
use super::{Depth, Searched};
use crate::registry::Record;

impl Service {
    pub(super) async fn judge(
        &self,
        searched: Searched,
        depth: Depth,
        sha256: String,
    ) -> Result<Verification, ServiceError> {
        let thresholds = self.thresholds();
        let mut matches = Vec::new();
        for found in searched.climbed.found.into_iter().take(MOST_MATCHES) {
            let record = self.registry.record(found.id).await?;
            // Revoked while we searched.
            let live = record.filter(|record| record.revoked_at.is_none());
            matches.extend(live.map(|record| named(record, &found)));
        }
        let verdict = match matches.first() {
            Some(best) if best.log10_fp < thresholds.certain => Verdict::Match,
            Some(_) => Verdict::Inconclusive,
            None => Verdict::NoMatch,
        };
        let tried: Vec<TriedStage> = searched
            .climbed
            .tried
            .into_iter()
            .map(|(stage, hypotheses)| TriedStage { stage, hypotheses, share: share(stage) })
            .collect();
        Ok(Verification {
            id: Uuid::now_v7(),
            created_at: now()?,
            verdict,
            threshold_log10: thresholds.certain,
            inconclusive_threshold_log10: thresholds.inconclusive,
            depth,
            hypotheses: tried.iter().map(|tried| tried.hypotheses).sum(),
            tried,
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

fn named(record: Record, found: &Found) -> Match {
    let score = found.candidate.score;
    let hypothesis = &found.candidate.hypothesis;
    let signed = hypothesis.soft.signed_weights();
    let how = How {
        stage: found.stage,
        frame: FrameFacts {
            centre: hypothesis.frame.centre.to_array(),
            rho_min: hypothesis.frame.rho_min,
            rho_max: hypothesis.frame.rho_max,
        },
        bits_read: score.bits_read,
        erasures: signed.len() - score.bits_read.min(signed.len()),
        weights: signed.iter().map(|w| w.abs()).collect(),
        score: score.t,
        log10_bound: found.candidate.log10_bound,
        counted: found.counted,
        log10_fp: found.log10_fp,
    };
    Match {
        watermark_id: record.id,
        owner_id: record.owner_id,
        recipient: record.recipient,
        label: record.label,
        registered_at: record.created_at,
        log10_fp: found.log10_fp,
        bits_agreeing: score.bits_agreeing,
        bits_read: score.bits_read,
        frame: found.frame,
        how,
    }
}
