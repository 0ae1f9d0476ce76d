//! Embed: marks a host, registers the mark, and hands out the file.
//!
//! The order of work: look for marks, mark and check (on the pool), blobs, one registry
//! transaction, index, answer. A failure after the blobs removes them; the next start sweeps what a
//! crash left. The work runs as a task of its own: a client that hangs up leaves a whole record or
//! none.

use std::sync::{Arc, OnceLock};

use jiff::Timestamp;
use tracing::error;
use uuid::Uuid;

use super::known::mark_key;
use super::making::{MarkingJob, StrengthChoice, is_about_the_codeword, layers_of};
use super::{Content, OnExisting, Service, ServiceError, Spooled, Text, idempotency};
use crate::blobs::Kind;
use crate::formats::Format;
use crate::keys::random_bytes;
use crate::marking::{Layers, MaxDistortion, most_tries};
use crate::registry::{IdempotencyEntry, Record};
use crate::watermark::{BitCount, MarkKey, Message, Method, Strength};

/// The scheme that this release embeds.
const SCHEME: u16 = 1;

/// Salts that are tried in turn where the blind layer is refused. Of ten marks each, two on a gear
/// and five on a hammer, whose norms are crowded, needed a second or third salt, and none a fourth.
/// Each salt costs one embedding, and refused tries are charged for.
pub const SALTS: u32 = 4;

/// What to embed, and into what.
#[derive(Debug)]
pub struct EmbedRequest {
    /// The host.
    pub file: Spooled,
    /// Whose mark it is.
    pub owner_id: Text,
    /// The recipient of this copy.
    pub recipient: Option<Text>,
    /// Free text.
    pub label: Option<Text>,
    /// The embedding method.
    pub method: Method,
    /// The layers; by default both if the host is kept, otherwise the blind layer.
    pub layers: Option<Layers>,
    /// The strength of the blind layer; with `max_distortion`, its upper limit.
    pub strength: Option<Strength>,
    /// The distortion within which to mark as strongly as possible.
    pub max_distortion: Option<MaxDistortion>,
    /// Number of bits.
    pub bits: BitCount,
    /// The message; random when the caller gives none.
    pub payload: Option<Vec<u8>>,
    /// Keep the marked file.
    pub keep_file: bool,
    /// Keep the host's geometry.
    pub keep_host: bool,
    /// What to do when the host already carries a registered mark.
    pub on_existing: OnExisting,
    /// Formats that the caller accepts. A host of another format is refused before any work.
    pub formats: Vec<Format>,
    /// The caller's idempotency key.
    pub idempotency_key: Option<String>,
}

/// A registered mark and its file.
#[derive(Debug)]
pub struct Embedded {
    /// The record.
    pub record: Record,
    /// The marked file.
    pub content: Content,
    /// Whether an earlier request with the same idempotency key made it.
    pub replayed: bool,
}

impl Service {
    /// Marks a host and registers the mark, or answers a retry with the earlier result.
    ///
    /// # Errors
    /// [`ServiceError`]; then nothing is registered and nothing is kept.
    pub async fn embed(self: &Arc<Self>, request: EmbedRequest) -> Result<Embedded, ServiceError> {
        // Cheap refusals come first.
        if let Some(key) = &request.idempotency_key {
            idempotency::check_key(key)?;
        }
        if let Some(payload) = &request.payload {
            Message::from_bytes(payload, request.bits).map_err(|error| {
                ServiceError::InvalidParameter { parameter: "payload", reason: error.to_string() }
            })?;
        }
        let service = self.clone();
        self.run_detached(async move { service.embed_once(request).await }).await
    }

    async fn embed_once(self: Arc<Self>, request: EmbedRequest) -> Result<Embedded, ServiceError> {
        let Some(key) = request.idempotency_key.clone() else {
            return self.embed_new(request, None).await;
        };
        let owner_id = request.owner_id.as_str().to_owned();
        let _held = self.in_progress.hold(&owner_id, &key)?;
        let fingerprint = idempotency::fingerprint(&request);
        match self.registry.idempotency(&owner_id, &key).await? {
            Some(entry) if entry.fingerprint != fingerprint => {
                Err(ServiceError::IdempotencyConflict)
            }
            Some(entry) => self.replay(request, &entry).await,
            None => self.embed_new(request, Some((key, fingerprint))).await,
        }
    }

