//! Embedding: the single pass of the paper, and the closed loop around it (method section 5).
//!
//! Moving vertices moves the centre and with it every norm, which the blind reader computes
//! afresh; the paper ignores this and then misreads bits of its own unattacked output. The loop
//! embeds, looks at the result as the blind reader will (positions rounded as the file stores
//! them), corrects each bin's goal by its shortfall and starts again from the original mesh
//! about the new centre, until every bin reads its bit with the asked margin.

use glam::DVec3;
use rayon::prelude::*;

use super::bins::{Frame, LEAST_COUNT, Lattice, norms};
use super::extract::Reading;
use super::fixed_point::FixedPoint;
use super::placement::{PlacementSurface, radial};
use super::power_map::power_map;
use super::{Codeword, EmbedParams, Placement, WatermarkError};
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;

/// Rounds at the most. Meshes settle in two to six; those that oscillate do so within a dozen,
/// and the best round is kept.
const MAX_ROUNDS: usize = 16;

/// The loop ends when the smallest margin reaches this share of the strength.
const CLOSE_ENOUGH: f64 = 0.95;

/// A bin whose margin stays below this share of the strength counts as wrong: a conversion to
/// single precision could turn it.
const LEAST_MARGIN: f64 = 0.1;

/// Share of a bin's shortfall that is added to its goal. Undamped corrections overshoot where
/// vertices cross between bins.
const DAMPING: f64 = 0.8;

/// Goals are corrected only when the centre shifts by less than this share of a bin width:
/// before that, a shortfall says more about the centre than about the bin.
const SETTLED_SHIFT: f64 = 0.02;

/// Longest step of the search for the centre, in bin widths.
const LONGEST_STEP: f64 = 0.5;

/// Rounds whose centre shifts by more than this share of a bin width are forgotten.
const FAMILIAR_SHIFT: f64 = 0.03;

/// How far a carrier may stray from the bin of the round before, in bin widths.
const LOYALTY: f64 = 0.1;

/// In the closed loop a moved vertex keeps this share of the bin's width away from its edges,
/// so that a slight shift of the centre or a conversion cannot tip it over.
const EDGE: f64 = 0.02;

/// Bounds of a bin's goal, as multiples of the strength.
const GOAL_RANGE: (f64, f64) = (0.8, 2.5);

/// Bounds of a bin's target statistic: beyond them all its vertices stand at one edge, from
/// where the least shift of the centre tips them into the next bin.
const TARGET_RANGE: (f64, f64) = (0.04, 0.96);

/// A mesh whose norms differ by less than this share of the largest has no bins to speak of:
/// a bin of 64 would be thinner than 1.6e-5 of the object.
const LEAST_EXTENT: f64 = 1e-3;

/// Readable bins that a mark of many bits needs: 2^-40 is below the match threshold of 1e-9
/// with a thousand hypotheses counted. A mark of fewer bits needs them all.
const LEAST_USABLE_BINS: usize = 40;

/// How many bins of a mark with `bits` bits must be readable.
#[must_use]
pub fn needed_bins(bits: usize) -> usize {
    bits.min(LEAST_USABLE_BINS)
}

