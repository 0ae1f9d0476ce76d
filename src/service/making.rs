//! Making a marked file on the pool: reads the host, looks for marks that the host carries, marks
//! the host, then measures and packs the result. Must not know about records, or what is
//! registered.

use std::sync::{Arc, OnceLock};

use bytes::Bytes;

use super::content::packed;
use super::embed::{EmbedRequest, takes};
use super::existing::CarriedMark;
use super::memory::{self, Purpose};
use super::register::KeptHost;
use super::{OnExisting, Service, ServiceError, Spooled};
use crate::blobs::{geometry, marked};
use crate::formats::{Asset, Format, sniff};
use crate::jobs::{JobError, Stop};
use crate::marking::{
    Amplitude, Layers, MarkReport, MarkRequest, Marked, MaxDistortion, mark_asset,
    mark_asset_within,
};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::registration::{Shape, Sketch};
use crate::registry::Quality;
use crate::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Strength, WatermarkError};

/// The result of the pool's work.
pub(super) struct MarkingResult {
    pub(super) marked: Bytes,
    pub(super) marked_sha256: [u8; 32],
    /// The file as it is stored, if it is kept.
    pub(super) packed: Option<Bytes>,
    pub(super) host: Option<KeptHost>,
    pub(super) format: Format,
    pub(super) frame: crate::watermark::Frame,
    pub(super) vertices: u64,
    pub(super) triangles: u64,
    pub(super) usable_bins: u32,
    pub(super) layers: Layers,
    pub(super) amplitude: Option<Amplitude>,
    pub(super) strength: Strength,
    /// Index of the key that marked it.
    pub(super) key: usize,
    /// Number of codewords and strengths that were tried before.
    pub(super) refused: u32,
    pub(super) quality: Quality,
    /// Marks that the host carried; none if the host was not searched.
    pub(super) existing: Option<Vec<CarriedMark>>,
}

/// How strongly to mark.
#[derive(Clone, Copy)]
pub(super) enum StrengthChoice {
    /// With this strength of the blind layer and this amplitude of the relief.
    Exactly(Strength, Amplitude),
    /// As strongly as the distortion allows; the blind layer with at most this strength.
    Within(MaxDistortion, Strength),
}

