//! The hosts in memory, from which short lists are drawn.
//!
//! Copies of one host for many recipients are one host here, by the key of its geometry, whatever
//! file it came in. Each host has a sketch. A host that is a marked file is found by the sketch of
//! the eldest host that it descends from (`families`), because a short list must not depend on
//! codewords. Must not know how the hosts of a short list are scored.

use std::collections::HashMap;
use std::sync::{PoisonError, RwLock};

use futures::TryStreamExt as _;
use futures::stream;
use tracing::warn;
use uuid::Uuid;

use super::families::Families;
use super::{Service, StartError};
use crate::registration::{GeometryIndex, Probe, Sketch};
use crate::registry::Record;

/// A host, named by the first half of the key of its geometry.
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

/// Fewest hits by shared connectivity or lengths that count: fewer are likely to be chance.
const LEAST_HITS: u32 = 2;

#[derive(Default)]
struct Inner {
    geometry: GeometryIndex,
    /// Records of each host, approximately in the order of their registration.
    records: HashMap<HostKey, Vec<Uuid>>,
    families: Families,
    /// Sketches of hosts that are found by the sketch of an elder host.
    younger: HashMap<HostKey, Sketch>,
}

impl Inner {
    /// Puts the sketch of a host into the index, or among the sketches of the younger hosts.
    fn place(&mut self, key: HostKey, sketch: Sketch) {
        self.geometry.remove(key.0);
        if self.families.eldest(key) == key {
            self.geometry.insert(key.0, &sketch);
        } else {
            self.younger.insert(key, sketch);
        }
    }

    /// The hosts of a family, in order of registration.
    fn family(&self, eldest: HostKey) -> Vec<HostKey> {
        let younger = self.younger.keys().filter(|&&host| self.families.eldest(host) == eldest);
        let mut family: Vec<HostKey> = younger.copied().chain([eldest]).collect();
        family.sort_unstable_by_key(|&host| self.families.place(host));
        family
    }
}

/// All hosts whose geometry is kept, shared by all requests. A panic under the lock leaves the
/// index searchable, so a poisoned lock is ignored.
#[derive(Default)]
pub(super) struct Hosts(RwLock<Inner>);

impl Hosts {
    /// Adds a record whose host is kept. `parents` are the geometries of the hosts whose marks that
    /// host carried.
    pub(super) fn insert(&self, record: &Record, sketch: Option<Sketch>, parents: &[[u8; 32]]) {
        let Some(key) = HostKey::of(record) else { return };
        let mut inner = self.0.write().unwrap_or_else(PoisonError::into_inner);
        inner.families.insert(key);
        for parent in parents {
            inner.families.descends(key, HostKey::new(parent));
        }
        let records = inner.records.entry(key).or_default();
        records.push(record.id);
        let first = records.len() == 1;
        if (first || !parents.is_empty())
            && let Some(sketch) = sketch
        {
            inner.place(key, sketch);
        }
    }

    /// Removes a record, and its host with the last record.
    pub(super) fn remove(&self, record: &Record) {
        let Some(key) = HostKey::of(record) else { return };
        let mut inner = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let Some(records) = inner.records.get_mut(&key) else { return };
        records.retain(|&id| id != record.id);
        if records.is_empty() {
            inner.records.remove(&key);
            inner.geometry.remove(key.0);
            inner.younger.remove(&key);
            inner.families.remove(key);
            // Hosts that were found by the sketch of the removed host.
            let orphans: Vec<HostKey> = inner.younger.keys().copied().collect();
            for orphan in orphans
                .into_iter()
                .filter(|&host| inner.families.eldest(host) == host)
                .collect::<Vec<_>>()
            {
                if let Some(sketch) = inner.younger.remove(&orphan) {
                    inner.place(orphan, sketch);
                }
            }
        }
    }

    /// Number of hosts.
    pub(super) fn len(&self) -> usize {
        self.0.read().unwrap_or_else(PoisonError::into_inner).records.len()
    }

    /// The records of a host, approximately in the order of their registration.
    pub(super) fn records_of(&self, key: HostKey) -> Vec<Uuid> {
        let inner = self.0.read().unwrap_or_else(PoisonError::into_inner);
        inner.records.get(&key).cloned().unwrap_or_default()
    }

    /// The eldest host of a host's family.
    pub(super) fn eldest(&self, key: HostKey) -> HostKey {
        self.0.read().unwrap_or_else(PoisonError::into_inner).families.eldest(key)
    }

