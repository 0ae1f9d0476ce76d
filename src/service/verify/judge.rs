//! The answer: names the owners of the found marks, and says what the verdict rests on.

use uuid::Uuid;

use super::super::embed::now;
use super::super::existing::either;
use super::super::verdict::{
    Evidence, FileFacts, FrameFacts, Match, StageName, StageRun, Verdict, Verification,
};
use super::super::{Service, ServiceError};
use super::cascade::{Found, MOST_MATCHES};
use super::charge::Charge;
use super::count::share;
use super::{Depth, Searched};
use crate::registry::{ExistingMark, Record};

/// A file with less than this share of its surface on the host's surface is another object. Copies
/// under the attacks of the acceptance table have 0.9 and more; other objects with a host's norms
/// have less than 0.3.
const SAME_SHAPE: f64 = 0.5;

impl Service {
    pub(super) async fn judge(
        &self,
        searched: Searched,
        depth: Depth,
        sha256: String,
    ) -> Result<Verification, ServiceError> {
        let thresholds = self.thresholds();
        let on_host = searched.outcome.on_host;
        let told = |record, found: &Found| Match {
            on_host: on_host.get(&found.id).copied(),
            ..named(record, found, thresholds.certain)
        };
        let mut matches = Vec::new();
        let best = searched.outcome.found.into_iter().take(MOST_MATCHES).collect();
        let (charged, questions) = self.charged(&searched.questions, best).await?;
        let worth = |found: &Found| found.log10_fp < thresholds.inconclusive;
        for found in charged.into_iter().filter(worth) {
            let record = self.registry.record(found.id).await?;
            // The record may have been revoked during the search.
            let live = record.filter(|record| record.revoked_at.is_none());
            matches
                .extend(live.map(|record| (record.existing_marks.clone(), told(record, &found))));
        }
        let asked = |id| searched.named.as_ref().is_none_or(|named| named.contains(id));
        let mut below: Vec<(ExistingMark, Match)> = Vec::new();
        for (existing, over) in &matches {
            if over.log10_fp < thresholds.certain {
                let existing = existing.iter().flatten();
                below.extend(existing.map(|mark| (mark.clone(), over.clone())));
            }
        }
        for found in searched.later {
            let tally = self.registry.tally(found.id).await?;
            let found = found.charged(Charge::new(&tally, None, false));
            if found.log10_fp >= thresholds.certain {
                continue;
            }
            let record = self.registry.record(found.id).await?;
            let Some(record) = record.filter(|record| record.revoked_at.is_none()) else {
                continue;
            };
            let existing = record.existing_marks.clone().into_iter().flatten();
            let over = told(record, &found);
            below.extend(existing.map(|mark| (mark, over.clone())));
        }
        below.retain(|(mark, _)| asked(mark.watermark_id));
        let matches = matches.into_iter().map(|(_, found)| found).collect();
        let matches = self.with_those_below(matches, below).await?;
        let verdict = match matches.first() {
            Some(best) if best.log10_fp >= thresholds.certain => Verdict::Inconclusive,
            Some(best) if best.on_host.is_some_and(|share| share < SAME_SHAPE) => {
                Verdict::BlindOnly
            }
            Some(_) => Verdict::Match,
            None => Verdict::NoMatch,
        };
        let stages: Vec<StageRun> = searched
            .outcome
            .tried
            .into_iter()
            .map(|(stage, hypotheses)| StageRun { stage, hypotheses, error_share: share(stage) })
            .collect();
        Ok(Verification {
            id: Uuid::now_v7(),
            created_at: now()?,
            verdict,
            threshold_log10: thresholds.certain,
            inconclusive_threshold_log10: thresholds.inconclusive,
            depth,
            questions,
            hypotheses: stages.iter().map(|run| run.hypotheses).sum(),
            stages,
            matches,
            file: FileFacts {
                sha256,
                format: searched.format.extension().to_owned(),
                vertices: searched.vertices,
                triangles: searched.triangles,
            },
            compared_hosts: searched.compared_hosts,
        })
    }
}

impl Service {
    /// Adds marks that lie below other marks that match. A later mark overwrites an earlier one,
    /// and what is left of the earlier one is not always enough to read it. But the record of the
    /// later mark names the earlier one.
    async fn with_those_below(
        &self,
        mut matches: Vec<Match>,
        below: Vec<(ExistingMark, Match)>,
    ) -> Result<Vec<Match>, ServiceError> {
        let certain = self.thresholds().certain;
        for (mark, over) in below {
            let id = mark.watermark_id;
            if matches.iter().any(|known| known.watermark_id == id && known.log10_fp < certain) {
                continue;
            }
            let record = self.registry.record(id).await?;
            let Some(record) = record.filter(|record| record.revoked_at.is_none()) else {
                continue;
            };
            matches.retain(|weaker| weaker.watermark_id != id);
            matches.push(Match {
                watermark_id: id,
                owner_id: record.owner_id,
                recipient: record.recipient,
                label: record.label,
                registered_at: record.created_at,
                log10_fp: either(mark.log10_fp, over.log10_fp),
                overmarked_by: Some(over.watermark_id),
                ..over
            });
        }
        matches.sort_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp));
        Ok(matches)
    }
}

fn named(record: Record, found: &Found, certain: f64) -> Match {
    let score = found.candidate.score;
    let hypothesis = &found.candidate.hypothesis;
    let signed = hypothesis.soft.signed_weights();
    let evidence = Evidence {
        stage: found.stage,
        frame: FrameFacts {
            centre: hypothesis.frame.centre.to_array(),
            rho_min: hypothesis.frame.rho_min,
            rho_max: hypothesis.frame.rho_max,
        },
        bits_read: score.bits_read,
        erasures: signed.len() - score.bits_read.min(signed.len()),
        weights: match found.stage {
            StageName::Relief => Vec::new(),
            _ => signed.iter().map(|w| w.abs()).collect(),
        },
        score: score.t,
        log10_bound: found.candidate.log10_bound,
        counted: found.counted,
        tries: found.charge.tries,
        siblings: found.charge.siblings,
        questions: found.charge.questions,
        charged: found.charge.factor(),
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
        overmarked_by: None,
        frame: found.frame,
        on_host: None,
        evidence: (found.log10_fp < certain).then_some(evidence),
    }
}
