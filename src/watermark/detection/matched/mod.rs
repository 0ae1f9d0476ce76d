//! The matched filter: reads a suspect whose vertices still are the host's (method section 7).
//!
//! Bins use the distance of a vertex from the centre; this filter uses its displacement from its
//! position in the host. From the host and a mark key follow the displacements for a codeword of ones,
//! `d1`, and of zeros, `d0`, whatever the record's own codeword is. A carrier `j` of bin `i` stands at
//! `host + m + c_i Delta / 2 + noise`, with `m = (d1 + d0) / 2`, `Delta = d1 - d0` and `c_i` the
//! codeword's sign. Per bin, all information is in the correlation of the residual with `Delta`.
//!
//! A smoothed suspect stands at `S(host + m + sum_i c_i Delta_i / 2)`, with the linear smoothing `S`
//! and the part `Delta_i` of `Delta` in bin `i`: neighbouring bins run into each other. The least
//! squares estimate of `c` separates them. With `T_i = S Delta_i`, it solves `G c = t` for
//! `t_i = <r, T_i>` and `G_ik = <T_i, T_k>`. By the adjoint, `<r, S Delta_i> = <S* r, Delta_i>`, so one
//! smoothing serves all bins.
//!
//! Module `cells` reads a suspect on a coarse grid from the cells that its vertices fell into.
//!
//! Nothing here may depend on the codeword (I4). Must not know how suspects are brought into the host's
//! coordinates, or how correspondences are found.

mod cells;
mod comparison;
mod estimate;
mod grid;
mod nudge;
mod smoothing;
mod smoothing_search;

use glam::{DQuat, DVec3};

pub use comparison::Comparison;
use grid::Grid;
use smoothing::{LAMBDA, Smoothing};

use crate::mesh::Mesh;
use crate::mesh::powers::squared;
use crate::mesh::stop::{STEP, Stop, go_on, mapped};
use crate::mesh::surface::Surface;
use crate::watermark::bins::{BinLayout, Frame, norms};
use crate::watermark::embedding::modulate::State;
use crate::watermark::embedding::pass::{Host, Passes};
use crate::watermark::{BitCount, Codeword, EmbedParams, SoftBits, WatermarkError};

/// A carrier of the host, and where the suspect has it, in the host's coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Index of the carrier.
    pub carrier: u32,
    /// Its position in the suspect, in the host's coordinates.
    pub at: DVec3,
}

/// The bin of a carrier outside the bin layout.
const NO_BIN: u16 = u16::MAX;

/// Passes for each of the two codewords, all ones and all zeros. The second pass knows which vertices
/// the guard stiffens.
const PASSES: usize = 2;

/// Largest number of residuals that judge a number of rounds.
const JUDGES: usize = 20_000;

/// Standard deviations of the kernel of `S* S` beyond which the kernel is taken to reach no bin. What
/// is neglected falls on other bins, and the estimate amplifies it. Measured on exact-mean marks
/// smoothed 10 and 20 times in place (log10 of the bound for one record): -1 to -9 with 1.8, -17.5 to
/// -19.3 with 3, and from 5 on the -19.3 of the full matrix.
const KERNEL: f64 = 4.0;

/// The knee of Cauchy's weights, as a multiple of the median of a Rayleigh-like residual. Any constant
/// near one serves, because the constant moves only this knee.
const KNEE: f64 = 2.0;

/// What is expected of the carriers of a host under one layout class.
#[derive(Debug, Clone)]
pub struct HostFilter {
    surface: Surface,
    smoothing: Smoothing,
    bits: BitCount,
    /// Root mean square difference of the norms at the ends of an edge, in bin widths.
    stride: f64,
    /// Per carrier its bin in the host's own frame.
    bins: Vec<u16>,
    /// Per carrier its position half-way between a zero and a one.
    middle: Vec<DVec3>,
    /// Per carrier the vector from its position for a zero to that for a one.
    difference: Vec<DVec3>,
}

impl HostFilter {
    /// The filter of marks with these parameters on the `host`, for the layout class of their key.
    ///
    /// # Errors
    /// [`WatermarkError::NoRadialExtent`].
    pub fn new(host: &Mesh, class: u8, params: &EmbedParams) -> Result<Self, WatermarkError> {
        Self::new_until(host, class, params, &|| false)
    }

