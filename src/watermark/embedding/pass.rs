//! One pass of an embedding: from the original mesh to moved, rounded positions.

use glam::DVec3;

use super::compliance::compliance_data;
use super::guard::{Guard, Moves};
use super::modulate::{Modulated, Modulator, State};
use super::placement::{PlacementSurface, radial};
use crate::mesh::Mesh;
use crate::mesh::stop::{Stop, changed, go_on, mapped};
use crate::mesh::surface::Surface;
use crate::watermark::bins::{BinLayout, Frame, norms};
use crate::watermark::detection::extract::Reading;
use crate::watermark::{Codeword, EmbedParams, Placement, Shaping, WatermarkError};

/// The result of one pass.
#[derive(Debug)]
pub struct Passed {
    /// Positions of all file vertices, rounded as the file stores them.
    pub positions: Vec<DVec3>,
    /// Per bin, the requested margin.
    pub wanted: Vec<f64>,
}

/// The host as an embedding reads it.
#[derive(Clone, Copy)]
pub struct Host<'a> {
    /// The file's vertices and triangles.
    pub mesh: &'a Mesh,
    /// Its welded carriers.
    pub surface: &'a Surface,
    /// File vertices that cannot move.
    pub pinned: &'a [u32],
    /// Replaces positions of all file vertices by what the written file reads back as. A caller that is
    /// stopped meanwhile leaves the positions unchanged.
    pub round: &'a (dyn Fn(&mut [DVec3]) + Sync),
    /// The surface against which turned triangles are judged, with the same carriers, where `surface`
    /// was moved already; `None` where `surface` itself is that surface.
    pub original: Option<&'a Surface>,
}

impl<'a> Host<'a> {
    /// The surface against which turned triangles are judged.
    #[must_use]
    pub fn original(&self) -> &'a Surface {
        self.original.unwrap_or(self.surface)
    }
}

/// What all passes over one host share.
pub struct Passes<'a> {
    host: Host<'a>,
    placement: Option<PlacementSurface<'a>>,
    modulator: Modulator<'a>,
}

impl<'a> Passes<'a> {
    /// Prepares placement and marks what cannot move. `None` once `stop` answers `true`.
    #[must_use]
    pub fn new(
        host: Host<'a>,
        codeword: &'a Codeword,
        params: &'a EmbedParams,
        stop: Stop<'_>,
    ) -> Option<Self> {
        let surface = host.surface;
        let placement = match params.method.placement() {
            Placement::Radial => None,
            Placement::Qsp | Placement::Exact => Some(PlacementSurface::new(surface, stop)?),
        };
        let compliance_data = match (&placement, params.method.shaping()) {
            (Some(PlacementSurface { quadrics, .. }), Shaping::Allocation) => {
                compliance_data(surface, quadrics, surface.centre_until(stop)?, stop)?
            }
            _ => Vec::new(),
        };
        let mut fixed = vec![false; surface.positions.len()];
        for &vertex in host.pinned {
            let carrier = surface.carrier_of.get(vertex as usize);
            if let Some(fixed) = carrier.and_then(|&c| fixed.get_mut(c as usize)) {
                *fixed = true;
            }
        }
        let modulator = Modulator::new(codeword, params, fixed, compliance_data, stop)?;
        Some(Self { host, placement, modulator })
    }

    /// What a blind reader reads from carriers with these `norms` about `centre`; `None` when they have
    /// no radial extent.
    #[must_use]
    pub fn read(&self, centre: DVec3, norms: &[f64]) -> Option<Reading> {
        let Modulator { codeword, params, .. } = self.modulator;
        let frame = Frame::spanning(centre, norms);
        let (class, bits) = (codeword.layout_class(), codeword.bit_count());
        Reading::in_frame(frame, norms, class, bits, params.method.modulation())
    }

    /// One pass from the original mesh, about `centre`: modulate, place, round.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`]; [`WatermarkError::Cancelled`] once `stop` answers `true`.
    pub fn run(
        &self,
        centre: DVec3,
        state: &mut State,
        stop: Stop<'_>,
    ) -> Result<Passed, WatermarkError> {
        let cancelled = WatermarkError::Cancelled;
        let surface = self.host.surface;
        let codeword = self.modulator.codeword;
        let rho = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &rho);
        let layout = BinLayout::new(&frame, codeword.layout_class(), codeword.bit_count())
            .ok_or(WatermarkError::NoRadialExtent { vertices: rho.len() })?;
        let modulated = self.modulator.modulate(&rho, &layout, state, stop);
        let mut modulated = modulated.ok_or(cancelled.clone())?;
        let placed = self.place(centre, &rho, &mut modulated, state, stop);
        let placed = placed.ok_or(cancelled.clone())?;
        let mut positions = self.host.mesh.positions().to_vec();
        let moved = changed(&mut positions, stop, |vertex, position| {
            if let Some(&placed) = placed.get(surface.carrier_of[vertex] as usize)
                && placed != *position
            {
                *position = placed;
            }
        });
        moved.ok_or(cancelled.clone())?;
        (self.host.round)(&mut positions);
        go_on(stop).ok_or(cancelled)?;
        Ok(Passed { positions, wanted: modulated.wanted })
    }

    /// The carriers at their new norms. The guard may change some of these norms.
    fn place(
        &self,
        centre: DVec3,
        rho: &[f64],
        modulated: &mut Modulated,
        state: &mut State,
        stop: Stop<'_>,
    ) -> Option<Vec<DVec3>> {
        let method = self.modulator.params.method;
        let new_rho = &mut modulated.norms;
        let place = |carrier: usize, v: DVec3| {
            let (rho, new_rho) = (rho[carrier], new_rho[carrier]);
            if rho.to_bits() == new_rho.to_bits() {
                return v;
            }
            match (&self.placement, method.placement()) {
                (Some(placement), Placement::Exact) => {
                    let stiffness = state.stiffness.of(carrier);
                    placement.exact(centre, carrier, rho, new_rho, stiffness)
                }
                (Some(placement), Placement::Qsp) => placement.qsp(centre, carrier, rho, new_rho),
                _ => radial(centre, v, rho, new_rho),
            }
        };
        let mut placed = mapped(&self.host.surface.positions, stop, |k, &v| place(k, v))?;
        if let (Some(placement), Shaping::Allocation) = (&self.placement, method.shaping()) {
            let compliance_data = &self.modulator.compliance_data;
            let guard = Guard { surface: self.host.original(), placement, compliance_data };
            let placed = &mut placed;
            guard.turn_back(
                &mut Moves { centre, rho, new_rho, placed },
                &mut state.stiffness,
                stop,
            )?;
        }
        Some(placed)
    }

    /// Positions of the carriers among those of all file vertices; `None` once `stop` answers `true`.
    #[must_use]
    pub fn carriers_of(&self, positions: &[DVec3], stop: Stop<'_>) -> Option<Vec<DVec3>> {
        mapped(&self.host.surface.first_vertex, stop, |_, &v| positions[v as usize])
    }
}
