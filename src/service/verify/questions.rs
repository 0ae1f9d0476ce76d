//! Questions: which records a verification asks about by name, or nearly so, and what that costs.
//!
//! The ladder climbs with what this question will cost if no other is answered before it. When the
//! answer is ready, the question is counted, durably, and what it then costs is what is charged. A data
//! directory that is only read is not changed: each question there costs what the next one would. Who
//! has the directory can ask as often as he likes.

use uuid::Uuid;

use super::super::{Service, ServiceError};
use super::charge::{Charge, Charges, NEARLY};
use super::ladder::Found;
use super::named::Named;

/// What a verification asks about.
#[derive(Debug, Default)]
pub(super) struct Questions {
    /// Records that are named, or nearly.
    about: Vec<Uuid>,
    /// There is one, and it is named by its id.
    alone: bool,
    /// What is known of them beforehand.
    charges: Charges,
}

impl Questions {
    pub(super) fn charges(&self) -> &Charges {
        &self.charges
    }
}

impl Service {
    /// What a request asks about, before it is answered.
    pub(super) async fn questions(&self, named: Option<&Named>) -> Result<Questions, ServiceError> {
        let about: Vec<Uuid> = match named {
            Some(named) if named.ids().len() <= NEARLY => {
                named.ids().iter().map(|&id| Uuid::from_u128(id)).collect()
            }
            None if self.known.len() <= NEARLY => {
                self.known.marks().ids().into_iter().map(Uuid::from_u128).collect()
            }
            _ => Vec::new(),
        };
        let alone = named.is_some_and(Named::by_id);
        let mut charges = Charges::default();
        for &id in &about {
            let tally = self.registry.tally(id).await?;
            let question = Some(tally.asked.saturating_add(1));
            charges.set(id, Charge::new(&tally, question, alone));
        }
        Ok(Questions { about, alone, charges })
    }

    /// Counts the questions that are about to be answered and charges what was found; how often the
    /// record that was asked about most has been asked about, 0 where nobody counts.
    pub(super) async fn charged(
        &self,
        questions: &Questions,
        found: Vec<Found>,
    ) -> Result<(Vec<Found>, u64), ServiceError> {
        let asked = if self.only_reads {
            let of = |&id| (id, questions.charges.of(id).questions);
            questions.about.iter().map(of).collect()
        } else if questions.about.is_empty() {
            Vec::new()
        } else {
            self.registry.ask(&questions.about).await?
        };
        let mut charged = Vec::with_capacity(found.len());
        for found in found {
            let tally = self.registry.tally(found.id).await?;
            let question = asked.iter().find(|(id, _)| *id == found.id).map(|(_, asked)| *asked);
            charged.push(found.charged(Charge::new(&tally, question, questions.alone)));
        }
        charged.sort_by(|a, b| a.log10_fp.total_cmp(&b.log10_fp).then(a.id.cmp(&b.id)));
        Ok((charged, asked.iter().map(|(_, asked)| *asked).max().unwrap_or(0)))
    }
}