/// The result of an embedding.
#[derive(Debug, Clone)]
pub struct Embedding {
    /// Positions of all file vertices, as the written file reads back.
    pub positions: Vec<DVec3>,
    /// The host's own frame, before anything moved. Independent of the codeword.
    pub host_frame: Frame,
    /// What a blind reader sees in the result.
    pub reading: Reading,
    /// Passes that were made.
    pub rounds: usize,
    /// Bins that read their bit; the others have too few vertices and are erasures.
    pub usable_bins: usize,
    /// The smallest margin of the usable bins.
    pub smallest_margin: f64,
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

/// Embeds `codeword` (its length is the number of bins).
///
/// `stop` is asked between passes; when it answers `true` the work is given up.
///
/// # Errors
/// [`WatermarkError::InsufficientCapacity`] when too few bins can be made to read their bit,
/// [`WatermarkError::Cancelled`].
pub fn embed(
    host: Host<'_>,
    codeword: &Codeword,
    params: &EmbedParams,
    stop: &dyn Fn() -> bool,
) -> Result<Embedding, WatermarkError> {
    let centre = host.surface.centre();
    let host_frame = Frame::spanning(centre, &norms(&host.surface.positions, centre));
    let passes = Passes::new(host, codeword, params);
    let before = passes.read(centre, &norms(&host.surface.positions, centre));
    passes.check_capacity(host_frame, before.as_ref())?;

    let alpha = params.strength.get();
    let mut goals = vec![alpha; codeword.bits().len()];
    let width = host_frame.radial_extent() / codeword.bits().len() as f64;
    let mut search = FixedPoint::new(centre, LONGEST_STEP * width);
    let mut memory = BinMemory::default();
    let mut best: Option<Embedding> = None;
    for rounds in 1..=if params.closed_loop { MAX_ROUNDS } else { 1 } {
        if stop() {
            return Err(WatermarkError::Cancelled);
        }
        let positions = passes.run(search.at(), &goals, &mut memory)?;
        let carriers = passes.carriers_of(&positions);
        let centre = host.surface.centre_at(&carriers);
        let shift = (centre - search.at()).length() / width;
        search.learn(centre);
        memory.trusted = shift <= FAMILIAR_SHIFT;
        let reading = passes
            .read(centre, &norms(&carriers, centre))
            .ok_or(WatermarkError::NoRadialExtent { vertices: carriers.len() })?;
        let (usable_bins, wrong, smallest_margin) = passes.judge(&reading);
        if shift <= SETTLED_SHIFT {
            passes.correct(&mut goals, &reading);
        }
        if std::env::var_os("QM_DEBUG").is_some() {
            eprintln!(
                "round {rounds} usable {usable_bins} wrong {wrong} margin {smallest_margin:.5} shift/w {:.5}",
                shift
            );
        }
        let round =
            Embedding { positions, host_frame, reading, rounds, usable_bins, smallest_margin };
        let better = best.as_ref().is_none_or(|best| smallest_margin > best.smallest_margin);
        let settled = wrong == 0 && smallest_margin >= CLOSE_ENOUGH * alpha;
        if better || settled {
            best = Some(round);
        }
        if let Some(best) = best.as_mut() {
            best.rounds = rounds;
        }
        if settled {
            break;
        }
    }
    let best = best.ok_or(WatermarkError::Cancelled)?;
    if params.closed_loop {
        passes.check_result(&best)?;
    }
    Ok(best)
}

/// What all passes over one host share.
struct Passes<'a> {
    host: Host<'a>,
    codeword: &'a Codeword,
    params: &'a EmbedParams,
    placement: Option<PlacementSurface<'a>>,
    /// Per carrier, whether it cannot move.
    fixed: Vec<bool>,
}

/// The places of one bin's carriers, and scratch of the same length.
struct BinSlice<'a> {
    bin: usize,
    places: &'a mut [f64],
    logs: &'a mut [f64],
}

impl<'a> Passes<'a> {
    fn new(host: Host<'a>, codeword: &'a Codeword, params: &'a EmbedParams) -> Self {
        let placement = match params.method.placement() {
            Placement::Radial => None,
            Placement::Qsp => Some(PlacementSurface::new(host.surface)),
        };
        let carriers = host.surface.positions.len();
        let mut fixed = vec![false; carriers];
        for &vertex in host.pinned {
            let carrier = host.surface.carrier_of.get(vertex as usize);
            if let Some(fixed) = carrier.and_then(|&c| fixed.get_mut(c as usize)) {
                *fixed = true;
            }
        }
        Self { host, codeword, params, placement, fixed }
    }

    fn read(&self, centre: DVec3, norms: &[f64]) -> Option<Reading> {
        let frame = Frame::spanning(centre, norms);
        let (class, bits) = (self.codeword.lattice_class(), self.codeword.bit_count());
        Reading::in_frame(frame, norms, class, bits, self.params.method.modulation())
    }

