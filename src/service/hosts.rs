//! The hosts in memory: what a short list is drawn from.
//!
//! Copies of one host for many recipients are one host here, by the key of its geometry: whichever file
//! it came in. Sketches are of hosts, never of marked meshes: a short list must not depend on codewords. Must not know how what
//! is on a short list is scored.

use std::collections::HashMap;
use std::sync::{PoisonError, RwLock};

use futures::TryStreamExt as _;
use futures::stream;
use tracing::warn;
use uuid::Uuid;

use super::{Service, StartError};
use crate::registration::{GeometryIndex, Probe, Sketch};
use crate::registry::Record;

/// A host, by the first half of the key of its geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct HostKey(u128);

impl HostKey {
    pub(super) fn new(geometry: &[u8; 32]) -> Self {
        let half = std::array::from_fn(|i| geometry.get(i).copied().unwrap_or_default());
        Self(u128::from_le_bytes(half))
    }

    /// The host of a record, if it is kept.
    pub(super) fn of(record: &Record) -> Option<Self> {
        record.host_geometry.as_ref().filter(|_| record.host_kept).map(Self::new)
    }
}

/// Rows per batch at the start.
const ROWS: u32 = 4096;

/// Where the suspect shares connectivity or lengths with so few hosts in common, chance does it.
const LEAST_HITS: u32 = 2;

#[derive(Default)]
struct Inner {
    geometry: GeometryIndex,
    /// Records of each host, in the order of their registration or nearly.
    records: HashMap<HostKey, Vec<Uuid>>,
}

/// All hosts whose geometry is kept, shared. A panic while it was held leaves it searchable, so
/// poisoning is ignored.
#[derive(Default)]
pub(super) struct Hosts(RwLock<Inner>);

impl Hosts {
    /// Adds a record whose host is kept.
    pub(super) fn insert(&self, record: &Record, sketch: Option<&Sketch>) {
        let Some(key) = HostKey::of(record) else { return };
        let mut inner = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let records = inner.records.entry(key).or_default();
        records.push(record.id);
        if records.len() == 1
            && let Some(sketch) = sketch
        {
            inner.geometry.insert(key.0, sketch);
        }
    }

    /// Takes a record out, and its host with the last of them.
    pub(super) fn remove(&self, record: &Record) {
        let Some(key) = HostKey::of(record) else { return };
        let mut inner = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let Some(records) = inner.records.get_mut(&key) else { return };
        records.retain(|&id| id != record.id);
        if records.is_empty() {
            inner.records.remove(&key);
            inner.geometry.remove(key.0);
        }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.0.read().unwrap_or_else(PoisonError::into_inner).records.len()
    }

    /// The records of a host, in the order of their registration or nearly.
    pub(super) fn records_of(&self, key: HostKey) -> Vec<Uuid> {
        let inner = self.0.read().unwrap_or_else(PoisonError::into_inner);
        inner.records.get(&key).cloned().unwrap_or_default()
    }

    /// The hosts that look most like the suspect, likeliest first: by shared parts, then by outline.
    pub(super) fn shortlist(&self, probe: &Probe, most: usize) -> Vec<HostKey> {
        let inner = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let parts = inner.geometry.by_parts(probe, most);
        let outlines = inner.geometry.by_outline(probe, most);
        let mut listed = Vec::new();
        let mut list = |id: u128| {
            let key = HostKey(id);
            if listed.len() < most && !listed.contains(&key) && inner.records.contains_key(&key) {
                listed.push(key);
            }
        };
        let telling = parts.iter().filter(|hit| hit.hits >= LEAST_HITS).take(most.div_ceil(2));
        let ids = telling.map(|hit| hit.id).chain(outlines.iter().map(|likeness| likeness.id));
        for id in ids.chain(parts.iter().map(|hit| hit.id)) {
            list(id);
        }
        listed
    }
}

impl Service {
    /// Fills the list of hosts.
    pub(super) async fn load_hosts(&self) -> Result<(), StartError> {
        let end = self.registry.last_row().await?;
        let mut records: HashMap<HostKey, Vec<Uuid>> = HashMap::new();
        let step = i64::from(ROWS);
        let mut start = 0;
        while start < end {
            for (id, geometry) in self.registry.hosts(start, start + step).await? {
                records.entry(HostKey::new(&geometry)).or_default().push(id);
            }
            start += step;
        }
        let batches = stream::try_unfold(0, |after| async move {
            let batch = self.registry.sketches(after, ROWS).await?;
            let last = batch.last().map(|sketch| sketch.row);
            Ok::<_, StartError>(last.map(|last| (batch, last)))
        });
        let geometry = batches
            .try_fold(GeometryIndex::default(), |mut geometry, batch| {
                let known = batch.iter().filter_map(|host| {
                    let key = HostKey::new(&host.geometry);
                    match Sketch::from_bytes(&host.sketch) {
                        Ok(sketch) => records.contains_key(&key).then_some((key.0, sketch)),
                        Err(error) => {
                            let host = hex::encode(host.geometry);
                            warn!(host, %error, "a host cannot be found by its shape");
                            None
                        }
                    }
                });
                let known: Vec<(u128, Sketch)> = known.collect();
                geometry.extend(known.iter().map(|(id, sketch)| (*id, sketch)));
                std::future::ready(Ok(geometry))
            })
            .await?;
        let mut inner = self.hosts.0.write().unwrap_or_else(PoisonError::into_inner);
        *inner = Inner { geometry, records };
        Ok(())
    }
}