    /// As [`Self::new`], calling `stop` between passes.
    ///
    /// # Errors
    /// Also [`WatermarkError::Cancelled`].
    pub fn new_until(
        host: &Mesh,
        class: u8,
        params: &EmbedParams,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, WatermarkError> {
        let cancelled = WatermarkError::Cancelled;
        let surface = Surface::new_until(host, stop).ok_or(cancelled.clone())?;
        let centre = surface.centre_until(stop).ok_or(cancelled.clone())?;
        let rho = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &rho);
        let layout = BinLayout::new(&frame, class, params.bits)
            .ok_or(WatermarkError::NoRadialExtent { vertices: rho.len() })?;
        let seen =
            Host { mesh: host, surface: &surface, pinned: &[], round: &|_| {}, original: None };
        let [zeros, ones] = [false, true].map(|bit| {
            let codeword = Codeword::uniform(class, params.bits, bit);
            let passes = Passes::new(seen, &codeword, params, stop);
            let passes = passes.ok_or(WatermarkError::Cancelled)?;
            let mut state = State::new(params.bits.get());
            let mut positions = Vec::new();
            for _ in 0..PASSES {
                positions = passes.run(centre, &mut state, stop)?.positions;
            }
            passes.carriers_of(&positions, stop).ok_or(WatermarkError::Cancelled)
        });
        let (zeros, ones): (Vec<DVec3>, Vec<DVec3>) = (zeros?, ones?);
        let bin = |&rho: &f64| {
            layout.locate(rho).and_then(|(bin, _)| u16::try_from(bin).ok()).unwrap_or(NO_BIN)
        };
        let mut squares = 0.0;
        for step in surface.triangles.chunks(STEP) {
            go_on(stop).ok_or(cancelled.clone())?;
            let edges = step.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
            let off = edges.map(|[a, b]| squared(rho[a as usize] - rho[b as usize]));
            squares = off.fold(squares, |sum, square| sum + square);
        }
        let squares = squares / (3.0 * surface.triangles.len() as f64);
        let smoothing = Smoothing::new_until(&surface, stop).ok_or(cancelled)?;
        let of = |at: &dyn Fn(usize, &DVec3) -> DVec3| -> Result<Vec<DVec3>, WatermarkError> {
            let mut all = Vec::with_capacity(zeros.len());
            for (step, zeros) in zeros.chunks(STEP).enumerate() {
                go_on(stop).ok_or(WatermarkError::Cancelled)?;
                all.extend((step * STEP..).zip(zeros).map(|(carrier, zero)| at(carrier, zero)));
            }
            Ok(all)
        };
        let middle = of(&|carrier, zero| zero.midpoint(ones[carrier]))?;
        let difference = of(&|carrier, zero| ones[carrier] - *zero)?;
        go_on(stop).ok_or(WatermarkError::Cancelled)?;
        Ok(Self {
            bits: params.bits,
            stride: squares.sqrt() / layout.width,
            bins: rho.iter().map(bin).collect(),
            middle,
            difference,
            smoothing,
            surface,
        })
    }

    fn smoothing(&self) -> &Smoothing {
        &self.smoothing
    }

