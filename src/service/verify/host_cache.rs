//! Hosts and filters that were used lately, kept in memory: preparing a host takes as long as
//! comparing one suspect with it.

use std::sync::Arc;

use quick_cache::Weighter;
use quick_cache::sync::Cache;

use super::super::ServiceError;
use super::super::hosts::HostKey;
use crate::jobs::Stop;
use crate::recognition::HostModel;
use crate::registry::Record;
use crate::watermark::{BitCount, EmbedParams, HostFilter, Method};

/// Most bytes of the hosts, and of the filters: enough for some twenty hosts of 50,000 vertices
/// each.
const BYTES: u64 = 256 << 20;

/// The size of an entry that the cache is laid out for.
const USUAL_BYTES: u64 = 16 << 20;

/// Everything that a filter depends on: the host, and these fields of the record.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct FilterKey {
    host: HostKey,
    class: u8,
    method: Method,
    strength_bits: u64,
    bits: BitCount,
}

#[derive(Clone)]
struct Bytes;

impl Weighter<HostKey, Arc<HostModel>> for Bytes {
    fn weight(&self, _: &HostKey, host_model: &Arc<HostModel>) -> u64 {
        host_model.bytes() as u64
    }
}

impl Weighter<FilterKey, Arc<HostFilter>> for Bytes {
    fn weight(&self, _: &FilterKey, filter: &Arc<HostFilter>) -> u64 {
        filter.bytes() as u64
    }
}

/// The caches.
pub(in super::super) struct HostCache {
    host_cache: Cache<HostKey, Arc<HostModel>, Bytes>,
    filters: Cache<FilterKey, Arc<HostFilter>, Bytes>,
}

impl HostCache {
    /// Empty caches.
    pub(in super::super) fn new() -> Self {
        let entries = usize::try_from(BYTES / USUAL_BYTES).unwrap_or(1);
        Self {
            host_cache: Cache::with_weighter(entries, BYTES, Bytes),
            filters: Cache::with_weighter(entries, BYTES, Bytes),
        }
    }

    /// A host, if it is in memory.
    pub(super) fn host_model(&self, key: HostKey) -> Option<Arc<HostModel>> {
        self.host_cache.get(&key)
    }

    /// Keeps a host.
    pub(super) fn keep(&self, key: HostKey, host_model: &Arc<HostModel>) {
        self.host_cache.insert(key, host_model.clone());
    }

    /// The filter on a host for the marks of one layout class with the method, strength and number
    /// of bits of `record`.
    pub(super) fn filter(
        &self,
        host: (HostKey, &HostModel),
        record: &Record,
        class: u8,
        stop: &Stop,
    ) -> Result<Arc<HostFilter>, ServiceError> {
        let strength = record.strength;
        let (method, bits) = (record.method, record.bits);
        let strength_bits = strength.get().to_bits();
        let key = FilterKey { host: host.0, class, method, strength_bits, bits };
        if let Some(filter) = self.filters.get(&key) {
            return Ok(filter);
        }
        let params = EmbedParams { method, strength, bits, closed_loop: true };
        let made = HostFilter::new_until(host.1.mesh(), class, &params, &|| stop.now());
        super::go_on(stop)?;
        let filter = Arc::new(made?);
        self.filters.insert(key, filter.clone());
        Ok(filter)
    }
}
