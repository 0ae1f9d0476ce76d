//! Scores many codewords against one suspect.
//!
//! Records are grouped by what their bins have in common, so that a suspect is read once per group. A
//! record is a row of M / 8 bytes and a 16-byte id, and costs M / 8 table lookups for eight readings at
//! once. Ids are kept in order, so a record is found by bisection, without a map. Must not know how
//! readings are chosen, only that their choice does not depend on codewords.

mod tables;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rayon::prelude::*;

use crate::watermark::bins::Frame;
use crate::watermark::{BitCount, Codeword, Modulation, Score, SoftBits, Tail};
use tables::{LANES, Tables};

/// What the records of one group share: their bins and the statistic read from them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GroupKey {
    /// Number of bins.
    pub bits: BitCount,
    /// Which statistic.
    pub modulation: Modulation,
    /// The layout class: where the bins lie.
    pub class: u8,
}

impl GroupKey {
    /// The group of a codeword.
    #[must_use]
    pub fn of(codeword: &Codeword, modulation: Modulation) -> Self {
        Self { bits: codeword.bit_count(), modulation, class: codeword.layout_class() }
    }

    fn row_width(self) -> usize {
        self.bits.get().div_ceil(8)
    }
}

/// Codewords side by side, one row of whole bytes each, in the order of their ids.
#[derive(Debug, Default, Clone)]
struct Group {
    ids: Vec<u128>,
    rows: Vec<u8>,
}

/// All live codewords by number of bits, modulation and layout class. The caller chooses the ids, which
/// are the UUIDs of records.
///
/// A clone shares the rows. A search works on a clone, so that records can be inserted and removed
/// meanwhile. Such a change copies its group, a 256th of the whole.
#[derive(Debug, Default, Clone)]
pub struct CodewordIndex {
    groups: BTreeMap<GroupKey, Arc<Group>>,
}

/// One reading of a suspect in one bin layout, against which the records of a group are scored.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// The assumed centre and radial range.
    pub frame: Frame,
    /// The soft bits that were read.
    pub soft: Arc<SoftBits>,
}

/// A record that scores better than chance.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The id it was inserted with.
    pub id: u128,
    /// Decimal logarithm of the bound for this hypothesis alone, before hypotheses are counted.
    pub log10_bound: f64,
    /// Its score.
    pub score: Score,
    /// The reading that it was scored against.
    pub hypothesis: Hypothesis,
}

/// The outcome of a search.
#[derive(Debug, Clone, Default)]
pub struct Search {
    /// Number of readings times records scored. Every bound must be multiplied by the number of all
    /// hypotheses tried.
    pub hypotheses: u64,
    /// The best candidates, best first, each record once; equal bounds in order of id.
    pub candidates: Vec<Candidate>,
}

/// Which candidates of a search are reported.
#[derive(Debug, Clone, Copy)]
pub struct ReportLimits {
    /// Candidates whose bound, before hypotheses are counted, is above this are not reported.
    pub log10_bound: f64,
    /// Largest number of candidates.
    pub most: usize,
}

impl CodewordIndex {
    /// Adds a record, at most once.
    pub fn insert(&mut self, id: u128, modulation: Modulation, codeword: &Codeword) {
        let key = GroupKey::of(codeword, modulation);
        let group = Arc::make_mut(self.groups.entry(key).or_default());
        // Ids are drawn in the order of time, so the position is at the end or near it.
        if let Err(at) = group.ids.binary_search(&id) {
            let width = key.row_width();
            group.ids.insert(at, id);
            group.rows.splice(at * width..at * width, row(codeword));
        }
    }

    /// Adds many records, in any order. None of them may be in the index already.
    pub fn extend(&mut self, records: impl IntoIterator<Item = (u128, Modulation, Codeword)>) {
        let mut unsorted = BTreeSet::new();
        for (id, modulation, codeword) in records {
            let key = GroupKey::of(&codeword, modulation);
            let group = Arc::make_mut(self.groups.entry(key).or_default());
            if group.ids.last().is_some_and(|&last| last > id) {
                unsorted.insert(key);
            }
            group.ids.push(id);
            group.rows.extend(row(&codeword));
        }
        for key in unsorted {
            if let Some(group) = self.groups.get_mut(&key) {
                Arc::make_mut(group).sort(key.row_width());
            }
        }
    }

    /// Removes a record from its group and returns whether it was there.
    pub fn remove(&mut self, id: u128, key: GroupKey) -> bool {
        let Some(group) = self.groups.get_mut(&key) else { return false };
        let Ok(at) = group.ids.binary_search(&id) else { return false };
        let group = Arc::make_mut(group);
        let width = key.row_width();
        group.ids.remove(at);
        group.rows.drain(at * width..(at + 1) * width);
        if group.ids.is_empty() {
            self.groups.remove(&key);
        }
        true
    }

    /// The records among `ids` (ascending), as an index of their own.
    #[must_use]
    pub fn only(&self, ids: &[u128]) -> Self {
        let chosen = |(&key, group): (&GroupKey, &Arc<Group>)| {
            let chosen = group.only(ids, key.row_width());
            (!chosen.ids.is_empty()).then(|| (key, Arc::new(chosen)))
        };
        Self { groups: self.groups.par_iter().filter_map(chosen).collect() }
    }

    /// All ids, ascending.
    #[must_use]
    pub fn ids(&self) -> Vec<u128> {
        let mut ids: Vec<u128> =
            self.groups.values().flat_map(|group| &group.ids).copied().collect();
        ids.sort_unstable();
        ids
    }

