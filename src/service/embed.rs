//! Embed: mark a host, register the mark, hand out the file.
//!
//! The order of work: look for marks, mark and check (pool), blobs, one registry transaction, index, answer. What
//! fails after the blobs removes them; what a crash leaves there is swept at the next start. The
//! work is a task of its own: a client that hangs up leaves a whole record or none.

use std::sync::{Arc, OnceLock};

use bytes::Bytes;
use jiff::Timestamp;
use tracing::error;
use uuid::Uuid;

use super::content::packed;
use super::existing::Seen;
use super::known::mark_key;
use super::memory::{self, Purpose};
use super::register::KeptHost;
use super::{Content, OnExisting, Service, ServiceError, Spooled, Text, idempotency};
use crate::blobs::{Kind, geometry, marked};
use crate::formats::{Asset, Format, sniff};
use crate::jobs::{JobError, Stop};
use crate::keys::random_bytes;
use crate::marking::{
    Amplitude, Layers, MOST_STRENGTHS, MarkReport, MarkRequest, Marked, MaxDistortion, mark_asset,
    mark_asset_within,
};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::registration::{Shape, Sketch};
use crate::registry::{IdempotencyEntry, Quality, Record};
use crate::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Strength, WatermarkError};

/// The scheme that this release embeds.
const SCHEME: u16 = 1;

/// What to embed, and into what.
#[derive(Debug)]
pub struct EmbedRequest {
    /// The host.
    pub file: Spooled,
    /// Whose mark it is.
    pub owner_id: Text,
    /// To whom this copy goes.
    pub recipient: Option<Text>,
    /// Free text.
    pub label: Option<Text>,
    /// How.
    pub method: Method,
    /// Which layers; by default both where the host is kept, else the blind one.
    pub layers: Option<Layers>,
    /// How strongly the blind layer; with `max_distortion`, at most how strongly.
    pub strength: Option<Strength>,
    /// Mark as strongly as this allows.
    pub max_distortion: Option<MaxDistortion>,
    /// How many bits.
    pub bits: BitCount,
    /// The message; random when the caller gives none.
    pub payload: Option<Vec<u8>>,
    /// Keep the marked file.
    pub keep_file: bool,
    /// Keep the host's geometry.
    pub keep_host: bool,
    /// What to do when the host already carries a registered mark.
    pub on_existing: OnExisting,
    /// Formats that the caller takes back; a host of another is refused before any work.
    pub formats: Vec<Format>,
    /// The caller's key for retries.
    pub idempotency_key: Option<String>,
}

/// A registered mark and its file.
#[derive(Debug)]
pub struct Embedded {
    /// The record.
    pub record: Record,
    /// The marked file.
    pub content: Content,
    /// An earlier request with the same idempotency key made it.
    pub replayed: bool,
}

/// What the pool hands back.
struct Done {
    marked: Bytes,
    marked_sha256: [u8; 32],
    /// As it is stored, where it is kept.
    packed: Option<Bytes>,
    host: Option<KeptHost>,
    format: Format,
    frame: crate::watermark::Frame,
    vertices: u64,
    triangles: u64,
    usable_bins: u32,
    layers: Layers,
    amplitude: Option<Amplitude>,
    strength: Strength,
    /// Others that its codeword was tried with.
    refused_strengths: u32,
    quality: Quality,
    /// Marks that the host carried; none where nobody looked.
    existing: Option<Vec<Seen>>,
}

/// How strongly to mark.
#[derive(Clone, Copy)]
enum Force {
    /// With this strength of the blind layer and this amplitude of the relief.
    Exactly(Strength, Amplitude),
    /// As strongly as the distortion allows, the blind layer at most with this strength.
    Within(MaxDistortion, Strength),
}

impl Force {
    fn of(request: &EmbedRequest, layers: Layers) -> Self {
        match (request.max_distortion, request.strength) {
            (None, None) if layers.has_relief() => {
                Self::Within(MaxDistortion::USUAL, Strength::BESIDE_A_RELIEF)
            }
            (None, strength) => Self::Exactly(strength.unwrap_or_default(), Amplitude::default()),
            (Some(limit), strength) => Self::Within(limit, strength.unwrap_or(Strength::MAX)),
        }
    }
}

/// One marking.
struct Making {
    file: Spooled,
    /// Formats that the caller takes back.
    formats: Vec<Format>,
    key: MarkKey,
    message: Message,
    how: (Method, BitCount, Force),
    layers: Layers,
    keep_host: bool,
    keep_file: bool,
    /// Without it nobody looks what the host carries.
    on_existing: Option<OnExisting>,
    /// Receives the key of the host's geometry as soon as the host was read, whatever comes of it.
    geometry: Arc<OnceLock<[u8; 32]>>,
}

