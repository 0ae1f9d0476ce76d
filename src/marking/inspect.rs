//! Looking at a file without marking it.

use serde::Serialize;

use super::MarkError;
use crate::formats::{Asset, Limits};
use crate::mesh::surface::Surface;
use crate::watermark::{EmbedParams, Frame, Modulation, Reading, WatermarkError, needed_bins};

/// What a file is and how well it can carry a mark.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// `obj`, `gltf` or `glb`.
    pub format: &'static str,
    /// Vertices of the file.
    pub vertices: usize,
    /// Triangles of the file.
    pub triangles: usize,
    /// Carrier vertices: distinct points that a triangle with area uses.
    pub carriers: usize,
    /// Bounding-box diagonal of the carrier vertices, in the file's unit.
    pub diagonal: f64,
    /// Area-weighted centre.
    pub centre: [f64; 3],
    /// Smallest vertex norm.
    pub rho_min: f64,
    /// Largest vertex norm.
    pub rho_max: f64,
    /// The requested number of bits.
    pub bits: usize,
    /// Bins with enough vertices in the poorest of all layout classes.
    pub usable_bins: usize,
    /// Bins that a mark needs.
    pub needed_bins: usize,
    /// Vertices of the median bin, in the poorest class.
    pub median_count: usize,
    /// Vertices of the poorest bin of that class.
    pub least_count: usize,
    /// Whether a mark of this many bits can be tried. Only the embedding shows whether its bins can
    /// be moved.
    pub markable: bool,
    /// Expected signal of a median bin over its sampling noise, `strength sqrt(n) / sigma`, with
    /// sigma of an even bin: the mark's margin against noise.
    pub expected_margin: f64,
    /// Decimal logarithm of the best false-positive bound that a mark can reach before
    /// hypotheses are counted.
    pub best_log10_fp: f64,
}

/// Looks at a file without marking it.
///
/// # Errors
/// [`MarkError::Format`] or [`WatermarkError::NoRadialExtent`].
pub fn inspect(
    bytes: &[u8],
    params: &EmbedParams,
    limits: &Limits,
) -> Result<Inspection, MarkError> {
    inspect_asset(&Asset::read(bytes, limits)?, params)
}

/// Looks at what was read from a file.
///
/// # Errors
/// [`WatermarkError::NoRadialExtent`].
pub fn inspect_asset(asset: &Asset, params: &EmbedParams) -> Result<Inspection, MarkError> {
    inspect_asset_until(asset, params, &|| false)
}

/// Like [`inspect_asset`], calling `stop` before each of the 256 layout classes and in the steps
/// before.
///
/// # Errors
/// Also [`WatermarkError::Cancelled`].
pub fn inspect_asset_until(
    asset: &Asset,
    params: &EmbedParams,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Inspection, MarkError> {
    let surface = Surface::new_until(asset.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
    let centre = surface.centre_until(stop).ok_or(WatermarkError::Cancelled)?;
    let norms = crate::watermark::bins::norms(&surface.positions, centre);
    let frame = Frame::spanning(centre, &norms);
    let modulation = params.method.modulation();
    let poorest = (0..=u8::MAX)
        .take_while(|_| !stop())
        .filter_map(|class| Reading::in_frame(frame, &norms, class, params.bits, modulation))
        .map(|reading| {
            let mut counts: Vec<usize> = reading.statistics.iter().map(|s| s.count).collect();
            counts.sort_unstable();
            (reading.statistics.iter().filter(|s| !s.is_erasure()).count(), counts)
        })
        .min();
    if stop() {
        return Err(WatermarkError::Cancelled.into());
    }
    let poorest = poorest.ok_or(WatermarkError::NoRadialExtent { vertices: norms.len() })?;
    let (usable_bins, counts) = poorest;
    let median_count = counts.get(counts.len() / 2).copied().unwrap_or(0);
    let sigma = match modulation {
        Modulation::Mean => (1.0_f64 / 12.0).sqrt(),
        Modulation::Variance => (4.0_f64 / 45.0).sqrt(),
    };
    let needed = needed_bins(params.bits.get());
    Ok(Inspection {
        format: asset.format().extension(),
        vertices: asset.mesh().positions().len(),
        triangles: asset.mesh().triangles().len(),
        carriers: surface.positions.len(),
        diagonal: surface.diagonal(),
        centre: centre.to_array(),
        rho_min: frame.rho_min,
        rho_max: frame.rho_max,
        bits: params.bits.get(),
        usable_bins,
        needed_bins: needed,
        median_count,
        least_count: counts.first().copied().unwrap_or(0),
        markable: usable_bins >= needed,
        expected_margin: params.strength.get() * (median_count as f64).sqrt() / sigma,
        best_log10_fp: -(usable_bins as f64) * std::f64::consts::LOG10_2,
    })
}
