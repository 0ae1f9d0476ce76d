//! One pass of an embedding: from the original mesh to moved, rounded positions.

use glam::DVec3;
use rayon::prelude::*;

use super::allocation::{Allocation, Freedom};
use super::bins::{Frame, Lattice, contribution, norms};
use super::budget::margins;
use super::compliance::{Compliance, Pliancy, pliancies};
use super::exact::LAMBDA;
use super::extract::Reading;
use super::placement::{PlacementSurface, radial};
use super::power_map::power_map;
use super::sorted::{BinMemory, BinSlice, SortedByBin};
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

/// How often a bin whose vertices cannot reach its target within their reach is widened.
const MOST_WIDENINGS: u32 = 10;

/// Where most bins cannot reach their margin, all reaches grow by this factor, so often at the
/// most. Doubling them instead turned three times as many
/// triangles of the dragon over (4,134 against 1,278 with `exact-mean`, two keys).
const STEP: f64 = 1.25;
const MOST_STEPS: u32 = 30;

/// By how much plain displacement is penalised more at each widening.
const STIFFENING: f64 = 2.0;

/// By how much a vertex of a triangle that was turned over is held back.
const HOLD: f64 = 0.5;

/// What an embedding learns from round to round.
#[derive(Debug, Default)]
pub struct State {
    /// Which bin each carrier was in.
    pub memory: BinMemory,
    /// Per bin, what is added to its wanted margin because earlier rounds fell short of it.
    pub corrections: Vec<f64>,
    /// Per carrier, the share of its reach that it may use; empty until one is held back.
    hold: Vec<f64>,
}

impl State {
    /// Before the first round, for `bins` bins.
    #[must_use]
    pub fn new(bins: usize) -> Self {
        Self { corrections: vec![0.0; bins], ..Self::default() }
    }

    /// What a carrier at place `t` may do.
    fn freedom(
        &self,
        carrier: u32,
        t: f64,
        Compliance { compliance, reach }: Compliance,
        lattice: &Lattice,
    ) -> Freedom {
        let held = self.hold.get(carrier as usize).copied().unwrap_or(1.0);
        Freedom::new(compliance, t, held * reach / lattice.width)
    }
}

/// What one pass makes.
#[derive(Debug)]
pub struct Passed {
    /// Positions of all file vertices, rounded as the file stores them.
    pub positions: Vec<DVec3>,
    /// Per bin, the margin it was meant to have.
    pub wanted: Vec<f64>,
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
    /// Per carrier, for allocation: the compliance with the usual `lambda`, and what it is made of.
    compliances: Vec<Compliance>,
    pliancies: Vec<Pliancy>,
    /// Per carrier, whether it cannot move.
    fixed: Vec<bool>,
}

/// What the bins were given.
struct Modulated {
    /// Per carrier its new norm.
    norms: Vec<f64>,
    /// Per carrier the `lambda` to place it with; empty when it is the usual one for all.
    lambdas: Vec<f64>,
    /// Per bin the margin it was meant to have.
    wanted: Vec<f64>,
}

impl<'a> Passes<'a> {
    /// Prepares placement and marks what cannot move.
    #[must_use]
    pub fn new(host: Host<'a>, codeword: &'a Codeword, params: &'a EmbedParams) -> Self {
        let placement = match params.method.placement() {
            Placement::Radial => None,
            Placement::Qsp | Placement::Exact => Some(PlacementSurface::new(host.surface)),
        };
        let pliancies = match (&placement, params.method.shaping()) {
            (Some(prepared), Shaping::Allocation) => pliancies(
                host.surface,
                &prepared.adjacency,
                &prepared.quadrics,
                host.surface.centre(),
            ),
            _ => Vec::new(),
        };
        let compliances = pliancies.par_iter().map(|pliancy| pliancy.at(LAMBDA)).collect();
        let carriers = host.surface.positions.len();
        let mut fixed = vec![false; carriers];
        for &vertex in host.pinned {
            let carrier = host.surface.carrier_of.get(vertex as usize);
            if let Some(fixed) = carrier.and_then(|&c| fixed.get_mut(c as usize)) {
                *fixed = true;
            }
        }
        Self { host, codeword, params, placement, compliances, pliancies, fixed }
    }

    /// What a blind reader sees of carriers with these `norms` about `centre`.
    #[must_use]
    pub fn read(&self, centre: DVec3, norms: &[f64]) -> Option<Reading> {
        let frame = Frame::spanning(centre, norms);
        let (class, bits) = (self.codeword.lattice_class(), self.codeword.bit_count());
        Reading::in_frame(frame, norms, class, bits, self.params.method.modulation())
    }