impl Service {
    /// Marks a host and registers the mark, or answers a retry with what it made before.
    ///
    /// # Errors
    /// [`ServiceError`]; then nothing is registered and nothing is kept.
    pub async fn embed(self: &Arc<Self>, request: EmbedRequest) -> Result<Embedded, ServiceError> {
        // Cheap refusals first.
        if let Some(key) = &request.idempotency_key {
            idempotency::check_key(key)?;
        }
        if let Some(payload) = &request.payload {
            Message::from_bytes(payload, request.bits).map_err(|error| {
                ServiceError::InvalidParameter { parameter: "payload", reason: error.to_string() }
            })?;
        }
        let service = self.clone();
        self.see_through(async move { service.embed_once(request).await }).await
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
        let message = match &request.payload {
            Some(payload) => Message::from_bytes(payload, request.bits)?,
            None => random_message(request.bits)?,
        };
        let key_id = self.keys.current().to_owned();
        let key = mark_key(&self.keys, &key_id, &salt, &owner_id)?;
        let host_sha256 = request.file.sha256;
        let file_name = request.file.name.take();
        let layers = layers_of(&request)?;
        let force = Force::of(&request, layers);
        let (method, bits) = (request.method, request.bits);
        let message_bytes = message.to_bytes();
        let (keep_host, keep_file) = (request.keep_host, request.keep_file);
        let on_existing = Some(request.on_existing);
        let geometry = Arc::new(OnceLock::new());
        let making = Making {
            file: request.file,
            formats: request.formats,
            key,
            message,
            how: (method, bits, force),
            layers,
            keep_host,
            keep_file,
            on_existing,
            geometry: geometry.clone(),
        };
        let done = self.mark(making).await;
        let refused = match (&done, force) {
            (Ok(done), _) => done.refused_strengths,
            (Err(error), _) if !is_about_the_codeword(error) => 0,
            (Err(_), Force::Exactly(..)) => 1,
            (Err(_), Force::Within(..)) => MOST_STRENGTHS,
        };
        // Whatever is registered next for this host and owner has been chosen among these. The host is
        // known by its geometry: a comment more makes another file.
        if refused > 0
            && let Some(geometry) = geometry.get()
        {
            self.registry.refused(geometry, &owner_id, refused).await?;
        }
        let done = done?;
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
            // Whole microseconds: what the registry keeps.
            created_at: now()?,
            revoked_at: None,
        };
        let (host, marked) = (done.host, done.marked);
        let content = if let Some(file) = done.packed {
            self.register(&record, Some(file), host, idempotency).await?;
            self.content(&record).await?
        } else {
            // Before it is registered: it may not fit on the disk.
            let content = self.spooled(id, marked).await?;
            self.register(&record, None, host, idempotency).await?;
            content
        };
        Ok(Embedded { record, content, replayed: false })
    }

    /// Reads the host, looks what it carries, marks it and measures the result.
    async fn mark(self: &Arc<Self>, making: Making) -> Result<Done, ServiceError> {
        let Making { file, formats, key, message, how, layers, keep_host, keep_file, .. } = making;
        let Making { on_existing, geometry, .. } = making;
        let (method, bits, force) = how;
        let limits = self.config.limits;
        let independent_check_max_bytes = self.config.independent_check_max_bytes;
        let start = match force {
            Force::Exactly(strength, _) => strength,
            // Where most searches end near.
            Force::Within(_, strongest) if strongest < Strength::default() => strongest,
            Force::Within(..) => Strength::default(),
        };
        let service = self.clone();
        let slot = self.admit()?;
        let (spooled, looks) = (Arc::new(file), on_existing.is_some());
        let file = spooled.clone();
        let (asset, host_key, looking) = self
            .run(&slot, spooled.bytes, move |allowed| {
                let host_bytes = file.read()?;
                takes(&formats, sniff(&host_bytes)?)?;
                let stop = || allowed.stop().now();
                let asset = Asset::read_until(&host_bytes, &limits, &stop)?;
                allowed.need(memory::needed(asset.mesh(), Purpose::Embed))?;
                let host_key = geometry::key_until(asset.mesh(), &stop);
                let host_key = host_key.ok_or_else(|| allowed.stop().reason())?;
                let host_key = *geometry.get_or_init(|| host_key);
                let looking = if looks {
                    service.begin_looking(&asset, &host_key, allowed.stop())?
                } else {
                    None
                };
                Ok((Arc::new(asset), host_key, looking))
            })
            .await?;
        let existing = match (on_existing, looking) {
            (None, _) => None,
            (Some(_), None) => Some(Vec::new()),
            (Some(on_existing), Some(looking)) => {
                let seen = self.marks_on(&slot, &asset, &host_key, looking).await?;
                on_existing.permits(&seen)?;
                Some(seen)
            }
        };
        let asset = Arc::into_inner(asset)
            .ok_or_else(|| ServiceError::Internal("a host is still looked at".to_owned()))?;
        self.run_once(&slot, move |allowed| {
            let host_bytes = spooled.read()?;
            let stop = || allowed.stop().now();
            let request = MarkRequest {
                key: &key,
                message: &message,
                params: EmbedParams { method, strength: start, bits, closed_loop: true },
                layers,
                amplitude: match force {
                    Force::Exactly(_, amplitude) => amplitude,
                    Force::Within(..) => Amplitude::default(),
                },
                limits,
                stop: &stop,
                independent_check_max_bytes,
            };
            let marked = match force {
                Force::Exactly(..) => mark_asset(asset, &host_bytes, &request)?,
                Force::Within(limit, strongest) => {
                    mark_asset_within(asset, &host_bytes, &request, limit, strongest)?
                }
            };
            let Marked { bytes, format, host, host_frame, report } = marked;
            drop(host_bytes);
            let kept = keep_host.then(|| kept(host_key, &host, allowed.stop())).transpose()?;
            let sha256 = marked::sha256_until(&bytes, &stop);
            let sha256 = sha256.ok_or_else(|| allowed.stop().reason())?;
            let packed = keep_file.then(|| packed(&bytes, &sha256, allowed.stop())).transpose()?;
            let usable_bins = u32::try_from(report.usable_bins)
                .map_err(|_| ServiceError::Internal("too many bins".to_owned()))?;
            Ok(Done {
                marked_sha256: sha256,
                packed,
                marked: bytes.into(),
                host: kept,
                format,
                frame: host_frame,
                vertices: host.positions().len() as u64,
                triangles: host.triangles().len() as u64,
                usable_bins,
                layers: report.layers,
                amplitude: report.amplitude,
                strength: report.strength,
                refused_strengths: report.refused_strengths,
                quality: quality_of(&report),
                existing,
            })
        })
        .await
    }

    async fn replay(
        self: &Arc<Self>,
        request: EmbedRequest,
        entry: &IdempotencyEntry,
    ) -> Result<Embedded, ServiceError> {
        let record = self.live_record(entry).await?;
        takes(&request.formats, record.format)?;
        let content = self.made_before(request, record).await?;
        // It may have been revoked while the file was fetched or made again.
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

    /// The marked file of a record: from the store, or made again from its host.
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
        let making = Making {
            file: request.file,
            formats: request.formats,
            key,
            message,
            how: (
                record.method,
                record.bits,
                Force::Exactly(record.strength, record.amplitude.unwrap_or_default()),
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

/// The layers of a request.
fn layers_of(request: &EmbedRequest) -> Result<Layers, ServiceError> {
    let usual = if request.keep_host { Layers::Both } else { Layers::Blind };
    let layers = request.layers.unwrap_or(usual);
    if layers.has_relief() && !request.keep_host {
        return Err(ServiceError::InvalidParameter {
            parameter: "layers",
            reason: format!(
                "{layers} has a relief, which is read against the kept host; send keep_host=true, or \
                 layers=blind"
            ),
        });
    }
    Ok(layers)
}

/// Refuses a file that the caller does not take back.
fn takes(formats: &[Format], format: Format) -> Result<(), ServiceError> {
    if formats.contains(&format) { Ok(()) } else { Err(ServiceError::FormatNotTaken(format)) }
}

/// Whether another codeword might have been marked with.
fn is_about_the_codeword(error: &ServiceError) -> bool {
    matches!(
        error,
        ServiceError::Watermark(WatermarkError::InsufficientCapacity { .. })
            | ServiceError::Check(_)
            | ServiceError::TooSmall(_)
            | ServiceError::DistortionUnreachable(_)
            | ServiceError::Job(JobError::DeadlinePassed)
    )
}

/// Geometry and sketch of a host.
fn kept(key: [u8; 32], host: &Mesh, stop: &Stop) -> Result<KeptHost, ServiceError> {
    let asked = || stop.now();
    let surface = Surface::new_until(host, &asked);
    let shape = surface.and_then(|surface| Shape::new_until(surface, &asked));
    let sketch = shape.and_then(|shape| Sketch::new_until(&shape, &asked));
    match geometry::pack_until(host, &asked) {
        // (What has no shape has no sketch; what was stopped has none either.)
        _ if stop.now() => Err(stop.reason().into()),
        packed => Ok(KeptHost { key, geometry: packed?.into(), sketch }),
    }
}

fn quality_of(report: &MarkReport) -> Quality {
    let measured = &report.quality;
    Quality {
        mrms: measured.mrms,
        hausdorff: measured.hausdorff,
        max_displacement: measured.max_displacement,
        normal_deviation_degrees: measured.normal_deviation_degrees,
        flipped: measured.flipped as u64,
        method_used: report.method_used.to_string(),
        more_decimals: Some(report.more_decimals),
    }
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
