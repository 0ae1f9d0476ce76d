//! Bytes to checked bytes: what the service, the command line, the lab and the benchmarks all do
//! with a file. Heavy but pure. Must not know registries, where keys come from, or HTTP.
//!
//! Every file is read back before it leaves this module (invariant I2), unless the request turns
//! the closed loop off. The written bytes are parsed again from nothing, extracted blindly and
//! compared. Files up to a limit are also opened in an independent reader, which must find the same
//! topology as in the host.

mod check;
mod fit;
mod inspect;
mod layers;
mod make;
#[cfg(test)]
mod tests;
mod within;

use serde::{Serialize, Serializer};

use crate::formats::{Agreement, Asset, Format, FormatError, Limits, Written, agrees_until};
use crate::mesh::Mesh;
use crate::mesh::quality::{Quality, quality_until};
use crate::mesh::surface::Surface;
use crate::watermark::{
    BitCount, EmbedParams, Extraction, Frame, MarkKey, Message, Method, Modulation, Strength,
    WatermarkError, extract_from_surface,
};

pub use crate::relief::{Amplitude, Layers};
pub use inspect::{Inspection, inspect, inspect_asset, inspect_asset_until};
use make::{Fitted, Made, Maker, relief_within};
pub use within::{MaxDistortion, most_tries};

/// Why a file was not marked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MarkError {
    /// The file cannot be read or patched.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The mesh cannot be marked.
    #[error(transparent)]
    Watermark(#[from] WatermarkError),
    /// The mesh has too few vertices for a relief.
    #[error(
        "the mesh is too small to carry a relief: read from the marked file itself, its bound would be \
         1e{log10:.0}, and 1e{needed:.0} is needed; use a mesh with more vertices"
    )]
    ReliefTooSmall {
        /// log10 of the bound that was read back.
        log10: f64,
        /// What the bound must be below.
        needed: f64,
    },
    /// The marked file failed its check. It was thrown away.
    #[error("the marked file failed its check and was thrown away: {0}")]
    Check(String),
    /// Even the weakest mark that was tried distorts more than the limit allows.
    #[error(
        "no mark distorts this mesh by at most {limit:e} of its diagonal (MRMS): the weakest one \
         tried comes to {least:.3e}; allow that much, or use another method or fewer \
         bits"
    )]
    DistortionUnreachable {
        /// The requested limit, a share of the diagonal.
        limit: f64,
        /// The least distortion that was reached.
        least: f64,
    },
}

/// What to embed, and how.
#[derive(Clone, Copy)]
pub struct MarkRequest<'a> {
    /// The mark key.
    pub key: &'a MarkKey,
    /// Further keys, one after the other, for where the blind layer is refused with those before.
    pub others: &'a [MarkKey],
    /// The message; its length must be `params.bits`.
    pub message: &'a Message,
    /// Parameters of the blind layer: method, strength, bits, loop.
    pub params: EmbedParams,
    /// Which layers to make.
    pub layers: Layers,
    /// How far a relief moves the surface.
    pub amplitude: Amplitude,
    /// Limits of the parser.
    pub limits: Limits,
    /// Called between stages and within them; `true` ends the job with
    /// [`WatermarkError::Cancelled`].
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Files up to this size are also opened in an independent reader.
    pub independent_check_max_bytes: usize,
}

impl<'a> MarkRequest<'a> {
    /// All keys of the request, in order.
    pub(crate) fn keys(&self) -> impl Iterator<Item = &'a MarkKey> {
        std::iter::once(self.key).chain(self.others)
    }
}

