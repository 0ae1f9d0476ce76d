//! Many codewords against one suspect: records grouped by what their bins have in common, so
//! that a suspect is read once per group and a record costs M / 8 table lookups.

use std::collections::{BTreeMap, HashMap, HashSet};

use rayon::prelude::*;

use super::detect::{Score, SoftBits, Suspect, log10_chernoff};
use super::{BitCount, Codeword, Modulation};

/// What the records of one group share: their bins and what is read from them.
type GroupKey = (BitCount, Modulation, u8);

/// Codewords side by side, one row of whole bytes each.
#[derive(Debug, Default)]
struct Group {
    ids: Vec<u128>,
    rows: Vec<u8>,
}

/// All live codewords by number of bits, modulation and lattice class. The caller chooses the
/// ids (a record's UUID).
#[derive(Debug, Default)]
pub struct CodewordIndex {
    groups: BTreeMap<GroupKey, Group>,
    key_of: HashMap<u128, GroupKey>,
}

/// A record that scores better than chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The id it was inserted with.
    pub id: u128,
    /// Decimal logarithm of the bound for this hypothesis alone, before counting.
    pub log10_bound: f64,
    /// Its score.
    pub score: Score,
}

/// The outcome of a search.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Search {
    /// Records scored; every bound must be multiplied by all hypotheses tried.
    pub hypotheses: u64,
    /// The best candidates, best first; equal bounds in order of id.
    pub candidates: Vec<Candidate>,
}

impl CodewordIndex {
    /// Adds a record; one that is already there is replaced.
    pub fn insert(&mut self, id: u128, modulation: Modulation, codeword: &Codeword) {
        self.remove(id);
        let key = (codeword.bit_count(), modulation, codeword.lattice_class());
        let group = self.groups.entry(key).or_default();
        group.ids.push(id);
        let byte = |bits: &[bool]| {
            bits.iter().enumerate().fold(0, |byte, (k, &bit)| byte | u8::from(bit) << k)
        };
        group.rows.extend(codeword.bits().chunks(8).map(byte));
        self.key_of.insert(id, key);
    }

    /// Takes a record out; says whether it was there.
    pub fn remove(&mut self, id: u128) -> bool {
        let Some(key) = self.key_of.remove(&id) else { return false };
        let Some(group) = self.groups.get_mut(&key) else { return false };
        let Some(row) = group.ids.iter().position(|&other| other == id) else { return false };
        let width = row_width(key.0);
        let last = group.ids.len() - 1;
        group.ids.swap_remove(row);
        group.rows.copy_within(last * width.., row * width);
        group.rows.truncate(last * width);
        if group.ids.is_empty() {
            self.groups.remove(&key);
        }
        true
    }

    /// How many records there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.key_of.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.key_of.is_empty()
    }

    /// Scores every record (or, when given, only those in `only`) in the suspect's frame and
    /// returns the `most` best of those that score better than chance.
    #[must_use]
    pub fn search(&self, suspect: &Suspect, only: Option<&HashSet<u128>>, most: usize) -> Search {
        let groups: Vec<_> = self.groups.iter().collect();
        let found: Vec<Search> = groups
            .into_par_iter()
            .map(|(&(bits, modulation, class), group)| {
                group.search(&suspect.read(class, bits, modulation), row_width(bits), only, most)
            })
            .collect();
        let mut all = Search::default();
        for part in found {
            all.hypotheses += part.hypotheses;
            all.candidates.extend(part.candidates);
        }
        all.candidates
            .sort_unstable_by(|a, b| a.log10_bound.total_cmp(&b.log10_bound).then(a.id.cmp(&b.id)));
        all.candidates.truncate(most);
        all
    }
}

fn row_width(bits: BitCount) -> usize {
    bits.get().div_ceil(8)
}

impl Group {
    fn search(
        &self,
        soft: &SoftBits,
        width: usize,
        only: Option<&HashSet<u128>>,
        most: usize,
    ) -> Search {
        let weights = soft.signed_weights();
        let tables: Vec<[f64; 256]> = weights.chunks(8).map(table).collect();
        // Hoeffding: the Chernoff exponent is never more than 2 ln 2 times -T^2 / 2 sum(w^2)
        // (both at full agreement), so a record whose T^2 is small need not be looked at again.
        let energy: f64 = weights.iter().map(|w| w * w).sum();
        let worth_a_look = 2.0 * energy;
        let mut found = Search::default();
        for (&id, row) in self.ids.iter().zip(self.rows.chunks_exact(width)) {
            if only.is_some_and(|only| !only.contains(&id)) {
                continue;
            }
            found.hypotheses += 1;
            let t: f64 =
                tables.iter().zip(row).map(|(table, &byte)| table[usize::from(byte)]).sum();
            if t > 0.0 && t * t >= worth_a_look {
                let score = agreement(weights, row, t);
                let log10_bound = log10_chernoff(weights, t);
                found.candidates.push(Candidate { id, log10_bound, score });
            }
        }
        let order = |a: &Candidate, b: &Candidate| {
            a.log10_bound.total_cmp(&b.log10_bound).then(a.id.cmp(&b.id))
        };
        found.candidates.sort_unstable_by(order);
        found.candidates.truncate(most);
        found
    }
}

