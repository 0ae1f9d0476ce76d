//! Registering a mark: a record exists if and only if its file could be handed out (I3).
//!
//! The order is: blobs, one registry transaction, index. On every way out but success the blobs are
//! removed, and a host's blob only if no other record uses it. A revocation comes before the
//! transaction or after the index, never between them.

use std::sync::Arc;

use bytes::Bytes;
use tracing::error;
use uuid::Uuid;

use super::known::codeword;
use super::{Service, ServiceError};
use crate::blobs::{GeometryKey, Kind};
use crate::registration::Sketch;
use crate::registry::{IdempotencyEntry, Record, RegistryError};

/// The parts of a host that are kept for detectors that compare suspects with it.
pub(super) struct KeptHost {
    /// The key that it is stored under: the record's `host_geometry`.
    pub(super) key: GeometryKey,
    /// Its geometry, packed.
    pub(super) geometry: Bytes,
    /// The sketch by which it is found; none if its shape allows no sketch.
    pub(super) sketch: Option<Sketch>,
}

impl Service {
    /// Writes the blobs, then the registry, then the index: a record exists if and only if its file
    /// could be handed out.
    pub(super) async fn register(
        self: &Arc<Self>,
        record: &Record,
        file: Option<Bytes>,
        host: Option<KeptHost>,
        idempotency: Option<(String, [u8; 32])>,
    ) -> Result<(), ServiceError> {
        let codeword = codeword(&self.keys, &record.source())?;
        let carried = record.existing_marks.iter().flatten().map(|mark| mark.watermark_id);
        let carried = self.registry.records(&carried.collect::<Vec<Uuid>>()).await?;
        let parents: Vec<[u8; 32]> =
            carried.iter().filter_map(|older| older.host_geometry).collect();
        let held = host.as_ref().map(|host| host.key);
        if let Some(key) = &held {
            self.blobs.hold_host(key).await;
        }
        let mut undo = RemoveBlobs { service: self.clone(), id: Some(record.id), held };
        let (host, sketch) = host.map(|host| ((host.key, host.geometry), host.sketch)).unzip();
        let sketch = sketch.flatten();
        if let (Some(key), Some(sketch)) = (&held, &sketch) {
            self.registry.keep_sketch(key, &sketch.to_bytes()).await?;
        }
        let stored = match self.put_blobs(record.id, file, host).await {
            Ok(()) => {
                // Held until the index agrees with the registry.
                let order = self.order.read().await;
                self.commit(record, idempotency).await.map(|()| order)
            }
            Err(error) => Err(error),
        };
        let order = match stored {
            Ok(order) => order,
            Err(error) => {
                // Removed before the answer: a client that receives the error finds nothing left.
                if let Some(id) = undo.id.take() {
                    self.remove_unregistered(id, held).await;
                }
                return Err(error);
            }
        };
        undo.id = None;
        if let Some(key) = &held {
            self.blobs.keep_host(key).await;
        }
        let (service, record) = (self.clone(), record.clone());
        // A search may hold the lock: wait for it on a blocking thread.
        let inserted = tokio::task::spawn_blocking(move || {
            service.known.insert(&record, &codeword);
            if record.host_kept {
                service.hosts.insert(&record, sketch, &parents);
            }
        });
        let inserted = inserted.await;
        drop(order);
        inserted.map_err(|error| ServiceError::Internal(error.to_string()))
    }

    async fn put_blobs(
        &self,
        id: Uuid,
        file: Option<Bytes>,
        host: Option<(GeometryKey, Bytes)>,
    ) -> Result<(), ServiceError> {
        if let Some(bytes) = file {
            self.blobs.put(Kind::File, id, bytes).await?;
        }
        if let Some((key, bytes)) = host {
            self.blobs.put_host(&key, bytes).await?;
        }
        Ok(())
    }

    async fn commit(
        &self,
        record: &Record,
        idempotency: Option<(String, [u8; 32])>,
    ) -> Result<(), ServiceError> {
        let entry = idempotency.map(|(key, fingerprint)| IdempotencyEntry {
            owner_id: record.owner_id.clone(),
            key,
            fingerprint,
            watermark_id: record.id,
        });
        match self.registry.register(record, entry.as_ref()).await {
            Err(RegistryError::IdempotencyTaken) => Err(ServiceError::IdempotencyInProgress),
            other => Ok(other?),
        }
    }

    async fn remove_unregistered(&self, id: Uuid, held: Option<GeometryKey>) {
        // A commit whose answer was lost may have succeeded: then the blobs are needed.
        if matches!(self.registry.existing(&[id]).await.as_deref(), Ok([]))
            && let Err(error) = self.blobs.remove(id).await
        {
            error!(%id, %error, "files of a failed request stay until the next start");
        }
        let Some(key) = held else { return };
        let is_used = async { Ok::<_, ServiceError>(self.registry.uses_host(&key).await?) };
        if let Err(error) = self.blobs.release_host(&key, is_used).await {
            error!(%id, %error, "the host of a failed request stays until the next start");
        }
    }
}

/// Removes a record's blobs when it is dropped before the record was registered, after a panic or
/// when the task is cut off.
struct RemoveBlobs {
    service: Arc<Service>,
    id: Option<Uuid>,
    /// The key of the host that is held for the record.
    held: Option<GeometryKey>,
}

impl Drop for RemoveBlobs {
    fn drop(&mut self) {
        let Some(id) = self.id else { return };
        let (service, held) = (self.service.clone(), self.held);
        self.service.tasks.spawn(async move { service.remove_unregistered(id, held).await });
    }
}

#[cfg(test)]
mod tests;
