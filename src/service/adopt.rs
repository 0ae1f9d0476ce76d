//! Moves hosts of older releases, stored under the id of their record, to where each geometry is
//! stored once.
//!
//! The order is: the new blob is written, the record is changed, the old blob is removed. The next
//! start completes what a crash left in between. A host that cannot be moved stays where it is, and
//! is logged.

use tracing::{info, warn};
use uuid::Uuid;

use super::StartError;
use crate::blobs::{Blobs, Kind, geometry};
use crate::config::Config;
use crate::registry::Sqlite;

/// Moves all hosts that are stored under the id of their record.
pub(super) async fn hosts(
    config: &Config,
    registry: &Sqlite,
    blobs: &Blobs,
) -> Result<(), StartError> {
    let (mut moved, mut left) = (0_u64, 0_u64);
    for id in registry.hosts_of_their_own().await? {
        if one(config, registry, blobs, id).await? {
            moved += 1;
        } else {
            left += 1;
        }
    }
    if moved > 0 {
        info!(hosts = moved, "moved hosts to where each geometry is stored once");
    }
    if left > 0 {
        warn!(hosts = left, "hosts of older records are gone or damaged: run quadmark check");
    }
    Ok(())
}

async fn one(
    config: &Config,
    registry: &Sqlite,
    blobs: &Blobs,
    id: Uuid,
) -> Result<bool, StartError> {
    let Some(packed) = blobs.get(Kind::Host, id).await? else { return Ok(false) };
    let limits = config.limits;
    let bytes = packed.clone();
    let unpacked = tokio::task::spawn_blocking(move || {
        let mesh = geometry::unpack(&bytes, limits.max_vertices, limits.max_triangles)?;
        Ok::<_, geometry::GeometryError>(geometry::key(&mesh))
    });
    let key = match unpacked.await.map_err(|error| StartError::Load(error.to_string()))? {
        Ok(key) => key,
        Err(error) => {
            warn!(watermark = %id, %error, "a host cannot be moved");
            return Ok(false);
        }
    };
    blobs.hold_host(&key).await;
    blobs.put_host(&key, packed).await?;
    registry.adopt_host(id, &key).await?;
    blobs.keep_host(&key).await;
    blobs.remove_own_host(id).await?;
    Ok(true)
}
