//! A suspect: a surface, and what a blind reader sees of it.

use super::bins::{BinStatistic, Frame, Lattice, norms, statistics};
use super::profile::Profile;
use super::{BitCount, Modulation, SoftBits, WatermarkError};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;

/// A surface with its profile in its own, blind frame.
#[derive(Debug, Clone)]
pub struct Suspect {
    surface: Surface,
    profile: Profile,
}

impl Suspect {
    /// The suspect in its own frame.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn new(mesh: &Mesh) -> Result<Self, WatermarkError> {
        let surface = Surface::new(mesh);
        let profile = Profile::about(&surface.positions, surface.centre());
        if profile.frame().radial_extent() > 0.0 {
            Ok(Self { surface, profile })
        } else {
            Err(WatermarkError::NoRadialExtent { vertices: surface.positions.len() })
        }
    }

    /// The soft bits of a lattice class in a known frame, in place: the frame's centre and range
    /// instead of its own. One pass over the norms; all erasures where the frame has no extent.
    #[must_use]
    pub fn read_in(
        &self,
        frame: &Frame,
        class: u8,
        bits: BitCount,
        modulation: Modulation,
    ) -> SoftBits {
        let norms = norms(&self.surface.positions, frame.centre);
        let read = |lattice| statistics(&norms, &lattice, modulation);
        let none = || vec![BinStatistic::default(); bits.get()];
        SoftBits::new(&Lattice::new(frame, class, bits).map_or_else(none, read), modulation)
    }

    /// The whole profile in a known frame.
    #[must_use]
    pub fn in_frame(&self, frame: &Frame) -> Profile {
        Profile::new(&self.surface.positions, *frame)
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

    /// The soft bits of a lattice class in its own frame.
    #[must_use]
    pub fn read(&self, class: u8, bits: BitCount, modulation: Modulation) -> SoftBits {
        self.profile.read(class, bits, modulation)
    }
}
