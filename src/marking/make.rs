//! Makes one mark on one host, with a given strength or within a limit of distortion.

use glam::DVec3;

use super::layers::{Placed, UnmarkedHost, WithRelief, signs};
use super::within::{MOST_AMPLITUDES, PROBES, Room, first_strength, shares, strongest_within};
use super::{MarkError, MarkRequest, MaxDistortion};
use crate::formats::Asset;
use crate::mesh::stop::Stop;
use crate::mesh::surface::Surface;
use crate::relief::{Amplitude, Field, Layers, Signs};
use crate::watermark::bins::norms;
use crate::watermark::{BitCount, Codeword, EmbedParams, Frame, MarkKey, Strength, WatermarkError};

/// Largest step of written coordinates, as a share of how far a mark moves the statistic of a bin:
/// its strength times the bin's width. Moves of less than half a step are lost to rounding, and the
/// closed loop makes up for them elsewhere. `benches/decimals.rs` shows what coarser and finer
/// steps cost.
const STEP: f64 = 0.02;

/// Largest step of written coordinates for a relief alone, as a share of its amplitude. The error
/// of rounding is then 3 % of the amplitude.
const RELIEF_STEP: f64 = 0.1;

/// The relief's share of a limit of distortion. The blind layer moves vertices independently of the
/// relief, so `sqrt(1 - 0.8^2) = 0.6` of the limit is left for it. With a limit of 0.01 %, that is
/// enough for the blind layer's usual strength on nearly all meshes
/// (`cargo bench --bench limits -- --layers both --limits 1e-4`).
const RELIEF_SHARE: f64 = 0.8;

/// Ratio from an amplitude of a relief alone that distorts too much to the next one.
const AMPLITUDE_RATIO: f64 = 0.85;

/// The amplitude of a relief that leaves room for a blind layer within a limit.
pub(super) fn relief_within(limit: MaxDistortion) -> Result<Amplitude, String> {
    Amplitude::new(RELIEF_SHARE * limit.get())
}

/// A mark, with its distortion of the surface.
pub(super) struct Made {
    pub(super) placed: Placed,
    pub(super) strength: Strength,
    /// Of the relief, if there is one.
    pub(super) amplitude: Amplitude,
    /// The step of coordinates that it was rounded with.
    pub(super) step: f64,
}

/// The accepted result, and how many codewords, strengths and amplitudes were refused before.
pub(super) struct Fitted<T> {
    pub(super) made: T,
    pub(super) refused: u32,
}

/// The relief of a key.
pub(super) struct Relief {
    pub(super) signs: Signs,
    raised: WithRelief,
}

/// Makes marks on one host.
pub(super) struct Maker<'a> {
    pub(super) asset: &'a Asset,
    pub(super) request: &'a MarkRequest<'a>,
    pub(super) surface: Surface,
    probes: [Codeword; PROBES.len()],
    /// None where no relief is requested, or the surface has none.
    pub(super) field: Option<Field>,
    /// Index of the key that is used among the request's keys.
    pub(super) place: usize,
    codeword: Codeword,
    /// The relief of the key that is used; none without a field.
    pub(super) relief: Option<Relief>,
    /// Width of a bin in the host's own frame.
    width: f64,
}

/// Whether another mark may fit the host where this one does not.
fn is_about_the_mark(error: &MarkError) -> bool {
    matches!(
        error,
        MarkError::DistortionUnreachable { .. }
            | MarkError::Watermark(
                WatermarkError::InsufficientCapacity { .. } | WatermarkError::NoRadialExtent { .. }
            )
    )
}