    /// One pass from the original mesh, about `centre`: modulate, place, round.
    fn run(
        &self,
        centre: DVec3,
        goals: &[f64],
        memory: &mut BinMemory,
    ) -> Result<Vec<DVec3>, WatermarkError> {
        let surface = self.host.surface;
        let rho = norms(&surface.positions, centre);
        let frame = Frame::spanning(centre, &rho);
        let bits = self.codeword.bit_count();
        let lattice = Lattice::new(&frame, self.codeword.lattice_class(), bits)
            .ok_or(WatermarkError::NoRadialExtent { vertices: rho.len() })?;
        let new_rho = self.modulate(&rho, &lattice, goals, memory);
        let place = |carrier: usize, v: DVec3| {
            let (rho, new_rho) = (rho[carrier], new_rho[carrier]);
            if rho.to_bits() == new_rho.to_bits() {
                return v;
            }
            match &self.placement {
                None => radial(centre, v, rho, new_rho),
                Some(placement) => placement.qsp(centre, carrier, rho, new_rho),
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
        memory: &mut BinMemory,
    ) -> Vec<f64> {
        let sorted = SortedByBin::new(rho, lattice, &self.fixed, memory);
        if self.params.closed_loop {
            memory.keep(&sorted, rho.len());
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
                let sum: f64 =
                    slice.places.iter().map(|&t| super::bins::contribution(modulation, t)).sum();
                let deviation = sum / count - neutral;
                let already = if bit { deviation >= goal } else { deviation <= goal };
                if slice.places.is_empty() || (already && self.params.closed_loop) {
                    return false;
                }
                let (low, high) = TARGET_RANGE;
                let target = (neutral + goal).clamp(low, high);
                power_map(modulation, slice.places, slice.logs, target);
                true
            })
            .collect();
        let edge = if self.params.closed_loop { EDGE } else { 0.0 };
        let mut new_rho = rho.to_vec();
        for bin in 0..lattice.bins {
            for k in sorted.range(bin) {
                let (t, carrier) = (places[k], sorted.carriers[k] as usize);
                if moved[bin] || t != sorted.places[k] || sorted.strayed[k] {
                    new_rho[carrier] = lattice.norm_at(bin, t.clamp(edge, 1.0 - edge));
                }
            }
        }
        new_rho
    }

    fn carriers_of(&self, positions: &[DVec3]) -> Vec<DVec3> {
        self.host.surface.first_vertex.par_iter().map(|&v| positions[v as usize]).collect()
    }

    /// Bins that read their bit, bins that do not, and the smallest margin of all that are read.
    fn judge(&self, reading: &Reading) -> (usize, usize, f64) {
        let least = LEAST_MARGIN * self.params.strength.get();
        let margins = self.codeword.bits().iter().enumerate();
        margins.filter_map(|(bin, &bit)| reading.margin(bin, bit)).fold(
            (0, 0, f64::INFINITY),
            |(right, wrong, smallest), margin| {
                let reads = margin >= least;
                (right + usize::from(reads), wrong + usize::from(!reads), smallest.min(margin))
            },
        )
    }

    fn correct(&self, goals: &mut [f64], reading: &Reading) {
        let alpha = self.params.strength.get();
        let (least, most) = GOAL_RANGE;
        for (bin, (goal, &bit)) in goals.iter_mut().zip(self.codeword.bits()).enumerate() {
            if let Some(margin) = reading.margin(bin, bit) {
                let corrected = *goal + DAMPING * (alpha - margin);
                *goal = corrected.clamp(least * alpha, most * alpha);
            }
        }
    }

    fn check_capacity(
        &self,
        frame: Frame,
        reading: Option<&Reading>,
    ) -> Result<(), WatermarkError> {
        let thin = frame.radial_extent() <= LEAST_EXTENT * frame.rho_max;
        let usable = reading.filter(|_| !thin).map_or(0, |reading| {
            reading.statistics.iter().filter(|s| s.count >= LEAST_COUNT).count()
        });
        let reason = if thin {
            "its vertices are all at nearly the same distance from its centre"
        } else {
            "a bin needs at least 4 vertices"
        };
        self.require(usable, reading, reason)
    }

    fn check_result(&self, result: &Embedding) -> Result<(), WatermarkError> {
        let (right, wrong, _) = self.judge(&result.reading);
        if wrong > 0 {
            let reason = "the vertices of some bins cannot be moved far enough";
            return Err(self.insufficient(right, right + wrong, Some(&result.reading), reason));
        }
        self.require(right, Some(&result.reading), "a bin needs at least 4 vertices")
    }

    fn require(
        &self,
        usable: usize,
        reading: Option<&Reading>,
        reason: &'static str,
    ) -> Result<(), WatermarkError> {
        let needed = needed_bins(self.codeword.bits().len());
        if usable >= needed {
            return Ok(());
        }
        Err(self.insufficient(usable, needed, reading, reason))
    }

    fn insufficient(
        &self,
        usable: usize,
        needed: usize,
        reading: Option<&Reading>,
        reason: &'static str,
    ) -> WatermarkError {
        WatermarkError::InsufficientCapacity {
            usable,
            needed,
            bits: self.codeword.bits().len(),
            vertices: self.host.surface.positions.len(),
            in_bins: reading.map_or(0, Reading::vertices_in_bins),
            least_count: reading.map_or(0, Reading::least_count),
            reason,
        }
    }
}

/// Which bin each carrier belonged to in the round before.
///
/// Where norms crowd at a bin's edge, the least step of the centre tips many of them into the
/// next bin and the loop never settles. A carrier therefore stays with its bin until it has
/// strayed from it by more than [`LOYALTY`].
#[derive(Default)]
struct BinMemory {
    bins: Vec<u16>,
    /// Whether the centre was near enough for the round before to be worth remembering.
    trusted: bool,
}

/// A carrier outside the lattice.
const NO_BIN: u16 = u16::MAX;

impl BinMemory {
    fn keep(&mut self, sorted: &SortedByBin, carriers: usize) {
        self.bins.clear();
        self.bins.resize(carriers, NO_BIN);
        for bin in 0..sorted.starts.len() - 1 {
            for &carrier in &sorted.carriers[sorted.range(bin)] {
                self.bins[carrier as usize] = u16::try_from(bin).unwrap_or(NO_BIN);
            }
        }
    }

