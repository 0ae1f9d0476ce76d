//! Questions: which records a verification asks about, and what that costs.
//!
//! The stages run with the charge that this question will cost a record if no other question is
//! answered before it. When the answer is ready, the question is counted, durably, for the records
//! that the request names and for those that the answer names. The resulting charge is the one in
//! the answer. A data directory that is only read is not changed: each question there costs what
//! the next counted one would. Whoever has the directory can ask any number of questions.

use std::sync::Arc;

use sha2::{Digest, Sha256};
use tokio::runtime::Handle;
use uuid::Uuid;

use super::super::{Service, ServiceError};
use super::VerifyRequest;
use super::cascade::Found;
use super::charge::{Charge, Charges, NEARLY};
use super::named::Named;

/// What a verification asks about.
pub(super) struct Questions {
    /// Hash that identifies the question: the file, and the way it is asked about.
    question: [u8; 32],
    /// Records that the request names.
    about: Vec<Uuid>,
    /// Whether the request names one record, by its id.
    alone: bool,
    /// The charges that the question would give now.
    charges: Charges,
}

impl Questions {
    pub(super) fn charges(&self) -> &Charges {
        &self.charges
    }
}

/// SHA-256 over everything that decides what is scored, except the registry. Each part is preceded
/// by its length.
pub(super) fn identify(request: &VerifyRequest) -> [u8; 32] {
    let owner_id = request.owner_id.as_ref().map_or("", |text| text.as_str());
    let watermark_id = request.watermark_id.map(|id| id.to_string()).unwrap_or_default();
    let parts = [request.depth.name(), owner_id, &watermark_id];
    let mut hash = Sha256::new();
    hash.update(request.file.sha256);
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hash.finalize().into()
}

impl Service {
    /// The records that a request asks about, before it is answered.
    pub(super) fn questions(
        self: &Arc<Self>,
        question: [u8; 32],
        named: Option<&Named>,
    ) -> Questions {
        let few = named.filter(|named| named.ids().len() <= NEARLY);
        let ids = few.map(Named::ids).unwrap_or_default();
        let about: Vec<Uuid> = ids.iter().map(|&id| Uuid::from_u128(id)).collect();
        let alone = named.is_some_and(Named::by_id);
        let (service, runtime) = (self.clone(), Handle::current());
        let lookup = move |id| {
            let registry = &service.registry;
            let known =
                async { (registry.tally(id).await, registry.question(id, &question).await) };
            match runtime.block_on(known) {
                (Ok(tally), Ok(nth)) => Some(Charge::new(&tally, Some(nth), alone)),
                // A charge that the registry does not report now is needed before the answer.
                _ => None,
            }
        };
        Questions { question, about, alone, charges: Charges::asking(Arc::new(lookup)) }
    }

    /// Counts the question that is about to be answered, and charges the findings. Also returns the
    /// number of this question about the record with the most questions; 0 if it is about none.
    pub(super) async fn charged(
        &self,
        questions: &Questions,
        found: Vec<Found>,
    ) -> Result<(Vec<Found>, u64), ServiceError> {
        let mut about = questions.about.clone();
        about.extend(found.iter().map(|found| found.id));
        about.sort_unstable();
        about.dedup();
        let mut asked = Vec::new();
        if self.only_reads {
            for &id in &about {
                asked.push((id, self.registry.question(id, &questions.question).await?));
            }
        } else if !about.is_empty() {
            asked = self.registry.ask(&about, &questions.question).await?;
        }
        let mut charged = Vec::with_capacity(found.len());
        for found in found {
            let tally = self.registry.tally(found.id).await?;
            let question = asked.iter().find(|(id, _)| *id == found.id).map(|(_, nth)| *nth);
            charged.push(found.charged(Charge::new(&tally, question, questions.alone)));
        }
        charged.sort_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp).then(a.id.cmp(&b.id)));
        Ok((charged, asked.iter().map(|(_, nth)| *nth).max().unwrap_or(0)))
    }
}
