//! The marks in memory: codewords of all live records, kept in step with the registry.
//!
//! Codewords are derived here and nowhere stored. Must not know how they are scored.

use std::collections::HashSet;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use uuid::Uuid;

use super::ServiceError;
use crate::keys::KeyRing;
use crate::registry::Record;
use crate::watermark::{Codeword, CodewordIndex, MarkKey, Message, Suspect};

/// The codeword that a record's file carries.
///
/// # Errors
/// [`ServiceError::Internal`] when the master key is not there, or the record's message is not one.
pub(super) fn codeword(keys: &KeyRing, record: &Record) -> Result<Codeword, ServiceError> {
    let key = mark_key(keys, &record.key_id, &record.salt, &record.owner_id)?;
    let message = Message::from_bytes(&record.message, record.bits)
        .map_err(|error| ServiceError::Internal(format!("message of {}: {error}", record.id)))?;
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

/// One record that may have marked the suspect.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) id: Uuid,
    /// log10 of the bound for this one hypothesis, before counting.
    pub(super) log10_bound: f64,
    pub(super) bits_agreeing: usize,
    pub(super) bits_read: usize,
}

/// An index of codewords by record id.
#[derive(Default)]
pub(super) struct Known(CodewordIndex);

impl Known {
    pub(super) fn insert(&mut self, record: &Record, codeword: &Codeword) {
        self.0.insert(record.id.as_u128(), record.method.modulation(), codeword);
    }

    pub(super) fn remove(&mut self, id: Uuid) {
        self.0.remove(id.as_u128());
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Scores all, or only those named, in the blind frame: how many hypotheses, and the best of
    /// them, best first.
    pub(super) fn search(
        &self,
        suspect: &Suspect,
        only: Option<&HashSet<u128>>,
        most: usize,
    ) -> (u64, Vec<Found>) {
        let search = self.0.search(suspect, only, most);
        let found = search.candidates.into_iter().map(|candidate| Found {
            id: Uuid::from_u128(candidate.id),
            log10_bound: candidate.log10_bound,
            bits_agreeing: candidate.score.bits_agreeing,
            bits_read: candidate.score.bits_read,
        });
        (search.hypotheses, found.collect())
    }
}

/// [`Known`], shared. A panic while it was held cannot leave it half changed in a way that
/// matters more than refusing all requests would, so poisoning is ignored.
#[derive(Default)]
pub(super) struct SharedKnown(RwLock<Known>);

impl SharedKnown {
    pub(super) fn read(&self) -> RwLockReadGuard<'_, Known> {
        self.0.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn write(&self) -> RwLockWriteGuard<'_, Known> {
        self.0.write().unwrap_or_else(PoisonError::into_inner)
    }
}
