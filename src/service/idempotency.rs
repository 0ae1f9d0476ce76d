//! Idempotency keys: a retry gets the same record and the same bytes.
//!
//! The registry remembers the keys that were used. [`InProgress`] holds the keys in use now, so
//! that only one of two equal requests at the same time does the work.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use sha2::{Digest, Sha256};

use super::embed::EmbedRequest;
use super::{OnExisting, ServiceError};

type Key = (String, String);

/// Keys of requests that are running.
#[derive(Debug, Clone, Default)]
pub(super) struct InProgress(Arc<Mutex<HashSet<Key>>>);

/// Holds a key until dropped.
#[derive(Debug)]
pub(super) struct Holding {
    keys: InProgress,
    key: Key,
}

impl InProgress {
    pub(super) fn hold(&self, owner_id: &str, key: &str) -> Result<Holding, ServiceError> {
        let key = (owner_id.to_owned(), key.to_owned());
        let mut keys = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !keys.insert(key.clone()) {
            return Err(ServiceError::IdempotencyInProgress);
        }
        Ok(Holding { keys: self.clone(), key })
    }
}

impl Drop for Holding {
    fn drop(&mut self) {
        self.keys.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.key);
    }
}

/// Refuses a key that is not 1 to 255 visible ASCII characters.
pub(super) fn check_key(key: &str) -> Result<(), ServiceError> {
    if (1..=255).contains(&key.len()) && key.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Ok(());
    }
    Err(ServiceError::InvalidParameter {
        parameter: "Idempotency-Key",
        reason: "must be 1 to 255 visible ASCII characters, such as a UUID".to_owned(),
    })
}

/// SHA-256 over everything that decides the answer. Each part is preceded by its length, so that no
/// two requests give the same bytes.
pub(super) fn fingerprint(request: &EmbedRequest) -> [u8; 32] {
    let mut hash = Sha256::new();
    let mut part = |bytes: Option<&[u8]>| {
        let length = bytes.map_or(u64::MAX, |bytes| bytes.len() as u64);
        hash.update(length.to_le_bytes());
        hash.update(bytes.unwrap_or_default());
    };
    let text = |text: &Option<super::Text>| text.as_ref().map(|text| text.as_str().to_owned());
    part(Some(request.owner_id.as_str().as_bytes()));
    part(text(&request.recipient).as_deref().map(str::as_bytes));
    part(text(&request.label).as_deref().map(str::as_bytes));
    part(Some(request.method.to_string().as_bytes()));
    part(Some(&request.strength.unwrap_or_default().get().to_le_bytes()));
    part(Some(&(request.bits.get() as u64).to_le_bytes()));
    part(request.payload.as_deref());
    part(Some(&[u8::from(request.keep_file), u8::from(request.keep_host)]));
    part(Some(&request.file.sha256));
    // Hashed only when given, so that requests from before this field existed keep their
    // fingerprints. With a limit, a given strength is an upper bound, and a strength that is not
    // given sets none.
    if let Some(limit) = request.max_distortion {
        part(Some(&limit.get().to_le_bytes()));
        part(Some(&[u8::from(request.strength.is_some())]));
    }
    if let Some(layers) = request.layers {
        part(Some(layers.name().as_bytes()));
    }
    // Hashed only when it is not the default, for the same reason.
    if request.on_existing != OnExisting::default() {
        part(Some(request.on_existing.name().as_bytes()));
    }
    hash.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_per_owner() {
        let keys = InProgress::default();
        let held = keys.hold("acme", "k").unwrap();
        assert!(matches!(keys.hold("acme", "k"), Err(ServiceError::IdempotencyInProgress)));
        let _other = keys.hold("other", "k").unwrap();
        drop(held);
        keys.hold("acme", "k").unwrap();
    }

    #[test]
    fn keys_are_short_and_visible() {
        let longest = "k".repeat(255);
        let too_long = "k".repeat(256);
        for (key, fits) in [
            ("k", true),
            (longest.as_str(), true),
            (too_long.as_str(), false),
            ("", false),
            ("a b", false),
        ] {
            assert_eq!(check_key(key).is_ok(), fits, "{key:?}");
        }
    }
}
