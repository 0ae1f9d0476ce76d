//! Measurements: how well a mark is still read, and how much an attack distorted the mesh.

use crate::mesh::Mesh;
use crate::mesh::distortion::Measured;
use crate::mesh::surface::Surface;
use crate::watermark::{Codeword, Frame, Modulation, SoftBits, Suspect, WatermarkError};

/// Number of samples on edges, and in triangles, for the distance of an attacked mesh. It is
/// smaller than for marks, since damage of whole percents needs no third digit.
const SAMPLES: usize = 20_000;

/// How well a suspect agrees with the mark that it should carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Number of bins that read their bit right.
    pub right: usize,
    /// Number of bins that read their bit wrong.
    pub wrong: usize,
    /// Number of bins with too few vertices to read anything.
    pub erased: usize,
    /// Decimal logarithm of the bound on the false-positive probability, for one record.
    pub log10_bound: f64,
    /// The same in the host's frame, which the registry stores. It helps only if the suspect was
    /// not moved.
    pub log10_bound_in_place: f64,
}

/// Reads `suspect` in its own frame and in that of the host.
///
/// # Errors
/// [`WatermarkError::NoRadialExtent`].
pub fn detect(
    suspect: &Mesh,
    codeword: &Codeword,
    modulation: Modulation,
    host_frame: &Frame,
) -> Result<Detection, WatermarkError> {
    let bits = codeword.bit_count();
    let class = codeword.layout_class();
    let scored = |soft: SoftBits| {
        let score = soft.score(codeword);
        (score, soft.log10_bound(score.t))
    };
    let suspect = Suspect::new(suspect)?;
    let (score, log10_bound) = scored(suspect.read(class, bits, modulation));
    let in_place = suspect.read_in(host_frame, class, bits, modulation);
    let (_, log10_bound_in_place) = scored(in_place);
    Ok(Detection {
        right: score.bits_agreeing,
        wrong: score.bits_read - score.bits_agreeing,
        erased: bits.get() - score.bits_read,
        log10_bound,
        log10_bound_in_place,
    })
}

/// How far an attacked mesh is from the host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damage {
    /// Larger of the two root mean square distances, a share of the host's diagonal.
    pub mrms: f64,
    /// Larger of the two maxima, likewise.
    pub hausdorff: f64,
}

/// The surface of a host, or of a mesh that is measured against one, sampled as in Metro. `None` if
/// there is no surface.
#[must_use]
pub fn measured(surface: &Surface) -> Option<Measured> {
    Measured::new(surface, SAMPLES)
}

/// How far `attacked` is from the host. `None` if no surface is left.
#[must_use]
pub fn damage(host: &Measured, attacked: &Mesh) -> Option<Damage> {
    let d = host.against(&measured(&Surface::new(attacked))?);
    Some(Damage { mrms: d.mrms / d.diagonal, hausdorff: d.hausdorff / d.diagonal })
}
