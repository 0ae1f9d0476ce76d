//! The marks that a request asks about.

use uuid::Uuid;

use super::super::known::mark_key;
use super::super::{BATCH, Service, ServiceError, Text};
use super::VerifyRequest;
use crate::registry::Record;

/// Most records whose details are fetched: those with the last ids.
const DETAILED: usize = 4096;

/// The live records that a request names.
#[derive(Debug)]
pub(super) struct Named {
    /// The ids of all of them, ascending.
    ids: Vec<u128>,
    /// Those of the records with the last ids that can be read, in the order of their ids.
    records: Vec<Record>,
    /// Whether the request names one record by its id.
    by_id: bool,
}

impl Named {
    /// Whether the request names this record.
    pub(super) fn contains(&self, id: Uuid) -> bool {
        self.ids.binary_search(&id.as_u128()).is_ok()
    }

    /// Whether the request names one record by its id.
    pub(super) fn by_id(&self) -> bool {
        self.by_id
    }

    /// All ids, ascending.
    pub(super) fn ids(&self) -> &[u128] {
        &self.ids
    }

    /// Records in the order of their ids. For most owners these are all that can be read.
    pub(super) fn records(&self) -> &[Record] {
        &self.records
    }
}

impl Service {
    /// The marks that the request names; `None` if it names none.
    ///
    /// # Errors
    /// [`ServiceError::NothingToCompare`] when no mark that the request asks about can be searched
    /// for: an answer of `no_match` would say that a search was made.
    pub(super) async fn named(
        &self,
        request: &VerifyRequest,
    ) -> Result<Option<Named>, ServiceError> {
        let owner_id = request.owner_id.as_ref().map(Text::as_str);
        let named = match (request.watermark_id, owner_id) {
            (Some(id), owner_id) => Some(self.named_mark(id, owner_id).await?),
            (None, Some(owner_id)) => Some(self.marks_of(owner_id).await?),
            (None, None) => None,
        };
        if !self.is_searched(named.as_ref()) {
            // A mark that is being registered is in the registry before it is in the index: wait
            // for it.
            drop(self.order.write().await);
            if !self.is_searched(named.as_ref()) {
                self.explain(named.as_ref(), owner_id).await?;
            }
        }
        Ok(named)
    }

    /// Whether any mark that the request asks about is searched for.
    fn is_searched(&self, named: Option<&Named>) -> bool {
        named.map_or(self.known.len() > 0, |named| self.searches(named))
    }

    /// Whether any of these marks is searched for.
    pub(super) fn searches(&self, named: &Named) -> bool {
        self.known.has_any(named.ids())
    }

    async fn named_mark(&self, id: Uuid, owner_id: Option<&str>) -> Result<Named, ServiceError> {
        let record = self.registry.record(id).await?.ok_or(ServiceError::UnknownWatermark(id))?;
        if let Some(owner_id) = owner_id.filter(|&owner_id| owner_id != record.owner_id) {
            return Err(ServiceError::NothingToCompare(format!(
                "the watermark {id} is not one of {owner_id:?}; leave out owner_id or watermark_id"
            )));
        }
        if let Some(at) = record.revoked_at {
            return Err(ServiceError::NothingToCompare(format!(
                "the watermark {id} was revoked at {at}, and revoked marks are not searched for"
            )));
        }
        Ok(Named { ids: vec![id.as_u128()], records: self.readable(vec![record]), by_id: true })
    }

    async fn marks_of(&self, owner_id: &str) -> Result<Named, ServiceError> {
        let (mut ids, mut after) = (Vec::new(), None);
        loop {
            let batch = self.registry.live_ids(owner_id, after, BATCH).await?;
            let Some(&last) = batch.last() else { break };
            after = Some(last);
            ids.extend(batch);
        }
        let newest = ids.split_at(ids.len().saturating_sub(DETAILED)).1;
        let mut records = self.registry.records(newest).await?;
        // Some may have been revoked in the meantime.
        records.retain(|record| record.revoked_at.is_none());
        let ids = ids.iter().map(Uuid::as_u128).collect();
        Ok(Named { ids, records: self.readable(records), by_id: false })
    }

    /// Keeps the records whose master keys are available; the others are not searched for.
    pub(super) fn readable(&self, mut records: Vec<Record>) -> Vec<Record> {
        let has_key = |Record { key_id, salt, owner_id, .. }: &Record| {
            mark_key(&self.keys, key_id, salt, owner_id).is_ok()
        };
        records.retain(has_key);
        records
    }