    /// The host's carriers.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Approximate size in memory, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        const CARRIER: usize = 3 * size_of::<DVec3>() + size_of::<u16>() + size_of::<u32>();
        const TRIANGLE: usize = 3 * size_of::<u32>();
        self.surface.positions.len() * CARRIER
            + self.surface.triangles.len() * TRIANGLE
            + self.surface.carrier_of.len() * size_of::<u32>()
            + self.smoothing.bytes()
    }

    /// A suspect compared with this filter. `turned` is the rotation of the similarity that brought the
    /// suspect to the host, `None` when the suspect was in place. The similarity turned the suspect's
    /// grid too, if there is one, and its scale may be wrong by the shrinkage of smoothing.
    #[must_use]
    pub fn compare(&self, correspondences: &[Correspondence], turned: Option<DQuat>) -> Comparison {
        self.compare_until(correspondences, turned, &|| false)
    }

    /// As [`Self::compare`], calling `stop` before each number of rounds of smoothing that is tried.
    /// The result must be discarded once `stop` answers `true`.
    #[must_use]
    pub fn compare_until(
        &self,
        correspondences: &[Correspondence],
        turned: Option<DQuat>,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Comparison {
        Comparison::new(self, correspondences, turned, stop)
    }

    /// Soft bits of a suspect in place, and the estimated number of rounds of smoothing it went
    /// through.
    #[must_use]
    pub fn read(&self, correspondences: &[Correspondence]) -> (SoftBits, usize) {
        let comparison = self.compare(correspondences, None);
        (comparison.alone(), comparison.rounds())
    }

    /// The least distance of two bins, in bins, at which smoothing does not mix them.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn apart(&self, rounds: usize) -> usize {
        // Each round of `S` and each of `S*` adds the variance of one step with probability one half.
        let reach = KERNEL * self.stride * (2.0 * LAMBDA * rounds as f64).sqrt();
        let bins = self.bits.get();
        (2.0 * reach.ceil() + 1.0).clamp(1.0, bins as f64) as usize
    }

    /// Cauchy's weights: a wrong correspondence or a vertex that was torn away hardly counts. `None`
    /// once `stop` answers `true`.
    fn weights(
        &self,
        correspondences: &[Correspondence],
        rounds: usize,
        middle: &[DVec3],
        stop: Stop<'_>,
    ) -> Option<Vec<f64>> {
        let off = |_, s: &Correspondence| {
            let carrier = s.carrier as usize;
            let rest = s.at - middle[carrier];
            if rounds > 0 {
                return rest.length();
            }
            // The smaller of the residuals that a one and a zero would leave.
            let half = 0.5 * self.difference[carrier];
            (rest - half).length_squared().min((rest + half).length_squared()).sqrt()
        };
        let off = mapped(correspondences, stop, off)?;
        let knee = KNEE * median(off.clone());
        let weight = |off: f64| if knee > 0.0 { 1.0 / (1.0 + squared(off / knee)) } else { 1.0 };
        go_on(stop)?;
        Some(off.into_iter().map(weight).collect())
    }

    /// `<field, Delta_i>` for each bin.
    fn along(&self, field: &[DVec3]) -> Vec<f64> {
        let mut along = vec![0.0; self.bits.get()];
        for ((field, difference), &bin) in field.iter().zip(&self.difference).zip(&self.bins) {
            if let Some(along) = along.get_mut(usize::from(bin)) {
                *along += field.dot(*difference);
            }
        }
        along
    }

    /// `G`, row by row. One smoothing serves all bins that are too far from each other to mix: every
    /// `classes`-th bin. The result must be discarded once `stop` answers `true`.
    fn gram(&self, seen: &[f64], rounds: usize, classes: usize, stop: Stop<'_>) -> Vec<f64> {
        let bins = self.bits.get();
        let mut gram = vec![0.0; bins * bins];
        for class in (0..classes).take_while(|_| !stop()) {
            let inside = |bin: u16| bin != NO_BIN && usize::from(bin) % classes == class;
            let part = self.difference.iter().zip(&self.bins);
            let part = part.map(|(&d, &bin)| if inside(bin) { d } else { DVec3::ZERO });
            let mut spread = self.smoothing().smoothed_until(part.collect(), rounds, stop);
            spread.iter_mut().zip(seen).for_each(|(spread, seen)| *spread *= *seen);
            let back = self.smoothing().adjoint_until(spread, rounds, stop);
            if stop() {
                break;
            }
            for ((back, difference), &bin) in back.iter().zip(&self.difference).zip(&self.bins) {
                if bin == NO_BIN {
                    continue;
                }
                // The nearest bin of the class.
                let bin = usize::from(bin);
                let above = (class + classes - bin % classes) % classes;
                let source = if 2 * above <= classes {
                    bin + above
                } else {
                    (bin + above).wrapping_sub(classes)
                };
                if source < bins {
                    gram[source * bins + bin] += back.dot(*difference);
                }
            }
        }
        gram
    }
}

/// The grid that a suspect was put on, either before `turned` or in its present coordinates.
fn grid_of(correspondences: &[Correspondence], turned: DQuat, stop: Stop<'_>) -> Option<Grid> {
    let along = |axes| Grid::of(&correspondences.iter().map(|s| s.at), axes, stop);
    along(DVec3::AXES.map(|axis| turned * axis)).or_else(|| along(DVec3::AXES))
}

