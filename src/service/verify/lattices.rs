//! The lattice search: where the bins lie is found from the suspect alone, then every mark is
//! scored there. For files whose extremes or centre have moved.

use std::collections::BTreeMap;

use super::super::ServiceError;
use super::super::verdict::{FrameName, StageName};
use super::ladder::{Case, Stage, Tried};
use super::{Depth, go_on};
use crate::watermark::{BitCount, Effort, GroupKey, Lattices, Modulation, Worth, synchronise};

/// Kinds of marks (number of bits and modulation) that are searched for, those with most records
/// first: each costs a search of its own.
const MOST_KINDS: usize = 4;

pub(super) struct LatticeSearch {
    /// The second search of an exhaustive verification.
    pub(super) wide: bool,
}

impl LatticeSearch {
    /// Figures of `benches/blind.rs`.
    fn effort(&self, depth: Depth) -> Effort {
        match depth {
            _ if self.wide => Effort { radius: 0.04, centres: 8, lattices: 24 },
            Depth::Fast => Effort { radius: 0.002, centres: 1, lattices: 4 },
            Depth::Standard | Depth::Exhaustive => {
                Effort { radius: 0.018, centres: 2, lattices: 8 }
            }
        }
    }
}

impl Stage for LatticeSearch {
    fn name(&self) -> StageName {
        if self.wide { StageName::WideLattices } else { StageName::Lattices }
    }

    fn frame(&self) -> FrameName {
        FrameName::Searched
    }

    fn run(&self, case: &Case<'_>, worth: Worth) -> Result<Tried, ServiceError> {
        let effort = self.effort(case.depth);
        let mut lattices: BTreeMap<(BitCount, Modulation), Lattices> = BTreeMap::new();
        for (bits, modulation) in case.marks.kinds().into_iter().take(MOST_KINDS) {
            go_on(case.stop)?;
            let found = synchronise(case.suspect, bits, modulation, &effort);
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
