//! The short list of hosts for the expensive detectors: hosts that are like the suspect in shape,
//! or that the request names. Shape alone decides, never a codeword, so only what is scored
//! afterwards is counted.

use std::sync::Arc;

use bytes::Bytes;
use uuid::Uuid;

use super::super::hosts::HostKey;
use super::super::memory::{self, Purpose};
use super::super::{Service, ServiceError};
use super::host_search::CandidateHost;
use super::named::Named;
use super::{Depth, go_on};
use crate::blobs::geometry;
use crate::jobs::Stop;
use crate::recognition::HostModel;
use crate::registration::{Probe, Shape};
use crate::registry::Record;
use crate::watermark::Suspect;

/// Most records of a host whose details are fetched: the newest. All records are scored in the
/// host's frame.
const DETAILED: usize = 16_384;

/// The part of the error probability that a family on the list leaves to the families after it, and
/// the part of a family's share that a host leaves to the younger hosts of the family.
const SHARE_LEFT: f64 = 0.4;

/// The error shares of the hosts of a list, from the family of each host: together at most 1.
fn shares<F: PartialEq>(families: &[F]) -> Vec<f64> {
    let mut seen: Vec<(&F, f64, f64)> = Vec::new();
    let size = |family: &F| families.iter().filter(|other| *other == family).count();
    let share = |family| {
        let at = seen.iter().position(|(known, ..)| *known == family).unwrap_or_else(|| {
            let (rank, alone) = (seen.len(), size(family) == 1);
            let of_family = (0..rank).fold(1.0 - SHARE_LEFT, |share, _| share * SHARE_LEFT);
            seen.push((family, of_family, if alone { 1.0 } else { 1.0 - SHARE_LEFT }));
            rank
        });
        let Some((_, of_family, own)) = seen.get_mut(at) else { return 0.0 };
        let share = *of_family * *own;
        *own *= SHARE_LEFT;
        share
    };
    families.iter().map(share).collect()
}

/// A host on the list, with its error share and its records.
pub(super) struct ListedHost {
    key: HostKey,
    share: f64,
    records: Vec<Uuid>,
}

/// Most hosts on the list.
fn max_hosts(depth: Depth) -> usize {
    if depth == Depth::Exhaustive { 24 } else { 8 }
}

/// A host on the list with its live records, and with its geometry unless that is in memory.
pub(super) struct FetchedHost {
    key: HostKey,
    share: f64,
    host_model: Option<Arc<HostModel>>,
    geometry: Option<Bytes>,
    ids: Vec<u128>,
    records: Vec<Record>,
}

impl Service {
    /// On the pool: the hosts to compare with and their records, likeliest first.
    pub(super) fn shortlist(
        &self,
        suspect: &Suspect,
        named: Option<&Named>,
        depth: Depth,
        stop: &Stop,
    ) -> Result<Vec<ListedHost>, ServiceError> {
        let listed = self.hosts_to_search(suspect, named, depth, stop);
        go_on(stop)?;
        let families: Vec<HostKey> = listed.iter().map(|&key| self.hosts.eldest(key)).collect();
        let listed = listed.into_iter().zip(shares(&families));
        let place = |(key, share)| ListedHost { key, share, records: self.hosts.records_of(key) };
        Ok(listed.map(place).collect())
    }

    fn hosts_to_search(
        &self,
        suspect: &Suspect,
        named: Option<&Named>,
        depth: Depth,
        stop: &Stop,
    ) -> Vec<HostKey> {
        let max_hosts = max_hosts(depth);
        let mut named_hosts: Vec<HostKey> = Vec::new();
        let records = named.map(Named::records).unwrap_or_default();
        for key in records.iter().rev().filter_map(HostKey::of) {
            if !named_hosts.contains(&key) {
                named_hosts.push(key);
            }
        }
        let all_there = named.is_some_and(|named| named.records().len() == named.ids().len());
        if all_there && named_hosts.len() <= 1 || self.hosts.len() == 0 {
            return named_hosts;
        }
        let asked = || stop.now();
        let shape = Shape::new_until(suspect.surface().clone(), &asked);
        let Some(probe) = shape.and_then(|shape| Probe::new_until(&shape, &asked)) else {
            named_hosts.truncate(max_hosts);
            return named_hosts;
        };
        let mut listed = self.hosts.shortlist(&probe, max_hosts);
        if let Some(named) = named {
            let theirs =
                |key: &HostKey| self.hosts.records_of(*key).iter().any(|id| named.contains(*id));
            listed.retain(theirs);
            named_hosts.retain(|key| !listed.contains(key));
            listed.extend(named_hosts);
            listed.truncate(max_hosts);
        }
        listed
    }

