//! One mark on one host: its layers made, within a strength or a limit of distortion.

use glam::DVec3;

use super::layers::{Base, Placed, Raised, signs};
use super::within::{Fitted, PROBES, Room, Whose, strongest_within};
use super::{MarkError, MarkRequest, MaxDistortion};
use crate::formats::Asset;
use crate::mesh::stop::Stop;
use crate::mesh::surface::Surface;
use crate::relief::{Amplitude, Field, Layers, Signs};
use crate::watermark::bins::norms;
use crate::watermark::{BitCount, Codeword, EmbedParams, Frame, Strength, WatermarkError};

/// How coarse the steps of written coordinates may be, as a share of how far a mark moves the
/// statistic of a bin (its strength times the bin's width). Moves of less than half a step are lost to
/// rounding, and the closed loop makes up for them elsewhere. `benches/decimals.rs` shows what coarser
/// and finer steps cost.
const STEP: f64 = 0.02;

/// The same of a relief alone, as a share of its amplitude: rounding then is 3 % of it.
const RELIEF_STEP: f64 = 0.1;

/// What of a limit of distortion the relief gets; as the blind layer moves vertices independently, it has
/// `sqrt(1 - 0.8^2) = 0.6` of it left. With a limit of 0.01 % that is enough for the blind layer's
/// usual strength on nearly all meshes (`cargo bench --bench limits -- --layers both --limits 1e-4`).
const RELIEF_SHARE: f64 = 0.8;

/// Each amplitude of a relief alone that distorts too much is followed by this share of it.
const LOWER: f64 = 0.85;

/// Amplitudes of a relief alone that are tried, at most. What signs do to a mesh of few vertices differs
/// by a third.
const MOST_AMPLITUDES: u32 = 5;

/// The amplitude of a relief that leaves room for a blind layer within a limit.
pub(super) fn relief_within(limit: MaxDistortion) -> Result<Amplitude, String> {
    Amplitude::new(RELIEF_SHARE * limit.get())
}

/// A mark, with what it does to the surface.
pub(super) struct Made {
    pub(super) placed: Placed,
    pub(super) strength: Strength,
    /// Of the relief, if there is one.
    pub(super) amplitude: Amplitude,
    /// The step of coordinates that it was rounded with.
    pub(super) step: f64,
}

/// The relief of the own key.
pub(super) struct Relief {
    pub(super) field: Field,
    pub(super) signs: Signs,
    raised: Raised,
}

/// Makes marks of one key on one host.
pub(super) struct Maker<'a> {
    pub(super) asset: &'a Asset,
    pub(super) request: &'a MarkRequest<'a>,
    pub(super) surface: Surface,
    pub(super) codeword: Codeword,
    probes: [Codeword; PROBES.len()],
    /// None where no relief is asked for, or the surface has no field.
    pub(super) relief: Option<Relief>,
    /// Width of a bin in the host's own frame.
    width: f64,
}

/// Whether another mark may be carried where this one is not.
fn is_capacity(error: &MarkError) -> bool {
    matches!(
        error,
        MarkError::Watermark(
            WatermarkError::InsufficientCapacity { .. } | WatermarkError::NoRadialExtent { .. }
        )
    )
}

impl<'a> Maker<'a> {
    /// Welds the host and raises its relief.
    pub(super) fn new(asset: &'a Asset, request: &'a MarkRequest<'a>) -> Result<Self, MarkError> {
        let stop = request.stop;
        let surface = Surface::new_until(asset.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
        let bits = request.params.bits;
        let codeword = Codeword::new(request.key, request.message);
        let probes = PROBES.map(|number| Codeword::probe(bits, number));
        let width = bin_width(&surface, bits, stop).ok_or(WatermarkError::Cancelled)?;
        let mut maker = Self { asset, request, surface, codeword, probes, relief: None, width };
        let field = request.layers.has_relief().then(|| Field::new_until(&maker.surface, stop));
        if stop() {
            return Err(WatermarkError::Cancelled.into());
        }
        let field = field.flatten();
        if let Some(field) = field {
            let signs = signs(request.key, &field);
            let raised = maker.base().raised(&field, &signs, request.amplitude)?;
            maker.relief = Some(Relief { field, signs, raised });
        }
        Ok(maker)
    }

    fn base(&self) -> Base<'_> {
        Base {
            mesh: self.asset.mesh(),
            surface: &self.surface,
            pinned: self.asset.pinned(),
            stop: self.request.stop,
        }
    }

    /// Distinct points that a triangle with area uses.
    pub(super) fn carriers(&self) -> usize {
        self.surface.positions.len()
    }

    /// The mark with this strength.
    pub(super) fn exactly(&self, strength: Strength) -> Result<Fitted<Made>, MarkError> {
        let fitted = |made| Fitted { made, refused_strengths: 0 };
        match self.request.layers {
            Layers::Blind => self.embedded(Whose::Own, strength).map(fitted),
            Layers::Relief => self.relief_alone(self.request.amplitude, None).map(fitted),
            Layers::Both => match self.embedded(Whose::Own, strength) {
                Err(error) if is_capacity(&error) => {
                    let made = self.relief_alone(self.request.amplitude, Some(error))?;
                    Ok(Fitted { made, refused_strengths: 1 })
                }
                made => made.map(fitted),
            },
        }
    }

