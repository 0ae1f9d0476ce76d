//! Blind reading: bits from a mesh and its mark key alone, with no expectation of their values (paper
//! section 4, eq. 21-22).

use crate::mesh::Mesh;
use crate::mesh::stop::{Stop, go_on, never};
use crate::mesh::surface::Surface;
use crate::watermark::bins::{BinLayout, BinStatistic, Frame, norms, statistics};
use crate::watermark::codeword::Schedule;
use crate::watermark::{BitCount, MarkKey, Message, Modulation, WatermarkError};

/// The statistics of a surface in one bin layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The frame that was assumed.
    pub frame: Frame,
    /// Per bin, its count and statistic.
    pub statistics: Vec<BinStatistic>,
    /// Which statistic.
    pub modulation: Modulation,
}

impl Reading {
    /// Reads norms in a frame; `None` when the frame has no radial extent.
    #[must_use]
    pub fn in_frame(
        frame: Frame,
        norms: &[f64],
        class: u8,
        bits: BitCount,
        modulation: Modulation,
    ) -> Option<Self> {
        let layout = BinLayout::new(&frame, class, bits)?;
        Some(Self { frame, statistics: statistics(norms, &layout, modulation), modulation })
    }

    /// How far a bin's statistic is above neutral; negative below. `None` for an erasure.
    #[must_use]
    pub fn deviation(&self, bin: usize) -> Option<f64> {
        let statistic = self.statistics.get(bin).filter(|s| !s.is_erasure())?;
        Some(statistic.value - self.modulation.neutral())
    }

    /// How far a bin's statistic is beyond neutral on the side of `bit`; negative when it reads the
    /// other bit.
    #[must_use]
    pub fn margin(&self, bin: usize, bit: bool) -> Option<f64> {
        self.deviation(bin).map(|d| if bit { d } else { -d })
    }

    /// Vertices inside the bin layout.
    #[must_use]
    pub fn vertices_in_bins(&self) -> usize {
        self.statistics.iter().map(|s| s.count).sum()
    }

    /// Vertices of the poorest bin.
    #[must_use]
    pub fn least_count(&self) -> usize {
        self.statistics.iter().map(|s| s.count).min().unwrap_or(0)
    }
}

/// What a blind reader finds, in message order.
#[derive(Debug, Clone, PartialEq)]
pub struct Extraction {
    /// Per message bit its value, or `None` where its bin is an erasure.
    pub bits: Vec<Option<bool>>,
    /// Per message bit, how far its bin's statistic is from neutral (at least 0; 0 for an erasure).
    pub margins: Vec<f64>,
    /// Per message bit, the vertices in its bin.
    pub counts: Vec<usize>,
    /// The suspect's own frame.
    pub frame: Frame,
    /// The key's layout class.
    pub layout_class: u8,
}

impl Extraction {
    /// The message, when no bit is an erasure.
    #[must_use]
    pub fn message(&self) -> Option<Message> {
        let bits: Option<Vec<bool>> = self.bits.iter().copied().collect();
        bits.and_then(|bits| Message::from_bits(bits).ok())
    }
}

/// Extracts the message of a mark of `bits` bits blindly.
///
/// # Errors
/// [`WatermarkError::NoRadialExtent`] when the mesh has no bins at all.
pub fn extract(
    mesh: &Mesh,
    key: &MarkKey,
    bits: BitCount,
    modulation: Modulation,
) -> Result<Extraction, WatermarkError> {
    extract_from_surface(&Surface::new(mesh), key, bits, modulation)
}

/// As [`extract`], from a welded surface.
///
/// # Errors
/// As [`extract`].
pub fn extract_from_surface(
    surface: &Surface,
    key: &MarkKey,
    bits: BitCount,
    modulation: Modulation,
) -> Result<Extraction, WatermarkError> {
    extract_until(surface, key, bits, modulation, &never)
}

/// As [`extract_from_surface`], as long as `stop` answers `false`.
///
/// # Errors
/// Also [`WatermarkError::Cancelled`].
pub fn extract_until(
    surface: &Surface,
    key: &MarkKey,
    bits: BitCount,
    modulation: Modulation,
    stop: Stop<'_>,
) -> Result<Extraction, WatermarkError> {
    let schedule = Schedule::new(key, bits);
    let centre = surface.centre_until(stop).ok_or(WatermarkError::Cancelled)?;
    let norms = norms(&surface.positions, centre);
    go_on(stop).ok_or(WatermarkError::Cancelled)?;
    let frame = Frame::spanning(centre, &norms);
    let reading = Reading::in_frame(frame, &norms, schedule.layout_class, bits, modulation)
        .ok_or(WatermarkError::NoRadialExtent { vertices: surface.positions.len() })?;
    let of_bit = |&bin: &usize| {
        let whitened = schedule.whitening.get(bin).copied().unwrap_or_default();
        let count = reading.statistics.get(bin).map_or(0, |s| s.count);
        let deviation = reading.deviation(bin);
        // A statistic of exactly neutral carries no bit.
        let bit = deviation.filter(|&d| d != 0.0).map(|d| (d > 0.0) ^ whitened);
        (bit, deviation.unwrap_or(0.0).abs(), count)
    };
    let mut found = Extraction {
        bits: Vec::with_capacity(bits.get()),
        margins: Vec::with_capacity(bits.get()),
        counts: Vec::with_capacity(bits.get()),
        frame,
        layout_class: schedule.layout_class,
    };
    for (bit, margin, count) in schedule.bin_of_bit.iter().map(of_bit) {
        found.bits.push(bit);
        found.margins.push(margin);
        found.counts.push(count);
    }
    Ok(found)
}