    /// The hosts that are most like the suspect, likeliest first: by shared parts, then by shape
    /// descriptor. A family is listed at the rank of its eldest host, in order of registration.
    pub(super) fn shortlist(&self, probe: &Probe, most: usize) -> Vec<HostKey> {
        let inner = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let parts = inner.geometry.by_parts(probe, most);
        let outlines = inner.geometry.by_descriptor(probe, most);
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
        let mut all: Vec<HostKey> = listed.into_iter().flat_map(|key| inner.family(key)).collect();
        all.truncate(most);
        all
    }
}

impl Service {
    /// Fills the index of hosts.
    pub(super) async fn load_hosts(&self) -> Result<(), StartError> {
        let end = self.registry.last_row().await?;
        let mut records: HashMap<HostKey, Vec<Uuid>> = HashMap::new();
        let mut families = Families::default();
        let step = i64::from(ROWS);
        let mut start = 0;
        while start < end {
            for (id, geometry) in self.registry.hosts(start, start + step).await? {
                let key = HostKey::new(&geometry);
                // Rows are in the order of registration; ids may be in another.
                families.insert(key);
                records.entry(key).or_default().push(id);
            }
            start += step;
        }
        for (host, parent) in self.registry.host_parents().await? {
            families.descends(HostKey::new(&host), HostKey::new(&parent));
        }
        let batches = stream::try_unfold(0, |after| async move {
            let batch = self.registry.sketches(after, ROWS).await?;
            let last = batch.last().map(|sketch| sketch.row);
            Ok::<_, StartError>(last.map(|last| (batch, last)))
        });
        let (geometry, younger) = batches
            .try_fold(
                (GeometryIndex::default(), HashMap::new()),
                |(mut geometry, mut younger), batch| {
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
                    let (found, by_elder): (Vec<_>, Vec<_>) = known
                        .into_iter()
                        .partition(|(id, _)| families.eldest(HostKey(*id)) == HostKey(*id));
                    geometry.extend(found.iter().map(|(id, sketch)| (*id, sketch)));
                    younger.extend(by_elder.into_iter().map(|(id, sketch)| (HostKey(id), sketch)));
                    std::future::ready(Ok((geometry, younger)))
                },
            )
            .await?;
        let mut inner = self.hosts.0.write().unwrap_or_else(PoisonError::into_inner);
        *inner = Inner { geometry, records, families, younger };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::Shape;
    use crate::registry::sample_record;
    use crate::sample::Sample;

    fn shape(sample: Sample) -> Shape {
        Shape::new(Surface::new(&sample.mesh(2_000).unwrap())).unwrap()
    }

    fn record(host: u8) -> Record {
        Record { host_geometry: Some([host; 32]), host_kept: true, ..sample_record() }
    }

    /// Older hosts keep their ranks on the list, whatever the sketch of a host that is a marked
    /// file.
    #[test]
    fn a_marked_file_that_becomes_a_host_moves_nobody_on_the_list() {
        let keys = [1, 2, 3].map(|host| HostKey::new(&[host; 32]));
        let probe = Probe::new(&shape(Sample::Blob));
        let mut lists = Vec::new();
        for younger in [None, Some(Sample::Blob), Some(Sample::Knot), Some(Sample::Gear)] {
            let hosts = Hosts::default();
            let sketch = |sample| Some(Sketch::new(&shape(sample)));
            let eldest = record(1);
            hosts.insert(&eldest, sketch(Sample::Blob), &[]);
            hosts.insert(&record(2), sketch(Sample::Gear), &[]);
            if let Some(sample) = younger {
                hosts.insert(&record(3), sketch(sample), &[[1; 32]]);
            }
            let list = hosts.shortlist(&probe, 8);
            if younger.is_some() {
                assert_eq!(list[..2], [keys[0], keys[2]], "{younger:?}: it stands with its elder");
                assert_eq!(hosts.eldest(keys[2]), keys[0]);
            }
            lists.push(list.into_iter().filter(|&key| key != keys[2]).collect::<Vec<_>>());
            // Without its elder, the host is found by its own sketch.
            hosts.remove(&eldest);
            assert_eq!(hosts.eldest(keys[2]), keys[2]);
            let alone = hosts.shortlist(&probe, 8);
            assert!(!alone.contains(&keys[0]), "{younger:?}");
            if younger == Some(Sample::Blob) {
                assert_eq!(alone.first(), Some(&keys[2]));
            }
        }
        assert!(lists.iter().all(|list| *list == lists[0] && list.contains(&keys[0])));
    }
}
