//! One pass of an embedding: from the original mesh to moved, rounded positions.

use glam::DVec3;
use rayon::prelude::*;

use super::allocation::{Freedom, allocate};
use super::bins::{Frame, Lattice, contribution, norms};
use super::compliance::{Compliance, compliances};
use super::extract::Reading;
use super::placement::{PlacementSurface, radial};
use super::power_map::power_map;
use super::sorted::{BinMemory, SortedByBin};
use super::{Codeword, EmbedParams, Placement, Shaping, WatermarkError};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::mesh::turning::flipped_triangles;

/// In the closed loop a moved vertex keeps this share of the bin's width away from its edges,
/// so that a slight shift of the centre or a conversion cannot tip it over.
const EDGE: f64 = 0.02;

/// Bounds of a bin's target statistic: beyond them all its vertices stand at one edge, from
/// where the least shift of the centre tips them into the next bin.
const TARGET_RANGE: (f64, f64) = (0.04, 0.96);

/// In the allocation, the share of the bin's width that stays free at both edges: with less, a
/// centre shift of 0.3 % of a bin tips vertices over (method section 3).
const ALLOCATION_EDGE: f64 = 0.08;

/// How often a bin whose vertices cannot reach its target within their reach is widened.
const MOST_WIDENINGS: u32 = 8;

/// By how much a vertex of a triangle that was turned over is held back.
const HOLD: f64 = 0.5;

/// What an embedding learns from round to round.
#[derive(Debug, Default)]
pub struct State {
    /// Which bin each carrier was in.
    pub memory: BinMemory,
    /// Per carrier, the share of its reach that it may use; empty until one is held back.
    hold: Vec<f64>,
}

/// The host as an embedding sees it.
#[derive(Clone, Copy)]
pub struct Host<'a> {
    /// The file's vertices and triangles.
    pub mesh: &'a Mesh,
    /// Its welded carriers.
    pub surface: &'a Surface,
    /// File vertices that cannot move.
    pub pinned: &'a [u32],
    /// Replaces positions of all file vertices by what the written file reads back as.
    pub round: &'a (dyn Fn(&mut [DVec3]) + Sync),
}

/// What all passes over one host share.
pub struct Passes<'a> {
    host: Host<'a>,
    codeword: &'a Codeword,
    params: &'a EmbedParams,
    placement: Option<PlacementSurface<'a>>,
    /// Per carrier, for allocation.
    compliances: Vec<Compliance>,
    /// Per carrier, whether it cannot move.
    fixed: Vec<bool>,
}

impl<'a> Passes<'a> {
    /// Prepares placement and marks what cannot move.
    #[must_use]
    pub fn new(host: Host<'a>, codeword: &'a Codeword, params: &'a EmbedParams) -> Self {
        let placement = match params.method.placement() {
            Placement::Radial => None,
            Placement::Qsp | Placement::Exact => Some(PlacementSurface::new(host.surface)),
        };
        let compliances = match (&placement, params.method.shaping()) {
            (Some(prepared), Shaping::Allocation) => compliances(
                host.surface,
                &prepared.adjacency,
                &prepared.quadrics,
                host.surface.centre(),
            ),
            _ => Vec::new(),
        };
        let carriers = host.surface.positions.len();
        let mut fixed = vec![false; carriers];
        for &vertex in host.pinned {
            let carrier = host.surface.carrier_of.get(vertex as usize);
            if let Some(fixed) = carrier.and_then(|&c| fixed.get_mut(c as usize)) {
                *fixed = true;
            }
        }
        Self { host, codeword, params, placement, compliances, fixed }
    }

    /// What a blind reader sees of carriers with these `norms` about `centre`.
    #[must_use]
    pub fn read(&self, centre: DVec3, norms: &[f64]) -> Option<Reading> {
        let frame = Frame::spanning(centre, norms);
        let (class, bits) = (self.codeword.lattice_class(), self.codeword.bit_count());
        Reading::in_frame(frame, norms, class, bits, self.params.method.modulation())
    }

