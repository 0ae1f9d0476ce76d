//! Which carriers are in which bin, in this round and in the round before.

use crate::mesh::stop::{STEP, Stop, go_on, mapped};
use crate::watermark::bins::BinLayout;

/// How far a carrier may stray from its bin of the round before, in bin widths.
const STRAY_TOLERANCE: f64 = 0.1;

/// Which bin each carrier belonged to in the round before.
///
/// Where norms crowd at a bin's edge, the smallest step of the centre moves many of them into the next
/// bin, and the loop never settles. A carrier therefore stays with its bin until it has strayed from it
/// by more than [`STRAY_TOLERANCE`].
#[derive(Debug, Default)]
pub struct BinMemory {
    bins: Vec<u16>,
    /// Whether the centre moved little enough for the bins of the round before to be used.
    pub trusted: bool,
}

/// The bin of a carrier outside the bin layout.
const NO_BIN: u16 = u16::MAX;

impl BinMemory {
    /// Remembers the bins of this round.
    pub fn keep(&mut self, sorted: &SortedByBin, carriers: usize) {
        self.bins.clear();
        self.bins.resize(carriers, NO_BIN);
        for bin in 0..sorted.starts.len() - 1 {
            for &carrier in &sorted.carriers[sorted.range(bin)] {
                self.bins[carrier as usize] = u16::try_from(bin).unwrap_or(NO_BIN);
            }
        }
    }

    /// The carrier's bin and its place in that bin: the bin of the round before while the carrier is
    /// near it, else its own.
    fn locate(&self, carrier: usize, rho: f64, layout: &BinLayout) -> Option<Located> {
        let own = || layout.locate(rho).map(|(bin, t)| Located { bin, t, strayed: false });
        let Some(&bin) = self.bins.get(carrier).filter(|_| self.trusted) else { return own() };
        if bin == NO_BIN {
            // The carrier was outside the bin layout and stays outside while it is near the layout's
            // ends.
            let into = (rho - layout.start) / layout.width;
            let near = into < STRAY_TOLERANCE || into > layout.bins as f64 - STRAY_TOLERANCE;
            return if near { None } else { own() };
        }
        let bin = usize::from(bin);
        let t = (rho - layout.norm_at(bin, 0.0)) / layout.width;
        if !(-STRAY_TOLERANCE..1.0 + STRAY_TOLERANCE).contains(&t) {
            return own();
        }
        let strayed = !(0.0..1.0).contains(&t);
        Some(Located { bin, t: t.clamp(0.0, 1.0 - f64::EPSILON), strayed })
    }
}

/// The bin of a carrier and its place in that bin.
#[derive(Clone, Copy)]
struct Located {
    bin: usize,
    t: f64,
    /// Whether the carrier lies beyond the bin's edge.
    strayed: bool,
}

/// Movable carriers in the bin layout, sorted by bin (a counting sort, stable by carrier).
#[derive(Debug)]
pub struct SortedByBin {
    starts: Vec<usize>,
    /// The carriers, bin after bin.
    pub carriers: Vec<u32>,
    /// Their places in their bins.
    pub places: Vec<f64>,
    /// Whether they lie beyond their bin's edge and are kept by memory alone.
    pub strayed: Vec<bool>,
}

impl SortedByBin {
    /// Sorts the carriers that are not `fixed` and lie in the bin layout; `None` once `stop` answers
    /// `true`.
    #[must_use]
    pub fn new(
        rho: &[f64],
        layout: &BinLayout,
        fixed: &[bool],
        memory: &BinMemory,
        stop: Stop<'_>,
    ) -> Option<Self> {
        let located = mapped(rho, stop, |carrier, &rho| {
            if fixed[carrier] { None } else { memory.locate(carrier, rho, layout) }
        })?;
        let mut starts = vec![0_usize; layout.bins + 1];
        for step in located.chunks(STEP) {
            go_on(stop)?;
            for located in step.iter().flatten() {
                starts[located.bin + 1] += 1;
            }
        }
        for bin in 0..layout.bins {
            starts[bin + 1] += starts[bin];
        }
        let total = starts[layout.bins];
        let (mut carriers, mut places) = (vec![0_u32; total], vec![0.0; total]);
        let mut strayed = vec![false; total];
        let mut next = starts.clone();
        let mut carrier = 0_u32;
        for step in located.chunks(STEP) {
            go_on(stop)?;
            for located in step {
                if let Some(located) = located {
                    let slot = &mut next[located.bin];
                    carriers[*slot] = carrier;
                    places[*slot] = located.t;
                    strayed[*slot] = located.strayed;
                    *slot += 1;
                }
                carrier += 1;
            }
        }
        Some(Self { starts, carriers, places, strayed })
    }

    /// The range of a bin's carriers in the arrays.
    #[must_use]
    pub fn range(&self, bin: usize) -> std::ops::Range<usize> {
        self.starts[bin]..self.starts[bin + 1]
    }

    /// Cuts arrays as long as `places` into one slice per bin.
    pub fn slices<'s>(
        &self,
        mut places: &'s mut [f64],
        mut logs: &'s mut [f64],
    ) -> Vec<BinSlice<'s>> {
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

/// The places of one bin's carriers, and scratch of the same length.
#[derive(Debug)]
pub struct BinSlice<'a> {
    /// The bin.
    pub bin: usize,
    /// Places to be changed.
    pub places: &'a mut [f64],
    /// Scratch of the same length.
    pub logs: &'a mut [f64],
}