    /// The carrier's bin and place: the remembered bin while it is near, else its own.
    fn locate(&self, carrier: usize, rho: f64, lattice: &Lattice) -> Option<Located> {
        let own = || lattice.locate(rho).map(|(bin, t)| Located { bin, t, strayed: false });
        let Some(&bin) = self.bins.get(carrier).filter(|_| self.trusted) else { return own() };
        if bin == NO_BIN {
            // Outside the lattice, and near it.
            let into = (rho - lattice.start) / lattice.width;
            let near = into < LOYALTY || into > lattice.bins as f64 - LOYALTY;
            return if near { None } else { own() };
        }
        let bin = usize::from(bin);
        let t = (rho - lattice.norm_at(bin, 0.0)) / lattice.width;
        if !(-LOYALTY..1.0 + LOYALTY).contains(&t) {
            return own();
        }
        let strayed = !(0.0..1.0).contains(&t);
        Some(Located { bin, t: t.clamp(0.0, 1.0 - f64::EPSILON), strayed })
    }
}

/// Where a carrier is.
#[derive(Clone, Copy)]
struct Located {
    bin: usize,
    t: f64,
    /// It really lies beyond the bin's edge.
    strayed: bool,
}

/// Movable carriers in the lattice, sorted by bin (a counting sort, stable by carrier).
struct SortedByBin {
    starts: Vec<usize>,
    carriers: Vec<u32>,
    places: Vec<f64>,
    strayed: Vec<bool>,
}

impl SortedByBin {
    fn new(rho: &[f64], lattice: &Lattice, fixed: &[bool], memory: &BinMemory) -> Self {
        let located: Vec<Option<Located>> = rho
            .par_iter()
            .zip(fixed)
            .enumerate()
            .with_min_len(16_384)
            .map(
                |(carrier, (&rho, &fixed))| {
                    if fixed { None } else { memory.locate(carrier, rho, lattice) }
                },
            )
            .collect();
        let mut starts = vec![0_usize; lattice.bins + 1];
        for located in located.iter().flatten() {
            starts[located.bin + 1] += 1;
        }
        for bin in 0..lattice.bins {
            starts[bin + 1] += starts[bin];
        }
        let total = starts[lattice.bins];
        let (mut carriers, mut places) = (vec![0_u32; total], vec![0.0; total]);
        let mut strayed = vec![false; total];
        let mut next = starts.clone();
        for (carrier, located) in (0_u32..).zip(located) {
            if let Some(located) = located {
                let slot = &mut next[located.bin];
                carriers[*slot] = carrier;
                places[*slot] = located.t;
                strayed[*slot] = located.strayed;
                *slot += 1;
            }
        }
        Self { starts, carriers, places, strayed }
    }

    fn range(&self, bin: usize) -> std::ops::Range<usize> {
        self.starts[bin]..self.starts[bin + 1]
    }