    /// The strongest mark within a limit. A relief that is alone because the own codeword was refused is
    /// charged for these tries: it would not be alone with another.
    pub(super) fn within(
        &self,
        limit: MaxDistortion,
        start: Strength,
        strongest: Strength,
    ) -> Result<Fitted<Made>, MarkError> {
        let mut own_tries = 0;
        let attempt = |whose, strength| {
            own_tries += u32::from(whose == Whose::Own);
            self.embedded(whose, strength).map(|made| (made.placed.quality.mrms, made))
        };
        match self.request.layers {
            Layers::Blind => strongest_within(Room::whole(limit), start, strongest, attempt),
            Layers::Relief => self.relief_alone_within(limit, None),
            Layers::Both => {
                let relief = self.request.amplitude.get();
                let left = (limit.get() * limit.get() - relief * relief).max(0.0).sqrt();
                match strongest_within(Room { limit, left }, start, strongest, attempt) {
                    Err(error)
                        if is_capacity(&error)
                            || matches!(error, MarkError::DistortionUnreachable { .. }) =>
                    {
                        let fitted = self.relief_alone_within(limit, Some(error))?;
                        let refused_strengths = own_tries + fitted.refused_strengths;
                        Ok(Fitted { refused_strengths, ..fitted })
                    }
                    fitted => fitted,
                }
            }
        }
    }

    /// The blind layer, on the relief where it is the own codeword's and there is one.
    fn embedded(&self, whose: Whose, strength: Strength) -> Result<Made, MarkError> {
        let codeword = match whose {
            Whose::Own => &self.codeword,
            Whose::Probe(place) => &self.probes[place],
        };
        let relief = self.relief.as_ref().filter(|_| whose == Whose::Own);
        let raised = relief.map(|relief| &relief.raised);
        let params = EmbedParams { strength, ..self.request.params };
        let with_step = |step| {
            let round = |positions: &mut [DVec3]| {
                self.asset.with_step(step).round_until(positions, self.request.stop);
            };
            let placed = self.base().embedded(raised, codeword, &params, &round)?;
            Ok(Made { placed, strength, amplitude: self.request.amplitude, step })
        };
        let step = STEP * strength.get() * self.width;
        match with_step(step) {
            // Nothing is refused for the sake of decimals.
            Err(error) if is_capacity(&error) && self.asset.is_coarse(step) => with_step(0.0),
            made => made,
        }
    }

    /// The relief alone; where there is none, the reason why it was to be alone.
    fn relief_alone(
        &self,
        amplitude: Amplitude,
        reason: Option<MarkError>,
    ) -> Result<Made, MarkError> {
        let nothing = MarkError::ReliefTooSmall { log10: 0.0, needed: super::check::NEEDED };
        let Some(relief) = &self.relief else { return Err(reason.unwrap_or(nothing)) };
        let step = RELIEF_STEP * amplitude.get() * relief.field.diagonal();
        let round = |positions: &mut [DVec3]| {
            self.asset.with_step(step).round_until(positions, self.request.stop);
        };
        let lower = if amplitude == self.request.amplitude {
            None
        } else {
            Some(self.base().raised(&relief.field, &relief.signs, amplitude)?)
        };
        let placed = self.base().alone(lower.as_ref().unwrap_or(&relief.raised), &round)?;
        Ok(Made { placed, strength: self.request.params.strength, amplitude, step })
    }

    /// The same within a limit. An amplitude that is chosen by what its signs do has been tried like a
    /// strength.
    fn relief_alone_within(
        &self,
        limit: MaxDistortion,
        reason: Option<MarkError>,
    ) -> Result<Fitted<Made>, MarkError> {
        let mut reason = reason;
        let mut least = f64::INFINITY;
        let mut share = self.request.amplitude.get();
        for refused_strengths in 0..MOST_AMPLITUDES {
            let Ok(amplitude) = Amplitude::new(share) else { break };
            let made = self.relief_alone(amplitude, reason.take())?;
            if made.placed.quality.mrms <= limit.get() {
                return Ok(Fitted { made, refused_strengths });
            }
            least = least.min(made.placed.quality.mrms);
            share *= LOWER;
        }
        Err(MarkError::DistortionUnreachable { limit: limit.get(), least })
    }

    /// The host's own frame.
    pub(super) fn host_frame(&self, made: &Made) -> Frame {
        let own = || {
            let centre = self.surface.centre();
            Frame::spanning(centre, &norms(&self.surface.positions, centre))
        };
        made.placed.embedding.as_ref().map_or_else(own, |blind| blind.host_frame)
    }
}

/// Width of a bin in the host's own frame; `None` once `stop` answers `true`.
fn bin_width(surface: &Surface, bits: BitCount, stop: Stop<'_>) -> Option<f64> {
    let centre = surface.centre_until(stop)?;
    let norms = norms(&surface.positions, centre);
    Some(Frame::spanning(centre, &norms).radial_extent() / bits.get() as f64)
}
