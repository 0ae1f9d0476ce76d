//! Reading back what was written, layer by layer.

use super::MarkError;
use super::make::{Made, Maker};
use crate::formats::Asset;
use crate::mesh::surface::Surface;
use crate::relief::{Amplitude, Layers, ReliefHost, ReliefReading};
use crate::watermark::{WatermarkError, extract_until, needed_bins};

/// log10 of the bound at which the relief of a small mesh has to be read back, at most. A match
/// needs 1e-9 after all that a verification counts, and some decades are for what happens to the
/// file.
pub(super) const LOG10_NEEDED: f64 = -14.0;

/// Most carrier vertices of a small mesh. Larger meshes have decades to spare: their relief is
/// measured along the normals instead of being read as a verification reads it.
const SMALL: usize = 4096;

/// Least share of the relief that the written file must have.
const WHOLE: f64 = 0.7;

/// Largest uncertainty of that share: rounding to coarse coordinates is noise.
const CERTAIN: f64 = 0.1;

impl Maker<'_> {
    /// The layers that written bytes have, read as a stranger reads them. Without the closed loop,
    /// nothing is read: the layers are those that were made.
    pub(super) fn read_back(&self, bytes: &[u8], made: &Made) -> Result<Layers, MarkError> {
        let blind = made.placed.embedding.is_some();
        if !self.request.params.closed_loop {
            return Ok(if self.relief.is_none() {
                Layers::Blind
            } else if blind {
                Layers::Both
            } else {
                Layers::Relief
            });
        }
        let stop = self.request.stop;
        let again = Asset::read_until(bytes, &self.request.limits, stop)?;
        if again.mesh().positions() != made.placed.positions {
            let text = "the positions differ from those that were written";
            return Err(MarkError::Check(text.into()));
        }
        let surface = Surface::new_until(again.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
        if blind {
            self.check_blind(&surface)?;
        }
        match (self.check_relief(&again, made.amplitude), blind) {
            (Ok(true), true) => Ok(Layers::Both),
            (Ok(true), false) => Ok(Layers::Relief),
            (Ok(false) | Err(MarkError::ReliefTooSmall { .. }), true) => Ok(Layers::Blind),
            // No relief is left: the file's coordinates are too coarse.
            (Ok(false), false) => {
                Err(MarkError::ReliefTooSmall { log10: 0.0, needed: LOG10_NEEDED })
            }
            (Err(error), _) => Err(error),
        }
    }

    fn check_blind(&self, surface: &Surface) -> Result<(), MarkError> {
        let request = self.request;
        let params = &request.params;
        let modulation = params.method.modulation();
        let found = extract_until(surface, self.key(), params.bits, modulation, request.stop)?;
        let wanted = request.message.bits();
        let differs = |(read, meant): &(&Option<bool>, &bool)| read.is_some_and(|b| b != **meant);
        let wrong = found.bits.iter().zip(wanted).filter(differs).count();
        let read = found.bits.iter().flatten().count();
        if wrong == 0 && read >= needed_bins(wanted.len()) {
            return Ok(());
        }
        let (vertices, bits) = (surface.positions.len(), wanted.len());
        Err(WatermarkError::InsufficientCapacity {
            usable: read - wrong,
            needed: needed_bins(bits).max(read),
            bits,
            vertices,
            in_bins: found.counts.iter().sum(),
            least_count: found.counts.iter().copied().min().unwrap_or(0),
            reason: "some bits do not survive being written to the file",
        }
        .into())
    }

    /// Whether the written file has the relief.
    fn check_relief(&self, again: &Asset, amplitude: Amplitude) -> Result<bool, MarkError> {
        let (Some(field), Some(relief)) = (&self.field, &self.relief) else { return Ok(false) };
        let vertices = again.mesh().positions();
        let at = |&vertex: &u32| vertices.get(usize::try_from(vertex).ok()?).copied();
        let carriers: Option<Vec<_>> = self.surface.first_vertex.iter().map(at).collect();
        let Some(carriers) = carriers else { return Ok(false) };
        let amplitude = amplitude.get();
        let stop = self.request.stop;
        let share = field.share_of(&self.surface, &carriers, &relief.signs, amplitude, stop);
        let share = share.ok_or(WatermarkError::Cancelled)?;
        if share.value < WHOLE || share.uncertainty > CERTAIN {
            return Ok(false);
        }
        if self.surface.positions.len() > SMALL {
            return Ok(true);
        }
        let log10 = self.bound_of(&carriers, amplitude).unwrap_or(0.0);
        if log10 > LOG10_NEEDED {
            return Err(MarkError::ReliefTooSmall { log10, needed: LOG10_NEEDED });
        }
        Ok(true)
    }

    /// log10 of the bound of the relief, read as a verification reads it.
    fn bound_of(&self, carriers: &[glam::DVec3], amplitude: f64) -> Option<f64> {
        let relief = self.relief.as_ref()?;
        let host = ReliefHost::new(self.surface.clone())?;
        let stop = self.request.stop;
        let reading = ReliefReading::new(&host, &self.surface, carriers, false, amplitude, stop)?;
        Some(reading.log10_bound(reading.score(&relief.signs)))
    }
}
