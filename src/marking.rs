//! Bytes to checked bytes: what the service, the command line, the lab and the benchmarks all do
//! with a file. Heavy but pure; it must not know about registries, keys' origin or HTTP.
//!
//! Nothing leaves here that was not read back first (design invariant 2): the written bytes are
//! parsed again from nothing, extracted blindly and compared, and independent readers must find
//! the same topology as in the host.

mod fit;
mod inspect;
mod within;

use serde::{Serialize, Serializer};

use crate::formats::{Agreement, Asset, Format, FormatError, Limits, Written, agrees_until};
use crate::mesh::Mesh;
use crate::mesh::quality::{Quality, quality_until};
use crate::mesh::stop::Stop;
use crate::mesh::surface::Surface;
use crate::watermark::{
    BitCount, Codeword, EmbedParams, Embedding, Extraction, Frame, Host, MarkKey, Message, Method,
    Modulation, Strength, WatermarkError, embed, extract_from_surface, extract_until, needed_bins,
};

pub use inspect::{Inspection, inspect, inspect_asset, inspect_asset_until};
use within::{Fitted, Whose};
pub use within::{MOST_STRENGTHS, MaxDistortion};

/// Why a file was not marked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MarkError {
    /// The file cannot be read or patched.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The mesh cannot be marked.
    #[error(transparent)]
    Watermark(#[from] WatermarkError),
    /// The marked file failed its check. It was thrown away.
    #[error("the marked file failed its check and was thrown away: {0}")]
    Check(String),
    /// Even the weakest mark that was tried distorts more than it may.
    #[error(
        "no mark distorts this mesh by at most {limit:e} of its diagonal (MRMS): the weakest one \
         tried comes to {least:.3e}; allow that much, or use another method or fewer \
         bits"
    )]
    DistortionUnreachable {
        /// What was asked for, a share of the diagonal.
        limit: f64,
        /// The least that was reached.
        least: f64,
    },
}

/// What to embed, and how.
#[derive(Clone, Copy)]
pub struct MarkRequest<'a> {
    /// The mark key.
    pub key: &'a MarkKey,
    /// The message; its length must be `params.bits`.
    pub message: &'a Message,
    /// Method, strength, bits, loop.
    pub params: EmbedParams,
    /// Limits of the parser.
    pub limits: Limits,
    /// Asked between stages and within them; `true` gives up with [`WatermarkError::Cancelled`].
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Files up to this size are also opened in an independent reader.
    pub independent_check_max_bytes: usize,
}

/// A marked file and what is worth knowing about it.
#[derive(Debug)]
pub struct Marked {
    /// The marked file.
    pub bytes: Vec<u8>,
    /// Its format, as sniffed.
    pub format: Format,
    /// The host's geometry.
    pub host: Mesh,
    /// The host's own frame.
    pub host_frame: Frame,
    /// Counts and margins.
    pub report: MarkReport,
}