    async fn embed_new(
        self: &Arc<Self>,
        mut request: EmbedRequest,
        idempotency: Option<(String, [u8; 32])>,
    ) -> Result<Embedded, ServiceError> {
        let id = Uuid::now_v7();
        let owner_id = request.owner_id.as_str().to_owned();
        let salt: [u8; 32] = random_bytes()?;
        let other_salts: Vec<[u8; 32]> =
            (1..SALTS).map(|_| random_bytes()).collect::<Result<_, _>>()?;
        let message = match &request.payload {
            Some(payload) => Message::from_bytes(payload, request.bits)?,
            None => random_message(request.bits)?,
        };
        let key_id = self.keys.current().to_owned();
        let of_salt = |salt| mark_key(&self.keys, &key_id, salt, &owner_id);
        let key = of_salt(&salt)?;
        let others: Vec<MarkKey> = other_salts.iter().map(of_salt).collect::<Result<_, _>>()?;
        let host_sha256 = request.file.sha256;
        let file_name = request.file.name.take();
        let layers = layers_of(&request)?;
        let force = StrengthChoice::of(&request, layers);
        let (method, bits) = (request.method, request.bits);
        let message_bytes = message.to_bytes();
        let (keep_host, keep_file) = (request.keep_host, request.keep_file);
        let on_existing = Some(request.on_existing);
        let geometry = Arc::new(OnceLock::new());
        let making = MarkingJob {
            file: request.file,
            formats: request.formats,
            key,
            others,
            message,
            parameters: (method, bits, force),
            layers,
            keep_host,
            keep_file,
            on_existing,
            geometry: geometry.clone(),
        };
        let done = self.mark(making).await;
        let refused = match (&done, force) {
            (Ok(done), _) => done.refused,
            (Err(error), _) if !is_about_the_codeword(error) => 0,
            // A file that cannot carry the relief is tried again without.
            (Err(_), StrengthChoice::Exactly(..)) => 2 * SALTS,
            (Err(_), StrengthChoice::Within(..)) => most_tries(SALTS, layers),
        };
        // The next mark that is registered for this host and owner was chosen among these tries.
        // The host is identified by its geometry, because an added comment changes the file.
        if refused > 0
            && let Some(geometry) = geometry.get()
        {
            self.registry.refused(geometry, &owner_id, refused).await?;
        }
        let done = done?;
        let salt = match done.key.checked_sub(1) {
            None => salt,
            Some(place) => other_salts.get(place).copied().unwrap_or(salt),
        };
        let existing_marks = match &done.existing {
            Some(seen) => Some(self.owned(seen).await?),
            None => None,
        };
        let record = Record {
            id,
            owner_id,
            recipient: request.recipient.map(|text| text.as_str().to_owned()),
            label: request.label.map(|text| text.as_str().to_owned()),
            method,
            scheme: SCHEME,
            layers: done.layers,
            amplitude: done.amplitude,
            strength: done.strength,
            bits,
            key_id,
            salt,
            message: message_bytes,
            payload: request.payload,
            frame: done.frame,
            host_sha256,
            host_geometry: geometry.get().copied(),
            marked_sha256: done.marked_sha256,
            marked_bytes: done.marked.len() as u64,
            format: done.format,
            file_name,
            vertices: done.vertices,
            triangles: done.triangles,
            usable_bins: done.usable_bins,
            quality: Some(done.quality),
            existing_marks,
            file_kept: done.packed.is_some(),
            host_kept: done.host.is_some(),
            // In whole microseconds, the resolution of the registry.
            created_at: now()?,
            revoked_at: None,
        };
        let (host, marked) = (done.host, done.marked);
        let content = if let Some(file) = done.packed {
            self.register(&record, Some(file), host, idempotency).await?;
            self.content(&record).await?
        } else {
            // Written before the registration, because it may not fit on the disk.
            let content = self.spooled(id, marked).await?;
            self.register(&record, None, host, idempotency).await?;
            content
        };
        Ok(Embedded { record, content, replayed: false })
    }

    async fn replay(
        self: &Arc<Self>,
        request: EmbedRequest,
        entry: &IdempotencyEntry,
    ) -> Result<Embedded, ServiceError> {
        let record = self.live_record(entry).await?;
        takes(&request.formats, record.format)?;
        let content = self.made_before(request, record).await?;
        // The mark may have been revoked while the file was fetched or made again.
        let record = self.live_record(entry).await?;
        Ok(Embedded { record, content, replayed: true })
    }

    /// The record of an idempotency key, unless it was revoked.
    async fn live_record(&self, entry: &IdempotencyEntry) -> Result<Record, ServiceError> {
        let id = entry.watermark_id;
        let record = self.registry.record(id).await?.ok_or(ServiceError::UnknownWatermark(id))?;
        match record.revoked_at {
            None => Ok(record),
            Some(at) => Err(ServiceError::IdempotencyRevoked { key: entry.key.clone(), id, at }),
        }
    }

    /// The marked file of a record: from the store, or made again from the uploaded host.
    async fn made_before(
        self: &Arc<Self>,
        request: EmbedRequest,
        record: Record,
    ) -> Result<Content, ServiceError> {
        let id = record.id;
        if record.file_kept {
            match self.content(&record).await {
                Ok(content) => return Ok(content),
                Err(error) => error!(%id, %error, "a marked file is made again"),
            }
        }
        // Marking is deterministic: the same host, key and message give the same bytes.
        let message = Message::from_bytes(&record.message, record.bits)?;
        let key = mark_key(&self.keys, &record.key_id, &record.salt, &record.owner_id)?;
        let making = MarkingJob {
            file: request.file,
            formats: request.formats,
            key,
            others: Vec::new(),
            message,
            parameters: (
                record.method,
                record.bits,
                StrengthChoice::Exactly(record.strength, record.amplitude.unwrap_or_default()),
            ),
            layers: record.layers,
            keep_host: false,
            keep_file: record.file_kept,
            on_existing: None,
            geometry: Arc::default(),
        };
        let done = self.mark(making).await?;
        if done.marked_sha256 != record.marked_sha256 {
            return Err(ServiceError::CannotRemake(id));
        }
        if let Some(file) = done.packed {
            self.blobs.put(Kind::File, id, file).await?;
            return self.content(&record).await;
        }
        self.spooled(id, done.marked).await
    }
}

/// Refuses a format that the caller does not accept.
pub(super) fn takes(formats: &[Format], format: Format) -> Result<(), ServiceError> {
    if formats.contains(&format) { Ok(()) } else { Err(ServiceError::FormatNotTaken(format)) }
}

fn random_message(bits: BitCount) -> Result<Message, ServiceError> {
    let random: [u8; 32] = random_bytes()?;
    let drawn = random.iter().flat_map(|byte| (0..8).map(move |place| byte >> place & 1 == 1));
    Ok(Message::from_bits(drawn.take(bits.get()).collect())?)
}

pub(super) fn now() -> Result<Timestamp, ServiceError> {
    Timestamp::from_microsecond(Timestamp::now().as_microsecond())
        .map_err(|error| ServiceError::Internal(error.to_string()))
}