/// The score of each of the 256 values of one byte of a codeword.
fn table(weights: &[f64]) -> [f64; 256] {
    std::array::from_fn(|byte| {
        weights.iter().enumerate().map(|(k, &w)| if byte >> k & 1 == 1 { w } else { -w }).sum()
    })
}

fn agreement(weights: &[f64], row: &[u8], t: f64) -> Score {
    let bits = row.iter().flat_map(|byte| (0..8).map(move |k| byte >> k & 1 == 1));
    let start = Score { t, bits_agreeing: 0, bits_read: 0 };
    weights.iter().zip(bits).filter(|(w, _)| **w != 0.0).fold(start, |mut score, (&w, bit)| {
        score.bits_read += 1;
        score.bits_agreeing += usize::from((w > 0.0) == bit);
        score
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;
    use crate::watermark::{MarkKey, Message};

    fn codeword(seed: u32) -> Codeword {
        let mut key = [0x5a; 32];
        key[..4].copy_from_slice(&seed.to_le_bytes());
        // 100 bits: the last byte of a row is not full.
        let bits = BitCount::new(100).unwrap();
        Codeword::new(&MarkKey::from_bytes(key), &Message::from_hex("c0ffee", bits).unwrap())
    }

    #[test]
    fn a_search_scores_each_record_as_a_direct_score_does() {
        let suspect = Suspect::new(&Sample::Blob.mesh(8000).unwrap()).unwrap();
        let mut index = CodewordIndex::default();
        for seed in 0..2000 {
            index.insert(u128::from(seed), Modulation::Mean, &codeword(seed));
        }
        let search = index.search(&suspect, None, usize::MAX);
        assert_eq!(search.hypotheses, 2000);
        assert!(!search.candidates.is_empty());
        for candidate in &search.candidates {
            let codeword = codeword(u32::try_from(candidate.id).unwrap());
            let soft =
                suspect.read(codeword.lattice_class(), codeword.bit_count(), Modulation::Mean);
            let score = soft.score(&codeword);
            assert!((score.t - candidate.score.t).abs() < 1e-9);
            assert_eq!(score.bits_agreeing, candidate.score.bits_agreeing);
            assert_eq!(score.bits_read, candidate.score.bits_read);
            assert!((soft.log10_bound(score.t) - candidate.log10_bound).abs() < 1e-6);
        }
        // An unmarked mesh: the best of 2000 records is no better than chance allows.
        let best = search.candidates[0].log10_bound + 2000_f64.log10();
        assert!(best > -2.0, "{best}");
        let only: HashSet<u128> = [3, 5, 7_000].into();
        assert_eq!(index.search(&suspect, Some(&only), 10).hypotheses, 2);
    }

    #[test]
    fn what_is_removed_is_not_found_and_what_remains_is() {
        let mut index = CodewordIndex::default();
        for seed in 0..600 {
            index.insert(u128::from(seed), Modulation::Variance, &codeword(seed));
        }
        for seed in (0..600).step_by(2) {
            assert!(index.remove(seed));
            assert!(!index.remove(seed));
        }
        index.insert(1, Modulation::Variance, &codeword(1)); // replaces itself
        assert_eq!(index.len(), 300);
        let rows: usize = index.groups.values().map(|g| g.rows.len()).sum();
        assert_eq!(rows, 300 * 13);
        for group in index.groups.values() {
            for (id, row) in group.ids.iter().zip(group.rows.chunks(13)) {
                let bits = codeword(u32::try_from(*id).unwrap());
                let byte = |bits: &[bool]| {
                    bits.iter().enumerate().fold(0, |byte, (k, &bit)| byte | u8::from(bit) << k)
                };
                assert!(bits.bits().chunks(8).map(byte).eq(row.iter().copied()));
            }
        }
    }
}
