//! Which norm each vertex should get: the bins of one pass and what they ask of their vertices.

use rayon::prelude::*;

use super::allocation::{Allocation, Freedom};
use super::bins::{Lattice, contribution};
use super::budget::margins;
use super::compliance::{Compliance, Pliancy};
use super::exact::LAMBDA;
use super::guard::Stiffness;
use super::power_map::power_map;
use super::sorted::{BinMemory, BinSlice, SortedByBin};
use super::{Codeword, EmbedParams, Shaping};

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

/// What an embedding learns from round to round.
#[derive(Debug, Default)]
pub struct State {
    /// Which bin each carrier was in.
    pub memory: BinMemory,
    /// Per bin, what is added to its wanted margin because earlier rounds fell short of it.
    pub corrections: Vec<f64>,
    /// Which carriers the guard has stiffened.
    pub stiffness: Stiffness,
}

impl State {
    /// Before the first round, for `bins` bins.
    #[must_use]
    pub fn new(bins: usize) -> Self {
        Self { corrections: vec![0.0; bins], ..Self::default() }
    }
}

/// What the bins were given.
#[derive(Debug)]
pub struct Modulated {
    /// Per carrier its new norm.
    pub norms: Vec<f64>,
    /// Per carrier the `lambda` of its bin; empty when it is the usual one for all.
    pub lambdas: Vec<f64>,
    /// Per bin the margin it was meant to have.
    pub wanted: Vec<f64>,
}

/// What all passes of one embedding share.
#[derive(Debug)]
pub struct Modulator<'a> {
    /// What the bins are to say.
    pub codeword: &'a Codeword,
    /// How strongly, by which method.
    pub params: &'a EmbedParams,
    /// Per carrier, whether it cannot move.
    pub fixed: Vec<bool>,
    /// Per carrier, for allocation: what its compliance is made of, and the usual one.
    pub pliancies: Vec<Pliancy>,
    compliances: Vec<Compliance>,
}

impl<'a> Modulator<'a> {
    /// For carriers of which some are `fixed`; `pliancies` may be empty where nothing is allocated.
    #[must_use]
    pub fn new(
        codeword: &'a Codeword,
        params: &'a EmbedParams,
        fixed: Vec<bool>,
        pliancies: Vec<Pliancy>,
    ) -> Self {
        let compliances = pliancies.par_iter().map(|pliancy| pliancy.at(LAMBDA)).collect();
        Self { codeword, params, fixed, pliancies, compliances }
    }

    /// New norms: each bin's statistic is moved to its goal on the side of its bit. In the closed
    /// loop a bin that is already beyond its goal on the right side is left alone.
    #[must_use]
    pub fn modulate(&self, rho: &[f64], lattice: &Lattice, state: &mut State) -> Modulated {
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
        let freedom =
            |(&carrier, &t): (&u32, &f64)| self.freedom(carrier, t, LAMBDA, (lattice, state));
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
        circumstances: (&Lattice, &State),
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
                let freedom = self.freedom(carrier, t, lambda, circumstances);
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

    /// What a carrier at place `t` may do when its bin has this `lambda`.
    fn freedom(
        &self,
        carrier: u32,
        t: f64,
        lambda: f64,
        (lattice, state): (&Lattice, &State),
    ) -> Freedom {
        let carrier = carrier as usize;
        let stiffness = state.stiffness.of(carrier);
        #[expect(clippy::float_cmp, reason = "untouched is exactly 1")]
        let usual = stiffness == 1.0 && lambda == LAMBDA;
        let Compliance { compliance, reach } = if usual {
            self.compliances[carrier]
        } else {
            self.pliancies[carrier].at(lambda * stiffness)
        };
        Freedom::new(compliance, t, reach / lattice.width)
    }
}