    /// Number of records.
    #[must_use]
    pub fn len(&self) -> usize {
        self.groups.values().map(|group| group.ids.len()).sum()
    }

    /// Whether there are no records.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// The kinds of marks (number of bits and modulation) and how many records are of each, those with
    /// most records first.
    #[must_use]
    pub fn kinds(&self) -> Vec<((BitCount, Modulation), usize)> {
        let mut sizes: BTreeMap<_, usize> = BTreeMap::new();
        for (key, group) in &self.groups {
            *sizes.entry((key.bits, key.modulation)).or_default() += group.ids.len();
        }
        let mut kinds: Vec<_> = sizes.into_iter().collect();
        kinds.sort_by_key(|&(kind, size)| (std::cmp::Reverse(size), kind));
        kinds
    }

    /// Scores every record against every reading of its group and returns the best of those that
    /// `worth` admits.
    #[must_use]
    pub fn search(
        &self,
        readings: &(dyn Fn(GroupKey) -> Vec<Hypothesis> + Sync),
        worth: ReportLimits,
    ) -> Search {
        let groups: Vec<_> = self.groups.iter().collect();
        let found: Vec<Search> = groups
            .into_par_iter()
            .with_max_len(1)
            .map(|(&key, group)| group.search(&readings(key), key.row_width(), worth))
            .collect();
        let mut all = Search::default();
        for part in found {
            all.hypotheses += part.hypotheses;
            all.candidates.extend(part.candidates);
        }
        best_first(&mut all.candidates, worth.most);
        all
    }
}

/// Sorts by bound and keeps the `most` best.
fn best_first(candidates: &mut Vec<Candidate>, most: usize) {
    candidates.sort_by(|a, b| a.log10_bound.total_cmp(&b.log10_bound).then(a.id.cmp(&b.id)));
    candidates.truncate(most);
}

/// The bytes of a codeword, the first bin in the lowest bit.
fn row(codeword: &Codeword) -> impl Iterator<Item = u8> + '_ {
    let byte = |bits: &[bool]| {
        bits.iter().enumerate().fold(0, |byte, (k, &bit)| byte | u8::from(bit) << k)
    };
    codeword.bits().chunks(8).map(byte)
}

/// The bits of a row, followed by zeros up to a whole byte.
fn bits_of(row: &[u8]) -> impl Iterator<Item = bool> + '_ {
    row.iter().flat_map(|byte| (0..8).map(move |k| byte >> k & 1 == 1))
}

impl Group {
    fn row(&self, at: usize, width: usize) -> &[u8] {
        self.rows.get(at * width..(at + 1) * width).unwrap_or_default()
    }

    fn sort(&mut self, width: usize) {
        let mut order: Vec<usize> = (0..self.ids.len()).collect();
        order.sort_unstable_by_key(|&at| self.ids[at]);
        *self = self.at(order.into_iter(), width);
    }

    fn only(&self, ids: &[u128], width: usize) -> Self {
        self.at(ids.iter().filter_map(|id| self.ids.binary_search(id).ok()), width)
    }

    fn at(&self, places: impl Iterator<Item = usize>, width: usize) -> Self {
        let mut chosen = Self::default();
        for at in places {
            chosen.ids.push(self.ids[at]);
            chosen.rows.extend_from_slice(self.row(at, width));
        }
        chosen
    }

    fn search(&self, readings: &[Hypothesis], width: usize, worth: ReportLimits) -> Search {
        let mut candidates: Vec<Candidate> = Vec::new();
        for readings in readings.chunks(LANES) {
            let soft = readings.iter().map(|reading| &*reading.soft);
            let Some(tables) = Tables::new(soft, worth.log10_bound) else { continue };
            let rows = self.rows.chunks_exact(width).zip(&self.ids);
            let mut tails: Vec<Option<Tail>> = vec![None; readings.len()];
            for (row, &id) in rows.filter(|(row, _)| tables.may_reach(row)) {
                let scored = readings.iter().zip(&mut tails);
                let scored = scored.map(|(reading, tail)| {
                    reading.score(id, row, tail.get_or_insert_with(|| reading.soft.tail()))
                });
                let best = scored.min_by(|a, b| a.log10_bound.total_cmp(&b.log10_bound));
                let worthwhile =
                    |c: &Candidate| c.log10_bound < 0.0 && c.log10_bound <= worth.log10_bound;
                candidates.extend(best.filter(worthwhile));
            }
            // Bounds the memory that candidates take.
            if candidates.len() / 2 > worth.most.max(1 << 12) {
                once_each(&mut candidates);
                best_first(&mut candidates, worth.most);
            }
        }
        once_each(&mut candidates);
        best_first(&mut candidates, worth.most);
        Search { hypotheses: (self.ids.len() * readings.len()) as u64, candidates }
    }
}

/// Keeps the best candidate of each record.
fn once_each(candidates: &mut Vec<Candidate>) {
    candidates.sort_by(|a, b| a.id.cmp(&b.id).then(a.log10_bound.total_cmp(&b.log10_bound)));
    candidates.dedup_by_key(|candidate| candidate.id);
}

impl Hypothesis {
    fn score(&self, id: u128, row: &[u8], tail: &mut Tail) -> Candidate {
        let score = self.soft.score_bits(bits_of(row));
        let log10_bound = tail.log10_at(score.t);
        Candidate { id, log10_bound, score, hypothesis: self.clone() }
    }
}

#[cfg(test)]
mod tests;
