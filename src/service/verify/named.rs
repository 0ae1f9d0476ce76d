//! The marks that a request asks about.

use uuid::Uuid;

use super::super::{BATCH, Service, ServiceError, Text};
use super::VerifyRequest;
use crate::registry::Record;

/// Records whose details are fetched: the newest.
const DETAILED: usize = 4096;

/// The live records that a request names.
#[derive(Debug)]
pub(super) struct Named {
    /// All of them, ascending.
    ids: Vec<u128>,
    /// The newest, oldest first.
    records: Vec<Record>,
}

impl Named {
    /// Whether it names a record.
    pub(super) fn contains(&self, id: Uuid) -> bool {
        self.ids.binary_search(&id.as_u128()).is_ok()
    }

    /// All ids, ascending.
    pub(super) fn ids(&self) -> &[u128] {
        &self.ids
    }

    /// The newest records, oldest first; of most owners all.
    pub(super) fn records(&self) -> &[Record] {
        &self.records
    }
}

impl Service {
    /// What the request names; `None` when it names nothing.
    pub(super) async fn named(
        &self,
        request: &VerifyRequest,
    ) -> Result<Option<Named>, ServiceError> {
        let owner_id = request.owner_id.as_ref().map(Text::as_str);
        if let Some(id) = request.watermark_id {
            let record =
                self.registry.record(id).await?.ok_or(ServiceError::UnknownWatermark(id))?;
            let theirs = owner_id.is_none_or(|owner_id| record.owner_id == owner_id);
            let live = record.revoked_at.is_none();
            let records = Vec::from_iter((theirs && live).then_some(record));
            let ids = records.iter().map(|record| record.id.as_u128()).collect();
            return Ok(Some(Named { ids, records }));
        }
        let Some(owner_id) = owner_id else { return Ok(None) };
        let (mut ids, mut after) = (Vec::new(), None);
        loop {
            let batch = self.registry.live_ids(owner_id, after, BATCH).await?;
            let Some(&last) = batch.last() else { break };
            after = Some(last);
            ids.extend(batch);
        }
        let newest = ids.split_at(ids.len().saturating_sub(DETAILED)).1;
        let mut records = self.registry.records(newest).await?;
        // Revoked in the meantime.
        records.retain(|record| record.revoked_at.is_none());
        Ok(Some(Named { ids: ids.iter().map(Uuid::as_u128).collect(), records }))
    }
}