    /// One pass from the original mesh, about `centre`: modulate, place, round. Returns the
    /// positions of all file vertices.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn run(
        &self,
        centre: DVec3,
        goals: &[f64],
        state: &mut State,
    ) -> Result<Vec<DVec3>, WatermarkError> {
        let surface = self.host.surface;
        let rho = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &rho);
        let bits = self.codeword.bit_count();
        let lattice = Lattice::new(&frame, self.codeword.lattice_class(), bits)
            .ok_or(WatermarkError::NoRadialExtent { vertices: rho.len() })?;
        let new_rho = self.modulate(&rho, &lattice, goals, state);
        let place = |carrier: usize, v: DVec3| {
            let (rho, new_rho) = (rho[carrier], new_rho[carrier]);
            if rho.to_bits() == new_rho.to_bits() {
                return v;
            }
            match &self.placement {
                None => radial(centre, v, rho, new_rho),
                Some(placement) => match self.params.method.placement() {
                    Placement::Exact => placement.exact(centre, carrier, rho, new_rho),
                    _ => placement.qsp(centre, carrier, rho, new_rho),
                },
            }
        };
        let placed: Vec<DVec3> = surface
            .positions
            .par_iter()
            .with_min_len(1024)
            .enumerate()
            .map(|(carrier, &v)| place(carrier, v))
            .collect();
        let mut positions = self.host.mesh.positions().to_vec();
        positions.par_iter_mut().zip(&surface.carrier_of).for_each(|(position, &carrier)| {
            if let Some(&placed) = placed.get(carrier as usize)
                && placed != *position
            {
                *position = placed;
            }
        });
        (self.host.round)(&mut positions);
        Ok(positions)
    }

    /// New norms: each bin's statistic is moved to its goal on the side of its bit. In the
    /// closed loop a bin that is already beyond its goal on the right side is left alone.
    fn modulate(
        &self,
        rho: &[f64],
        lattice: &Lattice,
        goals: &[f64],
        state: &mut State,
    ) -> Vec<f64> {
        let sorted = SortedByBin::new(rho, lattice, &self.fixed, &state.memory);
        if self.params.closed_loop {
            state.memory.keep(&sorted, rho.len());
        }
        let modulation = self.params.method.modulation();
        let neutral = modulation.neutral();
        let (mut places, mut logs) = (sorted.places.clone(), vec![0.0; sorted.places.len()]);
        let moved: Vec<bool> = sorted
            .slices(&mut places, &mut logs)
            .into_par_iter()
            .with_max_len(1)
            .map(|slice| {
                let bit = self.codeword.bits()[slice.bin];
                let goal = if bit { goals[slice.bin] } else { -goals[slice.bin] };
                let count = slice.places.len().max(1) as f64;
                let sum: f64 = slice.places.iter().map(|&t| contribution(modulation, t)).sum();
                let deviation = sum / count - neutral;
                let already = if bit { deviation >= goal } else { deviation <= goal };
                if slice.places.is_empty() || (already && self.params.closed_loop) {
                    return false;
                }
                let (low, high) = TARGET_RANGE;
                let target = (neutral + goal).clamp(low, high);
                match self.params.method.shaping() {
                    Shaping::PowerMap => {
                        power_map(modulation, slice.places, slice.logs, target);
                    }
                    Shaping::Allocation => {
                        self.allocate(slice.carriers, slice.places, lattice, target, state);
                    }
                }
                true
            })
            .collect();
        let edge = if self.params.closed_loop { EDGE } else { 0.0 };
        let clamps = self.params.method.shaping() == Shaping::PowerMap;
        let mut new_rho = rho.to_vec();
        for bin in 0..lattice.bins {
            for k in sorted.range(bin) {
                let (t, carrier) = (places[k], sorted.carriers[k] as usize);
                if sorted.strayed[k] || (moved[bin] && (clamps || t != sorted.places[k])) {
                    let keep = if clamps || sorted.strayed[k] { edge } else { 0.0 };
                    new_rho[carrier] = lattice.norm_at(bin, t.clamp(keep, 1.0 - keep));
                }
            }
        }
        new_rho
    }

    /// Allocates within each vertex's reach; where the target lies beyond what the bin's vertices
    /// reach together, they are let go further, twice as far at a time.
    fn allocate(
        &self,
        carriers: &[u32],
        places: &mut [f64],
        lattice: &Lattice,
        target: f64,
        state: &State,
    ) {
        let before = places.to_vec();
        let mut freedoms = Vec::with_capacity(places.len());
        for widening in 0..=MOST_WIDENINGS {
            let factor = f64::from(widening).exp2();
            freedoms.clear();
            freedoms.extend(carriers.iter().zip(&before).map(|(&carrier, &t)| {
                let Compliance { compliance, reach } = self.compliances[carrier as usize];
                let held = state.hold.get(carrier as usize).copied().unwrap_or(1.0);
                let cap = factor * held * reach / lattice.width;
                let low = (t - cap).max(t.min(ALLOCATION_EDGE));
                let high = (t + cap).min(t.max(1.0 - ALLOCATION_EDGE));
                Freedom { compliance: compliance.max(f64::MIN_POSITIVE), range: (low, high) }
            }));
            places.copy_from_slice(&before);
            if allocate(self.params.method.modulation(), places, &freedoms, target) {
                return;
            }
        }
    }

    /// Triangles that the result turned over; their corners are held back from now on.
    pub fn hold_flipped(&self, carriers: &[DVec3], state: &mut State) -> usize {
        let surface = self.host.surface;
        let flipped = flipped_triangles(surface, carriers);
        if !flipped.is_empty() {
            state.hold.resize(surface.positions.len(), 1.0);
        }
        for &t in &flipped {
            for corner in surface.triangles[t as usize] {
                state.hold[corner as usize] *= HOLD;
            }
        }
        flipped.len()
    }

    /// Positions of the carriers among those of all file vertices.
    #[must_use]
    pub fn carriers_of(&self, positions: &[DVec3]) -> Vec<DVec3> {
        self.host.surface.first_vertex.par_iter().map(|&v| positions[v as usize]).collect()
    }
}
