//! The layout search: bin layouts are found from the suspect alone, then every mark is scored with
//! them. It is meant for files whose extremes or centre have moved.
//!
//! Not every bin layout fits every class, so the number of readings that a record is scored against
//! depends on its class. That number is not the one that is counted, because it would reveal the
//! class to whoever asks about one record. The mean number over all classes is counted instead.
//! This is sound: the key draws the class uniformly and independently of the suspect. So the
//! probability that a record, whatever its class, scores so high at any of its readings is at most
//! the mean number of readings times the probability at one reading.

use std::collections::BTreeMap;

use super::super::ServiceError;
use super::super::verdict::{FrameName, StageName};
use super::cascade::{Case, Stage, Tried};
use super::go_on;
use crate::watermark::{
    BitCount, GroupKey, LAYOUT_CLASSES, LayoutEffort, Layouts, Modulation, ReportLimits,
    synchronise_until,
};

/// Most kinds of marks (number of bits and modulation) that are searched for, those with most
/// records first. Each kind costs a search of its own.
const MOST_KINDS: usize = 4;

/// A layout search, near or far. For the attacks of `benches/blind.rs`, the true bin layout was
/// among the best three about its centre, and that centre was among the best two by energy.
pub(super) struct LayoutSearch {
    name: StageName,
    effort: LayoutEffort,
}

impl LayoutSearch {
    /// For extremes that have moved while the centre hardly has: stray vertices, smoothing.
    pub(super) const NEAR: Self = Self {
        name: StageName::LayoutSearchNear,
        effort: LayoutEffort { radius: 0.002, candidates: 3, centres: 2, layouts: 3 },
    };
    /// For a cut of 2 %, which moves the centre by up to 1.7 % of the diagonal.
    pub(super) const FULL: Self = Self {
        name: StageName::LayoutSearch,
        effort: LayoutEffort { radius: 0.018, candidates: 4, centres: 2, layouts: 4 },
    };
    /// For a cut of 5 %.
    pub(super) const WIDE: Self = Self {
        name: StageName::LayoutSearchWide,
        effort: LayoutEffort { radius: 0.04, candidates: 8, centres: 6, layouts: 8 },
    };
}

impl Stage for LayoutSearch {
    fn name(&self) -> StageName {
        self.name
    }

    fn frame(&self) -> FrameName {
        FrameName::Searched
    }

    fn run(&self, case: &Case<'_>, worth: ReportLimits) -> Result<Tried, ServiceError> {
        let mut layouts: BTreeMap<(BitCount, Modulation), Layouts> = BTreeMap::new();
        let mut counted = 0_u64;
        for ((bits, modulation), records) in case.marks.kinds().into_iter().take(MOST_KINDS) {
            go_on(case.stop)?;
            let stop = || case.stop.now();
            let found = synchronise_until(case.suspect, bits, modulation, &self.effort, &stop);
            go_on(case.stop)?;
            counted = counted.saturating_add(hypotheses(records, &found));
            layouts.insert((bits, modulation), found);
        }
        let read = |key: GroupKey| {
            let found = layouts.get(&(key.bits, key.modulation));
            found.map(|found| found.of_class(key.class)).unwrap_or_default()
        };
        let search = case.marks.search(&read, worth);
        Ok(Tried { hypotheses: counted, candidates: search.candidates })
    }
}

/// The number of hypotheses that is counted for so many records of one kind, whatever their
/// classes.
fn hypotheses(records: usize, found: &Layouts) -> u64 {
    let readings = (records as u64).saturating_mul(found.of_all_classes() as u64);
    readings.div_ceil(LAYOUT_CLASSES as u64)
}

/// The bound that is worth a report when at least so many hypotheses are counted.
pub(super) fn stricter(worth: ReportLimits, hypotheses: usize) -> ReportLimits {
    let counted = (hypotheses.max(1) as f64).log10();
    ReportLimits { log10_bound: worth.log10_bound - counted, ..worth }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use tokio_util::sync::CancellationToken;

    use super::*;
    use crate::jobs::Stop;
    use crate::keys::KeyRing;
    use crate::sample::Sample;
    use crate::watermark::{Codeword, CodewordIndex, MarkKey, Message, Suspect, synchronise};

    /// A codeword of the given class.
    fn of_class(class: u8) -> Codeword {
        let message = Message::from_bytes(&[], BitCount::default()).unwrap();
        (0..=u32::MAX)
            .map(|seed| {
                let mut key = [0x11; 32];
                key[..4].copy_from_slice(&seed.to_le_bytes());
                Codeword::new(&MarkKey::from_bytes(key), &message)
            })
            .find(|codeword| codeword.layout_class() == class)
            .unwrap()
    }

    #[test]
    fn the_number_of_hypotheses_does_not_tell_the_class() {
        let suspect = Suspect::new(&Sample::Blob.mesh(2000).unwrap()).unwrap();
        let keys = KeyRing::from_hex(&"5a".repeat(32)).unwrap();
        let stop = Stop::new(Instant::now() + Duration::from_hours(1), CancellationToken::new());
        let (bits, modulation) = (BitCount::default(), Modulation::Mean);
        let search = LayoutSearch::NEAR;
        let found = synchronise(&suspect, bits, modulation, &search.effort);
        let mut scored: Vec<usize> = (0..=u8::MAX).map(|c| found.of_class(c).len()).collect();
        let mean = scored.iter().sum::<usize>().div_ceil(LAYOUT_CLASSES) as u64;
        scored.sort_unstable();
        scored.dedup();
        assert!(scored.len() > 1, "as many bin layouts for each class: this shows nothing");
        let worth = ReportLimits { log10_bound: 0.0, most: 1 };
        for class in (0..=u8::MAX).step_by(15) {
            let mut marks = CodewordIndex::default();
            marks.insert(1, modulation, &of_class(class));
            let (marks, keys, stop) = (&marks, &keys, &stop);
            let case = Case { suspect: &suspect, marks, named: None, keys, stop };
            assert_eq!(search.run(&case, worth).unwrap().hypotheses, mean, "{class}");
        }
    }
}
