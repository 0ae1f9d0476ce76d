//! A suspect: a surface, and what a blind reader observes of it.

use super::profile::Profile;
use crate::mesh::Mesh;
use crate::mesh::stop::{Stop, never};
use crate::mesh::surface::Surface;
use crate::watermark::bins::{BinLayout, BinStatistic, Frame, norms, statistics};
use crate::watermark::{BitCount, Modulation, SoftBits, WatermarkError};

/// A surface with its profile in its own frame, the blind one.
#[derive(Debug, Clone)]
pub struct Suspect {
    surface: Surface,
    profile: Profile,
}

impl Suspect {
    /// The suspect, read in its own frame.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn new(mesh: &Mesh) -> Result<Self, WatermarkError> {
        Self::new_until(mesh, &never)
    }

    /// As [`Self::new`], as long as `stop` answers `false`.
    ///
    /// # Errors
    /// Also [`WatermarkError::Cancelled`].
    pub fn new_until(mesh: &Mesh, stop: Stop<'_>) -> Result<Self, WatermarkError> {
        let surface = Surface::new_until(mesh, stop).ok_or(WatermarkError::Cancelled)?;
        let centre = surface.centre_until(stop);
        let about = |centre| Profile::about_until(&surface.positions, centre, stop);
        let profile = centre.and_then(about).ok_or(WatermarkError::Cancelled)?;
        if profile.frame().radial_extent() > 0.0 {
            Ok(Self { surface, profile })
        } else {
            Err(WatermarkError::NoRadialExtent { vertices: surface.positions.len() })
        }
    }

    /// The soft bits of a layout class in a known frame: the centre and range of `frame` instead of the
    /// suspect's own. One pass over the norms; all bins are erasures where the frame has no extent.
    #[must_use]
    pub fn read_in(
        &self,
        frame: &Frame,
        class: u8,
        bits: BitCount,
        modulation: Modulation,
    ) -> SoftBits {
        let norms = norms(&self.surface.positions, frame.centre);
        let read = |layout| statistics(&norms, &layout, modulation);
        let none = || vec![BinStatistic::default(); bits.get()];
        SoftBits::new(&BinLayout::new(frame, class, bits).map_or_else(none, read), modulation)
    }

    /// The whole profile in a known frame; `None` once `stop` answers `true`.
    #[must_use]
    pub fn in_frame_until(&self, frame: &Frame, stop: Stop<'_>) -> Option<Profile> {
        Profile::new_until(&self.surface.positions, *frame, stop)
    }

    /// Its surface.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Its profile in its own frame.
    #[must_use]
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Its own frame.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.profile.frame()
    }

    /// How many carrier vertices there are.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.surface.positions.len()
    }

    /// The soft bits of a layout class in its own frame.
    #[must_use]
    pub fn read(&self, class: u8, bits: BitCount, modulation: Modulation) -> SoftBits {
        self.profile.read(class, bits, modulation)
    }
}
