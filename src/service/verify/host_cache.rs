//! Hosts and filters that were needed lately, kept in memory: preparing a host takes as long as
//! looking at it from one suspect.

use std::sync::Arc;

use quick_cache::Weighter;
use quick_cache::sync::Cache;

use super::super::ServiceError;
use super::super::hosts::HostKey;
use crate::jobs::Stop;
use crate::recognition::HostModel;
use crate::registry::Record;
use crate::watermark::{BitCount, EmbedParams, HostFilter, Method};

/// Bytes that hosts, and as many that filters may take: some twenty hosts of 50,000 vertices each.
const BYTES: u64 = 256 << 20;

/// Of which size the cache expects its entries to be.
const USUAL_BYTES: u64 = 16 << 20;

/// What a filter depends on besides the host: nothing else of the record.
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
    /// Empty ones.
    pub(in super::super) fn new() -> Self {
        let entries = usize::try_from(BYTES / USUAL_BYTES).unwrap_or(1);
        Self {
            host_cache: Cache::with_weighter(entries, BYTES, Bytes),
            filters: Cache::with_weighter(entries, BYTES, Bytes),
        }
    }

    /// A host, if it is there.
    pub(super) fn host_model(&self, key: HostKey) -> Option<Arc<HostModel>> {
        self.host_cache.get(&key)
    }

    /// Keeps a host.
    pub(super) fn keep(&self, key: HostKey, host_model: &Arc<HostModel>) {
        self.host_cache.insert(key, host_model.clone());
    }

    /// The filter on a host of the marks of a layout class that are otherwise like a record's.
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