fn median(mut all: Vec<f64>) -> f64 {
    let middle = all.len() / 2;
    if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::estimate::LEAST_RIDGE;
    use super::*;
    use crate::mesh::stop::never;
    use crate::sample::Sample;
    use crate::watermark::{Embedding, MarkKey, Message, Method, embed};

    pub(super) struct Marked {
        pub(super) host: Mesh,
        pub(super) codeword: Codeword,
        pub(super) params: EmbedParams,
        pub(super) positions: Vec<DVec3>,
    }

    pub(super) fn marked(sample: Sample, method: Method) -> Marked {
        let host = sample.mesh(12_000).unwrap();
        let surface = Surface::new(&host);
        let params = EmbedParams { method, ..EmbedParams::default() };
        let message = Message::from_bits((0..64).map(|i| i * i % 7 < 3).collect()).unwrap();
        let codeword = Codeword::new(&MarkKey::from_bytes([5; 32]), &message);
        let seen =
            Host { mesh: &host, surface: &surface, pinned: &[], round: &|_| {}, original: None };
        let Embedding { positions, .. } = embed(seen, &codeword, &params, &|| false).unwrap();
        Marked { host, codeword, params, positions }
    }

    pub(super) fn bound(
        marked: &Marked,
        at: impl Fn(usize, DVec3) -> Option<DVec3>,
    ) -> (f64, usize) {
        let class = marked.codeword.layout_class();
        let filter = HostFilter::new(&marked.host, class, &marked.params).unwrap();
        let correspondences: Vec<Correspondence> = (0_u32..)
            .zip(&filter.surface().first_vertex)
            .filter_map(|(carrier, &v)| {
                let at = at(v as usize, marked.positions[v as usize])?;
                Some(Correspondence { carrier, at })
            })
            .collect();
        let (soft, rounds) = filter.read(&correspondences);
        (soft.log10_bound(soft.score(&marked.codeword).t), rounds)
    }

    #[test]
    fn bins_that_share_a_smoothing_do_not_meet() {
        for sample in Sample::ALL {
            let Marked { host, codeword, params, .. } = marked(sample, Method::ExactMean);
            let filter = HostFilter::new(&host, codeword.layout_class(), &params).unwrap();
            let seen = vec![1.0; filter.bins.len()];
            let (n, rounds) = (params.bits.get(), 5);
            let whole = filter.gram(&seen, rounds, n, &never);
            let shared = filter.gram(&seen, rounds, filter.apart(rounds), &never);
            for i in 0..n {
                for k in 0..n {
                    let size = (whole[i * n + i] * whole[k * n + k]).sqrt();
                    let off = (whole[i * n + k] - shared[i * n + k]).abs();
                    assert!(off <= LEAST_RIDGE * size, "{sample} {i} {k}: {off} of {size}");
                }
            }
        }
    }

    /// Noise in [-1, 1], different for each vertex and axis.
    fn noise(v: usize) -> DVec3 {
        let one = |k: f64| (((v as f64 + 1.0) * k).sin() * 43_758.545_3).fract();
        DVec3::new(one(12.9898), one(78.233), one(37.719))
    }

    #[test]
    fn a_mark_is_read_through_noise_outliers_and_from_a_fragment() {
        for method in Method::ALL {
            let marked = marked(Sample::Blob, method);
            let size = marked.positions.iter().map(|p| p.length()).fold(0.0, f64::max);
            let (clean, rounds) = bound(&marked, |_, at| Some(at));
            assert!(clean < -17.0 && rounds == 0, "{method}: {clean} {rounds}");
            let noisy = bound(&marked, |v, at| Some(at + 0.005 * size * noise(v))).0;
            assert!(noisy < -8.0, "{method}, noise: {noisy}");
            let torn =
                bound(&marked, |v, at| Some(if v % 4 == 0 { at + size * noise(v) } else { at })).0;
            assert!(torn < -15.0, "{method}, a quarter elsewhere: {torn}");
            let fragment = bound(&marked, |_, at| (at.x > 0.2 * size).then_some(at)).0;
            assert!(fragment < -8.0, "{method}, fragment: {fragment}");
        }
    }

    #[test]
    fn a_smoothed_mark_is_read_with_the_host_smoothed_alike() {
        let marked = marked(Sample::Knot, Method::ExactMean);
        let class = marked.codeword.layout_class();
        let filter = HostFilter::new(&marked.host, class, &marked.params).unwrap();
        let mut field: Vec<DVec3> =
            filter.surface().first_vertex.iter().map(|&v| marked.positions[v as usize]).collect();
        field = filter.smoothing().smoothed_until(field, 10, &crate::mesh::stop::never);
        let correspondences = |field: &[DVec3]| -> Vec<Correspondence> {
            (0..).zip(field).map(|(carrier, &at)| Correspondence { carrier, at }).collect()
        };
        let (soft, rounds) = filter.read(&correspondences(&field));
        assert_eq!(rounds, 10);
        let alike = soft.log10_bound(soft.score(&marked.codeword).t);
        let unlike =
            Comparison::after(&filter, &correspondences(&field), 0, &filter.middle, &never).alone();
        let unlike = unlike.log10_bound(unlike.score(&marked.codeword).t);
        let stride = filter.stride;
        assert!(alike < -5.0 && alike < unlike - 2.0, "{alike} {unlike} {stride}");
    }

    #[test]
    fn the_unmarked_host_and_another_mark_say_nothing() {
        let marked = marked(Sample::Blob, Method::ExactMean);
        let host = bound(&marked, |v, _| Some(marked.host.positions()[v])).0;
        assert!(host > -4.0, "{host}");
        let nothing = bound(&marked, |_, _| None);
        assert_eq!(nothing, (0.0, 0));
    }
}