    /// Cuts scratch arrays of the length of all places into one slice per bin.
    fn slices<'s>(&self, mut places: &'s mut [f64], mut logs: &'s mut [f64]) -> Vec<BinSlice<'s>> {
        let mut slices = Vec::with_capacity(self.starts.len());
        for bin in 0..self.starts.len() - 1 {
            let range = self.range(bin);
            let (these_places, other_places) = places.split_at_mut(range.len());
            let (these_logs, other_logs) = logs.split_at_mut(range.len());
            (places, logs) = (other_places, other_logs);
            slices.push(BinSlice { bin, places: these_places, logs: these_logs });
        }
        slices
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;
    use crate::watermark::{BitCount, MarkKey, Message, Method, Strength, extract};

    /// Single precision, as glTF stores positions.
    #[expect(clippy::cast_possible_truncation)]
    fn to_single(positions: &mut [DVec3]) {
        for p in positions {
            *p = DVec3::from_array(p.to_array().map(|x| f64::from(x as f32)));
        }
    }

    fn message(bits: BitCount) -> Message {
        Message::from_bits((0..bits.get()).map(|i| i * i % 7 < 3).collect()).unwrap()
    }

    fn single(sample: Sample, vertices: u32) -> Mesh {
        let mesh = sample.mesh(vertices).unwrap();
        let mut positions = mesh.positions().to_vec();
        to_single(&mut positions);
        Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
    }

    fn embedded(
        mesh: &Mesh,
        key: &MarkKey,
        params: &EmbedParams,
    ) -> Result<Embedding, WatermarkError> {
        let surface = Surface::new(mesh);
        let host = Host { mesh, surface: &surface, pinned: &[], round: &to_single };
        embed(host, &Codeword::new(key, &message(params.bits)), params, &|| false)
    }

    #[test]
    fn every_method_reads_back_blindly_on_every_shape() {
        for sample in Sample::ALL {
            let mesh = single(sample, 12_000);
            for method in Method::ALL {
                for (bits, alpha) in [(16, 0.05), (64, 0.1), (128, 0.15)] {
                    let bits = BitCount::new(bits).unwrap();
                    let strength = Strength::new(alpha).unwrap();
                    let params = EmbedParams { method, strength, bits, closed_loop: true };
                    let key = MarkKey::from_bytes([bits.get() as u8; 32]);
                    let result = embedded(&mesh, &key, &params)
                        .unwrap_or_else(|e| panic!("{sample} {method} {bits}: {e}"));
                    let marked = Mesh::new(result.positions, mesh.triangles().to_vec()).unwrap();
                    let found = extract(&marked, &key, bits, method.modulation()).unwrap();
                    for (read, meant) in found.bits.iter().zip(message(bits).bits()) {
                        assert!(read.is_none_or(|b| b == *meant), "{sample} {method} {bits}");
                    }
                    assert!(found.bits.iter().flatten().count() >= result.usable_bins);
                }
            }
        }
    }

    #[test]
    fn the_result_is_the_same_on_one_and_on_many_threads() {
        let mesh = single(Sample::Blob, 20_000);
        let key = MarkKey::from_bytes([9; 32]);
        let params = EmbedParams::default();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| embedded(&mesh, &key, &params)).unwrap().positions
        };
        assert_eq!(run(1), run(2));
        assert_eq!(run(2), run(5));
    }

    #[test]
    fn what_cannot_carry_is_refused_with_the_counts() {
        let sphere = {
            let blob = single(Sample::Blob, 12_000);
            let round = blob.positions().iter().map(|p| p.normalize()).collect();
            Mesh::new(round, blob.triangles().to_vec()).unwrap()
        };
        let corner =
            |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
        let cube = Mesh::new(
            (0..8).map(corner).collect(),
            vec![[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5], [2, 3, 7]],
        )
        .unwrap();
        for (name, mesh) in
            [("sphere", sphere), ("cube", cube), ("small", single(Sample::Knot, 200))]
        {
            for method in Method::ALL {
                let params = EmbedParams { method, ..EmbedParams::default() };
                let refused = embedded(&mesh, &MarkKey::from_bytes([1; 32]), &params).unwrap_err();
                assert!(
                    matches!(refused, WatermarkError::InsufficientCapacity { needed: 40, .. }),
                    "{name}: {refused}"
                );
            }
        }
    }

    #[test]
    fn pinned_vertices_and_their_seam_copies_stay() {
        let mesh = single(Sample::Blob, 12_000);
        let surface = Surface::new(&mesh);
        let pinned: Vec<u32> = (0..500).collect();
        let host = Host { mesh: &mesh, surface: &surface, pinned: &pinned, round: &to_single };
        let params = EmbedParams::default();
        let codeword = Codeword::new(&MarkKey::from_bytes([3; 32]), &message(params.bits));
        let result = embed(host, &codeword, &params, &|| false).unwrap();
        assert_eq!(result.positions[..500], mesh.positions()[..500]);
        assert_ne!(result.positions, mesh.positions());
    }

    #[test]
    fn a_stop_is_heard() {
        let mesh = single(Sample::Blob, 12_000);
        let surface = Surface::new(&mesh);
        let host = Host { mesh: &mesh, surface: &surface, pinned: &[], round: &to_single };
        let params = EmbedParams::default();
        let codeword = Codeword::new(&MarkKey::from_bytes([3; 32]), &message(params.bits));
        assert_eq!(
            embed(host, &codeword, &params, &|| true).unwrap_err(),
            WatermarkError::Cancelled
        );
    }
}
