//! The marks in memory: the codewords of all live records, in agreement with the registry.
//!
//! Codewords are derived here and stored nowhere. Must not know how they are scored.

use std::collections::HashSet;
use std::sync::{PoisonError, RwLock};

use uuid::Uuid;

use super::ServiceError;
use crate::keys::KeyRing;
use crate::registry::{MarkSource, Record};
use crate::watermark::{Codeword, CodewordIndex, GroupKey, MarkKey, Message, Modulation};

/// A record's id, the statistic that carries its mark, and its codeword.
pub(super) type Mark = (u128, Modulation, Codeword);

/// The codeword that a record's file carries.
///
/// # Errors
/// [`ServiceError::Internal`] when the master key is missing, or the record's message is not valid.
pub(super) fn codeword(keys: &KeyRing, source: &MarkSource) -> Result<Codeword, ServiceError> {
    let key = mark_key(keys, &source.key_id, &source.salt, &source.owner_id)?;
    let message = Message::from_bytes(&source.message, source.bits)
        .map_err(|error| ServiceError::Internal(format!("message of {}: {error}", source.id)))?;
    Ok(Codeword::new(&key, &message))
}

pub(super) fn mark_key(
    keys: &KeyRing,
    key_id: &str,
    salt: &[u8; 32],
    owner_id: &str,
) -> Result<MarkKey, ServiceError> {
    Ok(MarkKey::from_bytes(*keys.mark_key(key_id, salt, owner_id)?))
}

/// The index of codewords by record id, shared by all requests. A search works on a clone, which
/// shares the rows. So nobody waits for a search, and every search that begins after a registration
/// finds the record.
///
/// A poisoned lock is ignored: what a panic could leave half changed matters less than refusing all
/// requests.
#[derive(Default)]
pub(super) struct Known(RwLock<CodewordIndex>);

impl Known {
    /// All marks at this moment.
    pub(super) fn marks(&self) -> CodewordIndex {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn insert(&self, record: &Record, codeword: &Codeword) {
        let mut index = self.0.write().unwrap_or_else(PoisonError::into_inner);
        index.insert(record.id.as_u128(), record.method.modulation(), codeword);
    }

    /// Adds many marks that the index does not have yet, in any order.
    pub(super) fn extend(&self, marks: Vec<Mark>) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).extend(marks);
    }

    pub(super) fn remove(&self, record: &Record, codeword: &Codeword) {
        let key = GroupKey::of(codeword, record.method.modulation());
        let mut index = self.0.write().unwrap_or_else(PoisonError::into_inner);
        index.remove(record.id.as_u128(), key);
    }

    /// Whether any of these records is searched for. The ids are ascending.
    pub(super) fn has_any(&self, ids: &[u128]) -> bool {
        !self.marks().only(ids).is_empty()
    }

    pub(super) fn len(&self) -> usize {
        self.0.read().unwrap_or_else(PoisonError::into_inner).len()
    }
}

/// Live marks that cannot be searched for, mostly because their master key is missing.
#[derive(Default)]
pub(super) struct Unreadable(RwLock<HashSet<Uuid>>);

impl Unreadable {
    pub(super) fn extend(&self, ids: Vec<Uuid>) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).extend(ids);
    }

    pub(super) fn remove(&self, id: Uuid) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).remove(&id);
    }

    pub(super) fn len(&self) -> usize {
        self.0.read().unwrap_or_else(PoisonError::into_inner).len()
    }
}

/// The mark of a source, in the form that the index takes.
pub(super) fn mark(keys: &KeyRing, source: &MarkSource) -> Result<Mark, ServiceError> {
    let codeword = codeword(keys, source)?;
    Ok((source.id.as_u128(), source.method.modulation(), codeword))
}