impl<'a> Maker<'a> {
    /// Welds the host and makes the relief of the first key.
    pub(super) fn new(asset: &'a Asset, request: &'a MarkRequest<'a>) -> Result<Self, MarkError> {
        let stop = request.stop;
        let surface = Surface::new_until(asset.mesh(), stop).ok_or(WatermarkError::Cancelled)?;
        let bits = request.params.bits;
        let codeword = Codeword::new(request.key, request.message);
        let probes = PROBES.map(|number| Codeword::probe(bits, number));
        let width = bin_width(&surface, bits, stop).ok_or(WatermarkError::Cancelled)?;
        let field = request.layers.has_relief().then(|| Field::new_until(&surface, stop));
        if stop() {
            return Err(WatermarkError::Cancelled.into());
        }
        let (field, relief, place) = (field.flatten(), None, 0);
        let mut maker =
            Self { asset, request, surface, probes, field, place, codeword, relief, width };
        maker.relief = maker.raised()?;
        Ok(maker)
    }

    /// The relief of the key that is used.
    fn raised(&self) -> Result<Option<Relief>, MarkError> {
        let Some(field) = &self.field else { return Ok(None) };
        let signs = signs(self.key(), field);
        let raised = self.base().raised(field, &signs, self.request.amplitude)?;
        Ok(Some(Relief { signs, raised }))
    }

    /// The key that is used.
    pub(super) fn key(&self) -> &MarkKey {
        self.request.keys().nth(self.place).unwrap_or(self.request.key)
    }

    /// Switches to the key at this index.
    fn use_key(&mut self, place: usize) -> Result<(), MarkError> {
        if place != self.place {
            self.place = place;
            self.codeword = Codeword::new(self.key(), self.request.message);
            self.relief = self.raised()?;
        }
        Ok(())
    }