impl StrengthChoice {
    pub(super) fn of(request: &EmbedRequest, layers: Layers) -> Self {
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
pub(super) struct MarkingJob {
    pub(super) file: Spooled,
    /// Formats that the caller accepts.
    pub(super) formats: Vec<Format>,
    pub(super) key: MarkKey,
    /// Further keys, tried in order where the blind layer is refused.
    pub(super) others: Vec<MarkKey>,
    pub(super) message: Message,
    pub(super) parameters: (Method, BitCount, StrengthChoice),
    pub(super) layers: Layers,
    pub(super) keep_host: bool,
    pub(super) keep_file: bool,
    /// What to do about marks that the host carries. Without it the host is not searched for marks.
    pub(super) on_existing: Option<OnExisting>,
    /// Receives the key of the host's geometry as soon as the host has been read, also when the
    /// marking fails later.
    pub(super) geometry: Arc<OnceLock<[u8; 32]>>,
}

impl Service {
    /// Reads the host, looks for marks that it carries, marks it and measures the result.
    pub(super) async fn mark(
        self: &Arc<Self>,
        making: MarkingJob,
    ) -> Result<MarkingResult, ServiceError> {
        let MarkingJob { file, formats, key, others, message, parameters, layers, .. } = making;
        let MarkingJob { keep_host, keep_file, on_existing, geometry, .. } = making;
        let (method, bits, force) = parameters;
        let limits = self.config.limits;
        let independent_check_max_bytes = self.config.independent_check_max_bytes;
        let start = match force {
            StrengthChoice::Exactly(strength, _) => strength,
            // Most searches end near this strength.
            StrengthChoice::Within(_, strongest) if strongest < Strength::default() => strongest,
            StrengthChoice::Within(..) => Strength::default(),
        };
        let service = self.clone();
        let slot = self.admit()?;
        let (spooled, searches_existing) = (Arc::new(file), on_existing.is_some());
        let file = spooled.clone();
        let (asset, host_key, existing_search) = self
            .run(&slot, spooled.bytes, move |allowed| {
                let host_bytes = file.read()?;
                takes(&formats, sniff(&host_bytes)?)?;
                let stop = || allowed.stop().now();
                let asset = Asset::read_until(&host_bytes, &limits, &stop)?;
                allowed.need(memory::needed(asset.mesh(), Purpose::Embed))?;
                let host_key = geometry::key_until(asset.mesh(), &stop);
                let host_key = host_key.ok_or_else(|| allowed.stop().reason())?;
                let host_key = *geometry.get_or_init(|| host_key);
                let existing_search = if searches_existing {
                    service.begin_existing_search(&asset, &host_key, allowed.stop())?
                } else {
                    None
                };
                Ok((Arc::new(asset), host_key, existing_search))
            })
            .await?;
        let existing = match (on_existing, existing_search) {
            (None, _) => None,
            (Some(_), None) => Some(Vec::new()),
            (Some(on_existing), Some(existing_search)) => {
                let seen =
                    self.find_existing_marks(&slot, &asset, &host_key, existing_search).await?;
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
                others: &others,
                message: &message,
                params: EmbedParams { method, strength: start, bits, closed_loop: true },
                layers,
                amplitude: match force {
                    StrengthChoice::Exactly(_, amplitude) => amplitude,
                    StrengthChoice::Within(..) => Amplitude::default(),
                },
                limits,
                stop: &stop,
                independent_check_max_bytes,
            };
            let marked = match force {
                StrengthChoice::Exactly(..) => mark_asset(asset, &host_bytes, &request)?,
                StrengthChoice::Within(limit, strongest) => {
                    mark_asset_within(asset, &host_bytes, &request, limit, strongest)?
                }
            };
            let Marked { key, bytes, format, host, host_frame, report } = marked;
            drop(host_bytes);
            let kept = keep_host.then(|| kept(host_key, &host, allowed.stop())).transpose()?;
            let sha256 = marked::sha256_until(&bytes, &stop);
            let sha256 = sha256.ok_or_else(|| allowed.stop().reason())?;
            let packed = keep_file.then(|| packed(&bytes, &sha256, allowed.stop())).transpose()?;
            let usable_bins = u32::try_from(report.usable_bins)
                .map_err(|_| ServiceError::Internal("too many bins".to_owned()))?;
            Ok(MarkingResult {
                key,
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
                refused: report.refused,
                quality: quality_of(&report),
                existing,
            })
        })
        .await
    }
}

/// The layers of a request.
pub(super) fn layers_of(request: &EmbedRequest) -> Result<Layers, ServiceError> {
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

/// Whether the marking might have succeeded with another codeword.
pub(super) fn is_about_the_codeword(error: &ServiceError) -> bool {
    matches!(
        error,
        ServiceError::Watermark(WatermarkError::InsufficientCapacity { .. })
            | ServiceError::Check(_)
            | ServiceError::TooSmall(_)
            | ServiceError::DistortionUnreachable(_)
            | ServiceError::Job(JobError::DeadlinePassed)
    )
}

/// Geometry and sketch of a host, ready to be stored.
fn kept(key: [u8; 32], host: &Mesh, stop: &Stop) -> Result<KeptHost, ServiceError> {
    let asked = || stop.now();
    let surface = Surface::new_until(host, &asked);
    let shape = surface.and_then(|surface| Shape::new_until(surface, &asked));
    let sketch = shape.and_then(|shape| Sketch::new_until(&shape, &asked));
    match geometry::pack_until(host, &asked) {
        // A host without a shape has no sketch. A host whose processing was stopped has none
        // either.
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