/// A marked file and what is known about it.
#[derive(Debug)]
pub struct Marked {
    /// Index of the key that marked the file: 0 for the request's first key, then the others.
    pub key: usize,
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
    /// Carrier vertices: distinct points that a triangle with area uses.
    pub carriers: usize,
    /// The layers that the written file has: without the blind one where the mesh cannot carry it,
    /// without the relief where the file's coordinates are too coarse for it.
    pub layers: Layers,
    /// Bins that read their bit blindly from the written file; 0 without a blind layer.
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
    /// How far the relief moves the surface; none without a relief.
    #[serde(serialize_with = "optional_number")]
    pub amplitude: Option<Amplitude>,
    /// How many tries were refused before, each a codeword with a strength or a relief with an
    /// amplitude. The choice among tries depends on the codeword, so all of them are charged to the
    /// bound.
    pub refused: u32,
    /// The method that chose the positions. Where an `exact` method does not settle, this is the
    /// paper's.
    #[serde(serialize_with = "name")]
    pub method_used: Method,
    /// The distortion of the surface by the mark, as written.
    pub quality: Quality,
    /// Coordinates that are written with more decimals than in the host, because the mark needs them.
    pub more_decimals: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn number<S: Serializer>(strength: &Strength, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_f64(strength.get())
}

#[expect(clippy::ref_option, reason = "serde's signature")]
fn optional_number<S: Serializer>(amplitude: &Option<Amplitude>, to: S) -> Result<S::Ok, S::Error> {
    amplitude.map(Amplitude::get).serialize(to)
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
    mark_by(asset, host, request, &|maker| maker.exactly(request.params.strength))
}

/// Marks a file about as strongly as a distortion of at most `limit` and a strength of at most
/// `strongest` allow. The search begins at the request's strength. The strength follows from the
/// host and not from the codeword, as far as possible (module `within`). A relief gets its share of
/// `limit` first, and the request's amplitude is not used. [`MarkReport::strength`] and
/// [`MarkReport::amplitude`] report what was found: [`mark`] with them makes the same bytes.
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

/// Like [`mark_within`], for a file that was read already: `asset` is what [`Asset::read`] made of
/// `host`.
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
    let amplitude = if request.layers.has_relief() {
        relief_within(limit).map_err(MarkError::Check)?
    } else {
        request.amplitude
    };
    let request = &MarkRequest { amplitude, ..*request };
    let start = request.params.strength;
    mark_by(asset, host, request, &|maker| maker.within(limit, start, strongest))
}

/// Marks a file with the mark that `choose` makes.
fn mark_by(
    asset: Asset,
    host: &[u8],
    request: &MarkRequest<'_>,
    choose: &dyn Fn(&mut Maker<'_>) -> Result<Fitted<Made>, MarkError>,
) -> Result<Marked, MarkError> {
    let cancelled = || if (request.stop)() { Err(WatermarkError::Cancelled) } else { Ok(()) };
    cancelled()?;
    let mut maker = Maker::new(&asset, request)?;
    let Fitted { made, refused } = choose(&mut maker)?;
    let Written { bytes, more_decimals } =
        asset.with_step(made.step).write_until(host, &made.placed.positions, request.stop)?;
    cancelled()?;
    let layers = maker.read_back(&bytes, &made)?;
    cancelled()?;
    if layers == Layers::Blind && request.layers == Layers::Both {
        // A relief that cannot be read costs distortion for nothing: mark again without it.
        drop(maker);
        let mut marked = mark_by(asset, host, &MarkRequest { layers, ..*request }, choose)?;
        marked.report.refused += refused;
        return Ok(marked);
    }
    let format = asset.format();
    if bytes.len() <= request.independent_check_max_bytes
        && let Agreement::Differs(reason) = agrees_until(format, host, &bytes, request.stop)
    {
        cancelled()?;
        return Err(MarkError::Check(reason));
    }
    cancelled()?;
    let blind = made.placed.embedding.as_ref();
    let usable_bins = blind.map_or(0, |blind| blind.usable_bins);
    let report = MarkReport {
        vertices: asset.mesh().positions().len(),
        triangles: asset.mesh().triangles().len(),
        carriers: maker.carriers(),
        layers,
        usable_bins,
        erasures: request.params.bits.get() - usable_bins,
        smallest_margin: blind.map_or(0.0, |blind| blind.smallest_margin),
        rounds: blind.map_or(0, |blind| blind.rounds),
        strength: made.strength,
        amplitude: layers.has_relief().then_some(made.amplitude),
        refused,
        method_used: blind.map_or(request.params.method, |blind| blind.method),
        quality: made.placed.quality,
        more_decimals,
    };
    let host_frame = maker.host_frame(&made);
    let key = maker.place;
    Ok(Marked { key, bytes, format, host: asset.into_mesh(), host_frame, report })
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
