//! Records: one record, a page of records, and revoking a record.

use std::sync::Arc;

use uuid::Uuid;

use super::embed::now;
use super::known::codeword;
use super::{Service, ServiceError};
use crate::registry::{Cursor, Filter, Order, Page, Record, RegistryError};

/// Most records on one page.
pub const MAX_PAGE: u32 = 200;

impl Service {
    /// One record, revoked or not.
    ///
    /// # Errors
    /// [`ServiceError::UnknownWatermark`].
    pub async fn record(&self, id: Uuid) -> Result<Record, ServiceError> {
        self.registry.record(id).await?.ok_or(ServiceError::UnknownWatermark(id))
    }

    /// A page of records, in the order of their registration.
    ///
    /// # Errors
    /// [`ServiceError::InvalidParameter`] for a limit outside 1 to 200, or for a cursor that is not
    /// of this registry.
    pub async fn page(
        &self,
        filter: &Filter,
        order: Order,
        cursor: Option<&str>,
        limit: u32,
    ) -> Result<Page, ServiceError> {
        let refuse = |parameter, reason: &str| ServiceError::InvalidParameter {
            parameter,
            reason: reason.to_owned(),
        };
        if !(1..=MAX_PAGE).contains(&limit) {
            return Err(refuse("limit", "must be from 1 to 200"));
        }
        let after =
            match cursor {
                None => None,
                Some(text) => Some(Cursor::from_text(text).ok_or_else(|| {
                    refuse("cursor", "is not one; take it from a page, unchanged")
                })?),
            };
        match self.registry.page(filter, order, after, limit).await {
            Err(RegistryError::ForeignCursor) => {
                Err(refuse("cursor", "is not of this registry; begin without one"))
            }
            page => Ok(page?),
        }
    }

    /// Revokes a mark: its record is kept, and the mark is no longer searched for. A second call
    /// changes nothing.
    ///
    /// # Errors
    /// [`ServiceError::UnknownWatermark`].
    pub async fn revoke(self: &Arc<Self>, id: Uuid) -> Result<Record, ServiceError> {
        let service = self.clone();
        let revoked = async move {
            // Waits for the registrations under way, so that what they insert is removed here.
            let order = service.order.write().await;
            let revoked = service.registry.revoke(id, now()?).await?;
            let record = revoked.ok_or(ServiceError::UnknownWatermark(id))?;
            let (revoked, memory) = (record.clone(), service.clone());
            // A search may hold the locks: wait for them on a blocking thread.
            let removed = tokio::task::spawn_blocking(move || {
                memory.hosts.remove(&revoked);
                memory.unreadable.remove(revoked.id);
                // A mark without its master key was never in the index.
                if let Ok(codeword) = codeword(&memory.keys, &revoked.source()) {
                    memory.known.remove(&revoked, &codeword);
                }
            });
            let removed = removed.await;
            drop(order);
            removed.map_err(|error| ServiceError::Internal(error.to_string()))?;
            Ok(record)
        };
        self.run_detached(revoked).await
    }

    /// Number of blobs, for operators and tests.
    ///
    /// # Errors
    /// [`ServiceError::Internal`].
    pub async fn blob_count(&self) -> Result<usize, ServiceError> {
        Ok(self.blobs.count().await?)
    }
}
