//! Which norm each vertex gets: the bins of one pass and their targets.

use rayon::prelude::*;

use super::allocation::{Allocation, MoveLimits};
use super::budget::margins;
use super::compliance::ComplianceData;
use super::guard::Stiffness;
use super::power_map::power_map;
use super::sorted::{BinMemory, BinSlice, SortedByBin};
use crate::mesh::stop::{Stop, go_on, mapped};
use crate::watermark::bins::{BinLayout, contribution};
use crate::watermark::{Codeword, EmbedParams, Shaping};

/// In the closed loop a moved vertex keeps this share of the bin's width away from the bin's edges, so
/// that a slight shift of the centre or a conversion cannot tip the vertex over.
const EDGE: f64 = 0.02;

/// Bounds of a bin's target statistic. Beyond them all vertices of the bin stand at one edge, where the
/// smallest shift of the centre tips them into the next bin.
const TARGET_RANGE: (f64, f64) = (0.04, 0.96);

/// State that an embedding keeps from round to round.
#[derive(Debug, Default)]
pub struct State {
    /// Which bin each carrier was in.
    pub memory: BinMemory,
    /// Per bin, what is added to its requested margin because earlier rounds fell short of it.
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

/// New norms, and the margins they are to give.
#[derive(Debug)]
pub struct Modulated {
    /// Per carrier its new norm.
    pub norms: Vec<f64>,
    /// Per bin the requested margin.
    pub wanted: Vec<f64>,
}

/// What all passes of one embedding share.
#[derive(Debug)]
pub struct Modulator<'a> {
    /// The bits that the bins are to carry.
    pub codeword: &'a Codeword,
    /// Strength and method.
    pub params: &'a EmbedParams,
    /// Per carrier, whether it cannot move.
    pub fixed: Vec<bool>,
    /// For the allocation: per carrier, what its compliance is computed from, and the usual compliance.
    pub compliance_data: Vec<ComplianceData>,
    compliances: Vec<f64>,
}

impl<'a> Modulator<'a> {
    /// A modulator of carriers, some of them `fixed`. `compliance_data` may be empty where no allocation is
    /// made. `None` once `stop` answers `true`.
    #[must_use]
    pub fn new(
        codeword: &'a Codeword,
        params: &'a EmbedParams,
        fixed: Vec<bool>,
        compliance_data: Vec<ComplianceData>,
        stop: Stop<'_>,
    ) -> Option<Self> {
        let compliances = mapped(&compliance_data, stop, |_, data| data.at(1.0))?;
        Some(Self { codeword, params, fixed, compliance_data, compliances })
    }

    /// New norms: each bin's statistic is moved to its goal on the side of its bit. In the closed
    /// loop a bin that is already beyond its goal on the right side is left alone. `None` once `stop`
    /// answers `true`.
    #[must_use]
    pub fn modulate(
        &self,
        rho: &[f64],
        layout: &BinLayout,
        state: &mut State,
        stop: Stop<'_>,
    ) -> Option<Modulated> {
        let sorted = SortedByBin::new(rho, layout, &self.fixed, &state.memory, stop)?;
        if self.params.closed_loop {
            state.memory.keep(&sorted, rho.len());
        }
        let strength = self.params.strength.get();
        let (move_limits, wanted) = match self.params.method.shaping() {
            Shaping::PowerMap => (Vec::new(), vec![strength; layout.bins]),
            Shaping::Allocation => {
                let move_limits = self.move_limits(&sorted, &state.stiffness, stop)?;
                let bins = (0..layout.bins).map(|bin| self.allocation(&sorted, &move_limits, bin));
                let bins: Vec<_> = bins.collect();
                let wanted = margins(&bins, self.codeword.bits(), strength, stop);
                (move_limits, wanted)
            }
        };
        go_on(stop)?;
        let (mut places, mut logs) = (sorted.places.clone(), vec![0.0; sorted.places.len()]);
        let moved: Vec<bool> = sorted
            .slices(&mut places, &mut logs)
            .into_par_iter()
            .with_max_len(1)
            .map(|slice| {
                let correction = state.corrections.get(slice.bin).copied().unwrap_or(0.0);
                let goal = wanted[slice.bin] + correction;
                let Some(target) = self.target(&slice, goal) else { return false };
                match self.params.method.shaping() {
                    Shaping::PowerMap => {
                        let modulation = self.params.method.modulation();
                        power_map(modulation, slice.places, slice.logs, target, stop);
                    }
                    Shaping::Allocation => {
                        let problem = self.allocation(&sorted, &move_limits, slice.bin);
                        let solution = problem.solve(target, stop);
                        problem.apply(solution.multiplier, slice.places);
                    }
                }
                true
            })
            .collect();
        go_on(stop)?;
        let norms = self.new_norms(rho, layout, &sorted, &places, &moved);
        Some(Modulated { norms, wanted })
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

    #[expect(clippy::float_cmp, reason = "a place that was not touched is the same to the bit")]
    fn new_norms(
        &self,
        rho: &[f64],
        layout: &BinLayout,
        sorted: &SortedByBin,
        places: &[f64],
        moved: &[bool],
    ) -> Vec<f64> {
        let edge = if self.params.closed_loop { EDGE } else { 0.0 };
        let power_map = self.params.method.shaping() == Shaping::PowerMap;
        let mut new_rho = rho.to_vec();
        for (bin, &moved) in moved.iter().enumerate() {
            for k in sorted.range(bin) {
                let (t, strayed) = (places[k], sorted.strayed[k]);
                if strayed || (moved && (power_map || t != sorted.places[k])) {
                    // The ranges of the allocation stay clear of the edges.
                    let keep = if power_map || strayed { edge } else { 0.0 };
                    let place = t.clamp(keep, 1.0 - keep);
                    new_rho[sorted.carriers[k] as usize] = layout.norm_at(bin, place);
                }
            }
        }
        new_rho
    }

    /// The limits of the move of each sorted carrier.
    fn move_limits(
        &self,
        sorted: &SortedByBin,
        stiffness: &Stiffness,
        stop: Stop<'_>,
    ) -> Option<Vec<MoveLimits>> {
        mapped(&sorted.carriers, stop, |place, &carrier| {
            let carrier = carrier as usize;
            let factor = stiffness.of(carrier);
            let stiffened = factor > 1.0;
            let compliance = if stiffened {
                self.compliance_data[carrier].at(factor)
            } else {
                self.compliances[carrier]
            };
            MoveLimits::new(compliance, sorted.places[place])
        })
    }

    fn allocation<'s>(
        &self,
        sorted: &'s SortedByBin,
        move_limits: &'s [MoveLimits],
        bin: usize,
    ) -> Allocation<'s> {
        let range = sorted.range(bin);
        let modulation = self.params.method.modulation();
        Allocation {
            modulation,
            places: &sorted.places[range.clone()],
            move_limits: &move_limits[range],
        }
    }
}