/// What an embedding reached.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarkReport {
    /// Vertices of the file.
    pub vertices: usize,
    /// Triangles of the file.
    pub triangles: usize,
    /// Distinct points that a triangle with area uses.
    pub carriers: usize,
    /// Bins that read their bit blindly from the written file.
    pub usable_bins: usize,
    /// Bins with too few vertices to carry a bit.
    pub erasures: usize,
    /// Smallest distance of a usable bin's statistic from neutral; at most about the strength.
    pub smallest_margin: f64,
    /// Rounds of the closed loop.
    pub rounds: usize,
    /// The strength used.
    #[serde(serialize_with = "number")]
    pub strength: Strength,
    /// Strengths that this codeword was tried with and that distorted too much: what was chosen among
    /// them is chosen by the codeword.
    pub refused_strengths: u32,
    /// The method that chose the positions: where an `exact` one does not settle, the paper's.
    #[serde(serialize_with = "name")]
    pub method_used: Method,
    /// What the mark does to the surface, as written.
    pub quality: Quality,
    /// Coordinates that are written with more decimals than in the host, because the mark needs them.
    pub more_decimals: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn number<S: Serializer>(strength: &Strength, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_f64(strength.get())
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn name<S: Serializer>(method: &Method, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(method.name())
}

/// Marks a file.
///
/// # Errors
/// [`MarkError`]; nothing but the error is left then.
pub fn mark(host: &[u8], request: &MarkRequest<'_>) -> Result<Marked, MarkError> {
    mark_asset(Asset::read(host, &request.limits)?, host, request)
}

/// Marks a file that was read already: `asset` is what [`Asset::read`] made of `host`.
///
/// # Errors
/// As [`mark`].
pub fn mark_asset(
    asset: Asset,
    host: &[u8],
    request: &MarkRequest<'_>,
) -> Result<Marked, MarkError> {
    mark_by(asset, host, request, |attempt| {
        let made = attempt(Whose::Own, request.params.strength)?;
        Ok(Fitted { made, refused_strengths: 0 })
    })
}

/// Marks a file about as strongly as it can without distorting it by more than `limit`, at most
/// `strongest`; begins at the request's strength. The strength follows from the host, not from the
/// codeword, as far as that can be (`within`). [`MarkReport::strength`] is what was found:
/// [`mark`] with it makes the same bytes.
///
/// # Errors
/// [`MarkError`], of which [`MarkError::DistortionUnreachable`] when even the weakest mark distorts
/// too much.
pub fn mark_within(
    host: &[u8],
    request: &MarkRequest<'_>,
    limit: MaxDistortion,
    strongest: Strength,
) -> Result<Marked, MarkError> {
    mark_asset_within(Asset::read(host, &request.limits)?, host, request, limit, strongest)
}

/// The same for a file that was read already: `asset` is what [`Asset::read`] made of `host`.
///
/// # Errors
/// As [`mark_within`].
pub fn mark_asset_within(
    asset: Asset,
    host: &[u8],
    request: &MarkRequest<'_>,
    limit: MaxDistortion,
    strongest: Strength,
) -> Result<Marked, MarkError> {
    let start = request.params.strength;
    mark_by(asset, host, request, |attempt| {
        within::strongest_within(limit, start, strongest, |whose, strength| {
            attempt(whose, strength).map(|made| (made.quality.mrms, made))
        })
    })
}

/// An embedding, with what it does to the surface.
struct Made {
    embedding: Embedding,
    quality: Quality,
    strength: Strength,
    /// The step of coordinates that it was rounded with.
    step: f64,
}

/// How coarse the steps of written coordinates may be, as a share of how far a mark moves the
/// statistic of a bin (its strength times the bin's width). Moves of less than half a step are lost to
/// rounding, and the closed loop makes up for them elsewhere. `benches/decimals.rs` shows what coarser
/// and finer steps cost.
const STEP: f64 = 0.02;

/// Makes an embedding of a codeword with a strength.
type Attempt<'a> = dyn Fn(Whose, Strength) -> Result<Made, MarkError> + 'a;

/// Marks a file by the embedding that `choose` settles for, given a way to make one.
fn mark_by(
    asset: Asset,
    host: &[u8],
    request: &MarkRequest<'_>,
    choose: impl FnOnce(&Attempt<'_>) -> Result<Fitted<Made>, MarkError>,
) -> Result<Marked, MarkError> {
    let MarkRequest { key, message, params, stop, .. } = *request;
    let cancelled = || if stop() { Err(WatermarkError::Cancelled) } else { Ok(()) };
    cancelled()?;
    let codeword = Codeword::new(key, message);
    let probes = within::PROBES.map(|number| Codeword::probe(params.bits, number));
    let (bytes, fitted, carriers) = {
        let surface = Surface::new_until(asset.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
        let with_step = |whose, strength, step| {
            let codeword = match whose {
                Whose::Own => &codeword,
                Whose::Probe(place) => &probes[place],
            };
            let round = |positions: &mut [glam::DVec3]| {
                asset.with_step(step).round_until(positions, stop);
            };
            let (mesh, surface, pinned) = (asset.mesh(), &surface, asset.pinned());
            let seen = Host { mesh, surface, pinned, round: &round, original: None };
            let embedding = embed(seen, codeword, &EmbedParams { strength, ..params }, stop)?;
            let quality = quality_of(surface, &embedding.positions, stop)?;
            Ok(Made { embedding, quality, strength, step })
        };
        let width = bin_width(&surface, params.bits, stop).ok_or(WatermarkError::Cancelled)?;
        let fitted = choose(&|whose, strength| {
            let step = STEP * strength.get() * width;
            match with_step(whose, strength, step) {
                // Nothing is refused for the sake of decimals.
                Err(MarkError::Watermark(WatermarkError::InsufficientCapacity { .. }))
                    if asset.is_coarse(step) =>
                {
                    with_step(whose, strength, 0.0)
                }
                made => made,
            }
        })?;
        let made = &fitted.made;
        let stepped = asset.with_step(made.step);
        let written = stepped.write_until(host, &made.embedding.positions, stop)?;
        (written, fitted, surface.positions.len())
    };
    let Written { bytes, more_decimals } = bytes;
    let Fitted { made: Made { embedding, quality, strength, .. }, refused_strengths } = fitted;
    cancelled()?;
    let format = asset.format();
    if params.closed_loop {
        check(&bytes, &embedding.positions, request)?;
        cancelled()?;
    }
    if bytes.len() <= request.independent_check_max_bytes
        && let Agreement::Differs(reason) = agrees_until(format, host, &bytes, stop)
    {
        cancelled()?;
        return Err(MarkError::Check(reason));
    }
    cancelled()?;
    let report = MarkReport {
        vertices: asset.mesh().positions().len(),
        triangles: asset.mesh().triangles().len(),
        carriers,
        usable_bins: embedding.usable_bins,
        erasures: codeword.bits().len() - embedding.usable_bins,
        smallest_margin: embedding.smallest_margin,
        rounds: embedding.rounds,
        strength,
        refused_strengths,
        method_used: embedding.method,
        quality,
        more_decimals,
    };
    let host_frame = embedding.host_frame;
    Ok(Marked { bytes, format, host: asset.into_mesh(), host_frame, report })
}

/// Width of a bin in the host's own frame; `None` once `stop` answers `true`.
fn bin_width(surface: &Surface, bits: BitCount, stop: Stop<'_>) -> Option<f64> {
    let centre = surface.centre_until(stop)?;
    let norms = crate::watermark::bins::norms(&surface.positions, centre);
    Some(Frame::spanning(centre, &norms).radial_extent() / bits.get() as f64)
}

/// Measures positions of file vertices, as they will be written, against the host.
fn quality_of(
    surface: &Surface,
    positions: &[glam::DVec3],
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Quality, MarkError> {
    let at = |&vertex: &u32| positions.get(usize::try_from(vertex).ok()?).copied();
    let moved: Option<Vec<glam::DVec3>> = surface.first_vertex.iter().map(at).collect();
    moved.and_then(|moved| quality_until(surface, &moved, stop)).ok_or_else(|| {
        if stop() {
            WatermarkError::Cancelled.into()
        } else {
            MarkError::Check("what it does to the surface cannot be measured".into())
        }
    })
}

/// Reads the written bytes as a stranger would and compares with what was meant.
fn check(
    bytes: &[u8],
    positions: &[glam::DVec3],
    request: &MarkRequest<'_>,
) -> Result<(), MarkError> {
    let stop = request.stop;
    let again = Asset::read_until(bytes, &request.limits, stop)?;
    if again.mesh().positions() != positions {
        return Err(MarkError::Check("the positions differ from those that were written".into()));
    }
    let params = &request.params;
    let surface = Surface::new_until(again.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
    let modulation = params.method.modulation();
    let found = extract_until(&surface, request.key, params.bits, modulation, stop)?;
    let wanted = request.message.bits();
    let wrong =
        found.bits.iter().zip(wanted).filter(|(read, meant)| read.is_some_and(|b| b != **meant));
    let (wrong, read) = (wrong.count(), found.bits.iter().flatten().count());
    if wrong > 0 || read < needed_bins(wanted.len()) {
        let (vertices, bits) = (surface.positions.len(), wanted.len());
        return Err(WatermarkError::InsufficientCapacity {
            usable: read - wrong,
            needed: needed_bins(bits).max(read),
            bits,
            vertices,
            in_bins: found.counts.iter().sum(),
            least_count: found.counts.iter().copied().min().unwrap_or(0),
            reason: "some bits do not survive being written to the file",
        }
        .into());
    }
    Ok(())
}

/// Reads a message blindly from a file.
///
/// # Errors
/// [`MarkError::Format`] or [`MarkError::Watermark`].
pub fn extract_file(
    bytes: &[u8],
    key: &MarkKey,
    bits: BitCount,
    modulation: Modulation,
    limits: &Limits,
) -> Result<Extraction, MarkError> {
    let surface = Surface::new(Asset::read(bytes, limits)?.mesh());
    Ok(extract_from_surface(&surface, key, bits, modulation)?)
}
