//! The lattice search: where the bins lie is found from the suspect alone, then every mark is
//! scored there. For files whose extremes or centre have moved.

use std::collections::BTreeMap;

use super::super::ServiceError;
use super::super::verdict::{FrameName, StageName};
use super::go_on;
use super::ladder::{Case, Stage, Tried};
use crate::watermark::{
    BitCount, Effort, GroupKey, Lattices, Modulation, Worth, synchronise_until,
};

/// Kinds of marks (number of bits and modulation) that are searched for, those with most records
/// first: each costs a search of its own.
const MOST_KINDS: usize = 4;

/// A lattice search, near or far. Over the attacks of `benches/blind.rs` the true lattice was among
/// the best three about its centre, and that centre among the best two by energy.
pub(super) struct LatticeSearch {
    name: StageName,
    effort: Effort,
}

impl LatticeSearch {
    /// For extremes that have moved and centres that hardly have: stray vertices, smoothing.
    pub(super) const NEAR: Self = Self {
        name: StageName::NearLattices,
        effort: Effort { radius: 0.002, candidates: 3, centres: 2, lattices: 3 },
    };
    /// For a cut of 2 %, which moves the centre by up to 1.7 % of the diagonal.
    pub(super) const FULL: Self = Self {
        name: StageName::Lattices,
        effort: Effort { radius: 0.018, candidates: 4, centres: 2, lattices: 4 },
    };
    /// For a cut of 5 %.
    pub(super) const WIDE: Self = Self {
        name: StageName::WideLattices,
        effort: Effort { radius: 0.04, candidates: 8, centres: 6, lattices: 8 },
    };
}

impl Stage for LatticeSearch {
    fn name(&self) -> StageName {
        self.name
    }

    fn frame(&self) -> FrameName {
        FrameName::Searched
    }

    fn run(&self, case: &Case<'_>, worth: Worth) -> Result<Tried, ServiceError> {
        let mut lattices: BTreeMap<(BitCount, Modulation), Lattices> = BTreeMap::new();
        for (bits, modulation) in case.marks.kinds().into_iter().take(MOST_KINDS) {
            go_on(case.stop)?;
            let stop = || case.stop.now();
            let found = synchronise_until(case.suspect, bits, modulation, &self.effort, &stop);
            go_on(case.stop)?;
            lattices.insert((bits, modulation), found);
        }
        let read = |key: GroupKey| {
            let found = lattices.get(&(key.bits, key.modulation));
            found.map(|found| found.of_class(key.class)).unwrap_or_default()
        };
        let search = case.marks.search(&read, worth);
        Ok(Tried { hypotheses: search.hypotheses, candidates: search.candidates })
    }
}

/// What is worth a report when at least so many hypotheses are counted.
pub(super) fn stricter(worth: Worth, hypotheses: usize) -> Worth {
    let counted = (hypotheses.max(1) as f64).log10();
    Worth { log10_bound: worth.log10_bound - counted, ..worth }
}