    /// Says why no mark can be searched for. An empty registry is no such case if the request names
    /// nobody: then the true answer is that the file carries no registered mark.
    async fn explain(
        &self,
        named: Option<&Named>,
        owner_id: Option<&str>,
    ) -> Result<(), ServiceError> {
        let unreadable = |which: String| {
            format!(
                "{which} cannot be read, because the master key that made it is missing; put the key \
                 back (quadmark keys list names those that are there) and start again"
            )
        };
        let reason = match (named, owner_id) {
            (None, _) => match self.registry.counts(None).await?.live {
                0 => return Ok(()),
                live => unreadable(format!("every one of the {live} registered marks")),
            },
            (Some(named), Some(owner_id)) if named.ids.is_empty() => {
                match self.registry.counts(Some(owner_id)).await?.revoked {
                    0 => format!(
                        "no mark of the owner {owner_id:?} is registered (owner ids are compared \
                         letter by letter); leave out owner_id to compare with all marks"
                    ),
                    revoked => format!(
                        "all marks of the owner {owner_id:?} were revoked ({revoked} of them), and \
                         revoked marks are not searched for"
                    ),
                }
            }
            (Some(named), _) => match named.ids.as_slice() {
                &[id] => unreadable(format!("the watermark {}", Uuid::from_u128(id))),
                ids => unreadable(format!("every one of the {} marks asked about", ids.len())),
            },
        };
        Err(ServiceError::NothingToCompare(reason))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::super::test_support::{keys, service};
    use super::super::Depth;
    use super::*;
    use crate::registry::{Registry as _, Sqlite, sample_record};
    use crate::sample::{Sample, to_obj};

    async fn request(service: &Service, owner_id: Option<&str>, id: Option<Uuid>) -> VerifyRequest {
        let obj = to_obj(&Sample::Blob.mesh(2_000).unwrap());
        let spool =
            service.spool(service.admit_upload(None).unwrap()).unwrap().write(&obj).await.unwrap();
        VerifyRequest {
            file: spool.end(None).await.unwrap(),
            owner_id: owner_id.map(|owner_id| Text::parse("owner_id", owner_id).unwrap()),
            watermark_id: id,
            depth: Depth::Standard,
        }
    }

    /// A service that has loaded these records.
    async fn with(directory: &std::path::Path, records: &[&Record]) -> Arc<Service> {
        let registry = Sqlite::open(directory).await.unwrap();
        for record in records {
            registry.register(record, None).await.unwrap();
        }
        let service = service(directory, registry);
        service.load().await.unwrap();
        service.load_hosts().await.unwrap();
        service
    }

    #[tokio::test]
    async fn marks_without_their_master_key_are_nothing_to_compare_with() {
        let directory = tempfile::tempdir().unwrap();
        let lost = sample_record();
        let service = with(directory.path(), &[&lost]).await;
        let asked = [(None, None), (Some("acme"), None), (None, Some(lost.id))];
        for (owner_id, id) in asked {
            let request = request(&service, owner_id, id).await;
            let refused = service.verify(request).await.unwrap_err();
            assert!(matches!(refused, ServiceError::NothingToCompare(_)), "{refused}");
            assert!(refused.to_string().contains("master key"), "{refused}");
        }
    }

    #[tokio::test]
    async fn a_lost_key_does_not_stop_the_search_for_the_other_marks() {
        let directory = tempfile::tempdir().unwrap();
        let lost = Record { host_kept: true, ..sample_record() };
        let known =
            Record { id: Uuid::now_v7(), key_id: keys().current().to_owned(), ..lost.clone() };
        let service = with(directory.path(), &[&lost, &known]).await;
        for owner_id in [None, Some("acme")] {
            let request = request(&service, owner_id, None).await;
            let verdict = service.verify(request).await.unwrap();
            assert!(verdict.hypotheses > 0 && verdict.matches.is_empty());
        }
    }

    #[tokio::test]
    async fn an_empty_registry_is_compared_with_unless_somebody_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let service = with(directory.path(), &[]).await;
        let verdict = service.verify(request(&service, None, None).await).await.unwrap();
        assert_eq!(verdict.hypotheses, 0);
        let refused = service.verify(request(&service, Some("acme"), None).await).await;
        assert!(matches!(refused, Err(ServiceError::NothingToCompare(_))));
    }
}