    /// Fetches what the expensive detectors need of the listed hosts. Hosts that are gone are left
    /// out.
    pub(super) async fn fetch(
        &self,
        listed: Vec<ListedHost>,
        named: Option<&Named>,
    ) -> Result<Vec<FetchedHost>, ServiceError> {
        let mut fetched = Vec::new();
        for ListedHost { key, share, records: of_host } in listed {
            let newest = of_host.split_at(of_host.len().saturating_sub(DETAILED)).1;
            let mut records = self.registry.records(newest).await?;
            records.retain(|record| record.revoked_at.is_none());
            let records = self.readable(records);
            let asked = |id: &&Uuid| named.is_none_or(|named| named.contains(**id));
            let mut ids: Vec<u128> = of_host.iter().filter(asked).map(Uuid::as_u128).collect();
            let host_model = self.host_cache.host_model(key);
            let geometry = match host_model {
                Some(_) => None,
                None => self.geometry_of(&records).await?,
            };
            if records.is_empty() || ids.is_empty() || (host_model.is_none() && geometry.is_none())
            {
                continue;
            }
            ids.sort_unstable();
            fetched.push(FetchedHost { key, share, host_model, geometry, ids, records });
        }
        Ok(fetched)
    }

    /// The host of a record with its records, if the host is kept.
    pub(super) async fn host_of(
        self: &Arc<Self>,
        id: Uuid,
    ) -> Result<Option<ListedHost>, ServiceError> {
        let Some(record) = self.registry.record(id).await? else { return Ok(None) };
        let Some(key) = HostKey::of(&record) else { return Ok(None) };
        // A registration may hold the lock: wait for it on a blocking thread.
        let service = self.clone();
        let records = tokio::task::spawn_blocking(move || service.hosts.records_of(key)).await;
        let records = records.map_err(|error| ServiceError::Internal(error.to_string()))?;
        Ok(Some(ListedHost { key, share: 1.0 - SHARE_LEFT, records }))
    }

    /// The stored geometry of a host. All its records have the same.
    async fn geometry_of(&self, records: &[Record]) -> Result<Option<Bytes>, ServiceError> {
        match records.first().and_then(|record| record.host_geometry) {
            Some(key) => Ok(self.blobs.host(&key).await?),
            None => Ok(None),
        }
    }

    /// On the pool: unpacks a host that is not in memory, and keeps it there.
    pub(super) fn candidate_host(
        &self,
        listed: FetchedHost,
        stop: &Stop,
    ) -> Result<Option<CandidateHost>, ServiceError> {
        let FetchedHost { key, share, host_model, geometry, ids, records } = listed;
        let host_model = match (host_model, geometry) {
            (Some(host_model), _) => host_model,
            (None, Some(bytes)) => {
                let limits = &self.config.limits;
                let (vertices, triangles) = (limits.max_vertices, limits.max_triangles);
                let asked = || stop.now();
                let mesh = geometry::unpack_until(&bytes, vertices, triangles, &asked);
                go_on(stop)?;
                let host_model = HostModel::new_until(mesh?, &asked);
                let host_model = Arc::new(host_model.ok_or_else(|| stop.reason())?);
                self.host_cache.keep(key, &host_model);
                host_model
            }
            (None, None) => return Ok(None),
        };
        Ok(Some(CandidateHost { key, host_model, share, ids, records }))
    }
}

impl FetchedHost {
    fn counts(&self) -> (u64, u64) {
        self.records.first().map_or((0, 0), |record| (record.vertices, record.triangles))
    }

    /// Its vertices and triangles together.
    pub(super) fn elements(&self) -> u64 {
        let (vertices, triangles) = self.counts();
        vertices.saturating_add(triangles)
    }

    /// Bytes of memory that the comparison with this host needs, approximately.
    pub(super) fn memory(&self) -> u64 {
        let (vertices, triangles) = self.counts();
        memory::of(vertices, triangles, Purpose::Host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_follow_from_families_and_add_up_to_at_most_one() {
        let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(same(&shares(&[1, 2, 3]), &[0.6, 0.24, 0.096]));
        // Two hosts of a family share its rank; the family after them keeps its own.
        assert!(same(&shares(&[1, 1, 2]), &[0.36, 0.144, 0.24]));
        assert!(same(&shares(&[1, 2, 1]), &[0.36, 0.24, 0.144]));
        for families in [vec![7; 24], (0..24).collect(), (0..24).map(|k| k % 5).collect()] {
            assert!(shares(&families).iter().sum::<f64>() <= 1.0);
        }
    }
}