    fn base(&self) -> UnmarkedHost<'_> {
        UnmarkedHost {
            mesh: self.asset.mesh(),
            surface: &self.surface,
            pinned: self.asset.pinned(),
            stop: self.request.stop,
        }
    }

    /// Number of carrier vertices.
    pub(super) fn carriers(&self) -> usize {
        self.surface.positions.len()
    }

    /// The mark with this strength.
    pub(super) fn exactly(&mut self, strength: Strength) -> Result<Fitted<Made>, MarkError> {
        let embed = |maker: &Self, _: bool, tries: &mut u32| {
            *tries += 1;
            maker.embedded(strength)
        };
        self.layered(embed, &|maker| {
            let made = maker.relief_alone(maker.request.amplitude)?;
            Ok(Fitted { made, refused: 0 })
        })
    }

    /// The strongest mark within a limit.
    pub(super) fn within(
        &mut self,
        limit: MaxDistortion,
        start: Strength,
        strongest: Strength,
    ) -> Result<Fitted<Made>, MarkError> {
        let amplitude =
            if self.request.layers.has_relief() { self.request.amplitude.get() } else { 0.0 };
        let left = (limit.get() * limit.get() - amplitude * amplitude).max(0.0).sqrt();
        let mut first = None;
        let embed = |maker: &Self, last: bool, tries: &mut u32| {
            let probed = |place, strength| maker.probed(place, strength);
            let known = match first {
                Some(known) => known,
                None => first_strength(Room { limit, left }, start, strongest, probed)?,
            };
            first = Some(known);
            strongest_within(limit, known, shares(last), |strength| {
                *tries += 1;
                maker.embedded(strength).map(|made| (made.placed.quality.mrms, made))
            })
        };
        self.layered(embed, &|maker| maker.relief_alone_within(limit))
    }

    /// Makes the blind layer of the first key for which `embed` succeeds, on the key's relief where
    /// one is requested. Where no key succeeds, makes the relief of the last key alone.
    ///
    /// The second argument of `embed` says whether no other key follows. The third counts the
    /// codewords and strengths that it tries. A relief that is alone because they were refused is
    /// charged for them: with another key, it would not be alone.
    fn layered(
        &mut self,
        mut embed: impl FnMut(&Self, bool, &mut u32) -> Result<Made, MarkError>,
        alone: &dyn Fn(&Self) -> Result<Fitted<Made>, MarkError>,
    ) -> Result<Fitted<Made>, MarkError> {
        let layers = self.request.layers;
        if layers == Layers::Relief {
            return alone(self);
        }
        let last = self.request.others.len();
        let (mut tries, mut place) = (0, 0);
        let reason = loop {
            self.use_key(place)?;
            let before = tries;
            let error = match embed(self, place == last, &mut tries) {
                Ok(made) => return Ok(Fitted { made, refused: tries.saturating_sub(1) }),
                Err(error) if is_about_the_mark(&error) => error,
                Err(error) => return Err(error),
            };
            // Where nothing was tried, the reason is the host, and no other key helps.
            if place == last || tries == before {
                break error;
            }
            place += 1;
        };
        if layers == Layers::Blind || self.relief.is_none() {
            return Err(reason);
        }
        let Fitted { made, refused } = alone(self)?;
        Ok(Fitted { made, refused: tries + refused })
    }

    /// The MRMS of the probe at this index of [`PROBES`], a codeword that belongs to nobody, on the
    /// host without a relief.
    fn probed(&self, place: usize, strength: Strength) -> Result<f64, MarkError> {
        let probe = self.probes.get(place).unwrap_or(&self.codeword);
        self.blind(None, probe, strength).map(|made| made.placed.quality.mrms)
    }

    /// The blind layer of the key that is used, on its relief if there is one.
    fn embedded(&self, strength: Strength) -> Result<Made, MarkError> {
        self.blind(self.relief.as_ref().map(|relief| &relief.raised), &self.codeword, strength)
    }

    fn blind(
        &self,
        raised: Option<&WithRelief>,
        codeword: &Codeword,
        strength: Strength,
    ) -> Result<Made, MarkError> {
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
            // No mark is refused because its steps are coarse: try the finest ones.
            Err(error) if is_about_the_mark(&error) && self.asset.is_coarse(step) => with_step(0.0),
            made => made,
        }
    }

    /// The relief alone.
    fn relief_alone(&self, amplitude: Amplitude) -> Result<Made, MarkError> {
        let (Some(field), Some(relief)) = (&self.field, &self.relief) else {
            return Err(MarkError::ReliefTooSmall {
                log10: 0.0,
                needed: super::check::LOG10_NEEDED,
            });
        };
        let step = RELIEF_STEP * amplitude.get() * field.diagonal();
        let round = |positions: &mut [DVec3]| {
            self.asset.with_step(step).round_until(positions, self.request.stop);
        };
        let lower = if amplitude == self.request.amplitude {
            None
        } else {
            Some(self.base().raised(field, &relief.signs, amplitude)?)
        };
        let placed = self.base().alone(lower.as_ref().unwrap_or(&relief.raised), &round)?;
        Ok(Made { placed, strength: self.request.params.strength, amplitude, step })
    }

    /// The relief alone, within a limit. The choice of an amplitude depends on the signs, so each
    /// refused amplitude counts as a try, like a refused strength.
    fn relief_alone_within(&self, limit: MaxDistortion) -> Result<Fitted<Made>, MarkError> {
        let mut least = f64::INFINITY;
        let mut share = self.request.amplitude.get();
        for refused in 0..MOST_AMPLITUDES {
            let Ok(amplitude) = Amplitude::new(share) else { break };
            let made = self.relief_alone(amplitude)?;
            if made.placed.quality.mrms <= limit.get() {
                return Ok(Fitted { made, refused });
            }
            least = least.min(made.placed.quality.mrms);
            share *= AMPLITUDE_RATIO;
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

/// Width of a bin in the host's own frame; `None` once `stop` returns `true`.
fn bin_width(surface: &Surface, bits: BitCount, stop: Stop<'_>) -> Option<f64> {
    let centre = surface.centre_until(stop)?;
    let norms = norms(&surface.positions, centre);
    Some(Frame::spanning(centre, &norms).radial_extent() / bits.get() as f64)
}