    /// One pass from the original mesh, about `centre`: modulate, place, round.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn run(&self, centre: DVec3, state: &mut State) -> Result<Passed, WatermarkError> {
        let surface = self.host.surface;
        let rho = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &rho);
        let bits = self.codeword.bit_count();
        let lattice = Lattice::new(&frame, self.codeword.lattice_class(), bits)
            .ok_or(WatermarkError::NoRadialExtent { vertices: rho.len() })?;
        let Modulated { norms: new_rho, lambdas, wanted } = self.modulate(&rho, &lattice, state);
        let place = |carrier: usize, v: DVec3| {
            let (rho, new_rho) = (rho[carrier], new_rho[carrier]);
            if rho.to_bits() == new_rho.to_bits() {
                return v;
            }
            match &self.placement {
                None => radial(centre, v, rho, new_rho),
                Some(placement) => match self.params.method.placement() {
                    Placement::Exact => {
                        let lambda = lambdas.get(carrier).copied().unwrap_or(LAMBDA);
                        placement.exact(centre, carrier, rho, new_rho, lambda)
                    }
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
        Ok(Passed { positions, wanted })
    }

    /// New norms: each bin's statistic is moved to its goal on the side of its bit. In the closed loop a bin that is already beyond its
    /// goal on the right side is left alone.
    fn modulate(&self, rho: &[f64], lattice: &Lattice, state: &mut State) -> Modulated {
        let sorted = SortedByBin::new(rho, lattice, &self.fixed, &state.memory);
        if self.params.closed_loop {
            state.memory.keep(&sorted, rho.len());
        }
        let strength = self.params.strength.get();
        let (freedoms, wanted) = match self.params.method.shaping() {
            Shaping::PowerMap => (Vec::new(), vec![strength; lattice.bins]),
            Shaping::Allocation => self.budget(&sorted, lattice, state),
        };
        let (mut places, mut logs) = (sorted.places.clone(), vec![0.0; sorted.places.len()]);
        let lambdas: Vec<Option<f64>> = sorted
            .slices(&mut places, &mut logs)
            .into_par_iter()
            .with_max_len(1)
            .map(|slice| {
                let correction = state.corrections.get(slice.bin).copied().unwrap_or(0.0);
                let goal = wanted[slice.bin] + correction;
                let target = self.target(&slice, goal)?;
                match self.params.method.shaping() {
                    Shaping::PowerMap => {
                        let modulation = self.params.method.modulation();
                        power_map(modulation, slice.places, slice.logs, target);
                        Some(LAMBDA)
                    }
                    Shaping::Allocation => {
                        let circumstances = (lattice, &*state);
                        Some(self.allocate(&sorted, &freedoms, slice, target, circumstances))
                    }
                }
            })
            .collect();
        let norms = self.new_norms(rho, lattice, &sorted, &places, &lambdas);
        let lambdas = Self::lambdas_of_carriers(&sorted, &lambdas, rho.len());
        Modulated { norms, lambdas, wanted }
    }

    /// The statistic that a bin must be moved to; `None` when it may stay.
    fn target(&self, slice: &BinSlice<'_>, goal: f64) -> Option<f64> {
        let modulation = self.params.method.modulation();
        let bit = self.codeword.bits()[slice.bin];
        let sum: f64 = slice.places.iter().map(|&t| contribution(modulation, t)).sum();
        let deviation = sum / slice.places.len().max(1) as f64 - modulation.neutral();
        let already = if bit { deviation >= goal } else { deviation <= -goal };
        let (low, high) = TARGET_RANGE;
        let signed = if bit { goal } else { -goal };
        let stays = slice.places.is_empty() || (already && self.params.closed_loop);
        (!stays).then(|| (modulation.neutral() + signed).clamp(low, high))
    }

    /// Per carrier the `lambda` of its bin; empty when all bins have the usual one.
    fn lambdas_of_carriers(
        sorted: &SortedByBin,
        lambdas: &[Option<f64>],
        carriers: usize,
    ) -> Vec<f64> {
        let unusual = |lambda: &Option<f64>| lambda.filter(|&lambda| lambda > LAMBDA);
        if !lambdas.iter().any(|lambda| unusual(lambda).is_some()) {
            return Vec::new();
        }
        let mut of = vec![LAMBDA; carriers];
        for (bin, lambda) in lambdas.iter().enumerate() {
            if let Some(lambda) = unusual(lambda) {
                for &carrier in &sorted.carriers[sorted.range(bin)] {
                    of[carrier as usize] = lambda;
                }
            }
        }
        of
    }

    #[expect(clippy::float_cmp, reason = "a place that was not touched is the same to the bit")]
    fn new_norms(
        &self,
        rho: &[f64],
        lattice: &Lattice,
        sorted: &SortedByBin,
        places: &[f64],
        lambdas: &[Option<f64>],
    ) -> Vec<f64> {
        let edge = if self.params.closed_loop { EDGE } else { 0.0 };
        let power_map = self.params.method.shaping() == Shaping::PowerMap;
        let mut new_rho = rho.to_vec();
        for (bin, lambda) in lambdas.iter().enumerate() {
            for k in sorted.range(bin) {
                let (t, strayed) = (places[k], sorted.strayed[k]);
                if strayed || (lambda.is_some() && (power_map || t != sorted.places[k])) {
                    // The allocation's own ranges keep clear of the edges.
                    let keep = if power_map || strayed { edge } else { 0.0 };
                    let place = t.clamp(keep, 1.0 - keep);
                    new_rho[sorted.carriers[k] as usize] = lattice.norm_at(bin, place);
                }
            }
        }
        new_rho
    }

    /// What each sorted carrier may do, and the margin that each bin is to have. Where most bins
    /// cannot reach their full margin (a mesh of slivers, whose heights say little about how far
    /// neighbours can move together), all reaches grow until they can.
    fn budget(
        &self,
        sorted: &SortedByBin,
        lattice: &Lattice,
        state: &State,
    ) -> (Vec<Freedom>, Vec<f64>) {
        let strength = self.params.strength.get();
        let mut freedoms = self.freedoms(sorted, lattice, state);
        for _ in 0..MOST_STEPS {
            let allocations: Vec<_> =
                (0..lattice.bins).map(|bin| self.allocation(sorted, &freedoms, bin)).collect();
            if let Some(wanted) = margins(&allocations, self.codeword.bits(), strength) {
                return (freedoms, wanted);
            }
            freedoms.par_iter_mut().zip(&sorted.places).with_min_len(4096).for_each(
                |(freedom, &t)| {
                    *freedom = Freedom::new(freedom.compliance, t, STEP * freedom.reach);
                },
            );
        }
        (freedoms, vec![strength; lattice.bins])
    }

    /// What each sorted carrier may do, within its reach and clear of its bin's edges.
    fn freedoms(&self, sorted: &SortedByBin, lattice: &Lattice, state: &State) -> Vec<Freedom> {
        let freedom = |(&carrier, &t): (&u32, &f64)| {
            state.freedom(carrier, t, self.compliances[carrier as usize], lattice)
        };
        sorted.carriers.par_iter().zip(&sorted.places).with_min_len(4096).map(freedom).collect()
    }

    fn allocation<'s>(
        &self,
        sorted: &'s SortedByBin,
        freedoms: &'s [Freedom],
        bin: usize,
    ) -> Allocation<'s> {
        let range = sorted.range(bin);
        let modulation = self.params.method.modulation();
        Allocation { modulation, places: &sorted.places[range.clone()], freedoms: &freedoms[range] }
    }

    /// Allocates within each vertex's reach. Where the target lies beyond what the bin's vertices
    /// reach together, they are let go further and plain displacement is penalised more, step by
    /// step: moves become shorter for the same change of the norm and more alike among
    /// neighbours, which turns no triangle over, however far they go. Returns the `lambda` with
    /// which the bin's vertices are to be placed.
    #[expect(clippy::needless_pass_by_value, reason = "the slice's places are written to")]
    fn allocate(
        &self,
        sorted: &SortedByBin,
        freedoms: &[Freedom],
        slice: BinSlice<'_>,
        target: f64,
        (lattice, state): (&Lattice, &State),
    ) -> f64 {
        let narrow = self.allocation(sorted, freedoms, slice.bin);
        let solution = narrow.solve(target);
        narrow.apply(solution.multiplier, slice.places);
        if solution.reached {
            return LAMBDA;
        }
        let carriers = &sorted.carriers[sorted.range(slice.bin)];
        let (mut lambda, mut further) = (LAMBDA, 1.0);
        for _ in 0..MOST_WIDENINGS {
            lambda *= STIFFENING;
            further *= 2.0;
            let wide = carriers.iter().zip(narrow.places).map(|(&carrier, &t)| {
                let compliance = self.pliancies[carrier as usize].at(lambda);
                let freedom = state.freedom(carrier, t, compliance, lattice);
                Freedom::new(freedom.compliance, t, further * freedom.reach)
            });
            let wide: Vec<Freedom> = wide.collect();
            let problem = Allocation { freedoms: &wide, ..narrow };
            let solution = problem.solve(target);
            problem.apply(solution.multiplier, slice.places);
            if solution.reached {
                break;
            }
        }
        lambda
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
