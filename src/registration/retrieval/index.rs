//! An index of many sketches in memory. It finds the records that a suspect resembles.

use std::collections::{BTreeSet, HashMap};

use rayon::prelude::*;

use super::descriptor::ShapeDescriptor;
use super::sketch::{Probe, Sketch};

/// New postings wait in a tree until they are merged into the sorted list, which reads all of the
/// list. A merge is due when more than `LEAST_WAITING` wait, and more than one per `WAITING_SHARE`
/// postings of the list.
const LEAST_WAITING: usize = 1 << 16;
const WAITING_SHARE: usize = 64;

/// Postings read per query, at most: bounds the time for hashes that very many records share.
const MOST_READ: usize = 1 << 22;

/// Descriptors per task.
const BLOCK: usize = 1 << 14;

/// A record and how much it has in common with a suspect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The id it was inserted with.
    pub id: u128,
    /// Number of hashes that it has in common with the suspect.
    pub hits: u32,
    /// Weight of these hashes in nats. A hash weighs more the fewer records have it.
    pub weight: f64,
}

/// A record and how far its descriptor is from the suspect's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Likeness {
    /// The id it was inserted with.
    pub id: u128,
    /// Distance of the descriptors, 0 at best.
    pub distance: u32,
}

/// Sketches by their hashes and descriptors. A record takes about 1.7 KB, of which 1.5 KB are
/// postings; a million records take 1.7 GB.
#[derive(Debug, Default)]
pub struct GeometryIndex {
    ids: Vec<u128>,
    outlines: Vec<ShapeDescriptor>,
    dead: Vec<bool>,
    free: Vec<u32>,
    slot_of: HashMap<u128, u32>,
    /// The upper half of a posting is half of a hash, the lower half a slot. Sorted.
    postings: Vec<u64>,
    waiting: BTreeSet<u64>,
    live: usize,
}

impl GeometryIndex {
    /// Adds a record; one that is already there is replaced.
    pub fn insert(&mut self, id: u128, sketch: &Sketch) {
        self.remove(id);
        let Some(slot) = self.place(id, sketch) else { return };
        self.waiting.extend(sketch.hashes().iter().map(|&hash| posting(hash, slot)));
        if self.waiting.len() > LEAST_WAITING.max(self.postings.len() / WAITING_SHARE) {
            let waiting = std::mem::take(&mut self.waiting);
            self.merge(waiting.into_iter().collect());
        }
    }

    /// Adds many records at once, as at a start; faster than [`Self::insert`] one by one.
    pub fn extend<'a>(&mut self, records: impl Iterator<Item = (u128, &'a Sketch)>) {
        let mut fresh: Vec<u64> = std::mem::take(&mut self.waiting).into_iter().collect();
        for (id, sketch) in records {
            self.remove(id);
            if let Some(slot) = self.place(id, sketch) {
                fresh.extend(sketch.hashes().iter().map(|&hash| posting(hash, slot)));
            }
        }
        fresh.par_sort_unstable();
        self.merge(fresh);
    }

    /// Takes a slot for a record. `None` once all 2^32 are taken.
    fn place(&mut self, id: u128, sketch: &Sketch) -> Option<u32> {
        let slot = match self.free.pop() {
            Some(slot) => slot,
            None => u32::try_from(self.ids.len()).ok()?,
        };
        let index = slot as usize;
        if index == self.ids.len() {
            self.ids.push(id);
            self.outlines.push(*sketch.outline());
            self.dead.push(false);
        } else {
            self.ids[index] = id;
            self.outlines[index] = *sketch.outline();
            self.dead[index] = false;
        }
        self.slot_of.insert(id, slot);
        self.live += 1;
        Some(slot)
    }

    /// Removes a record; returns whether it was there. Its postings are dropped by the next merge.
    pub fn remove(&mut self, id: u128) -> bool {
        let Some(slot) = self.slot_of.remove(&id) else { return false };
        self.dead[slot as usize] = true;
        self.live -= 1;
        true
    }

    /// Merges sorted postings in, drops those of removed records and frees their slots.
    fn merge(&mut self, fresh: Vec<u64>) {
        let dead = &self.dead;
        let lives = |posting: &u64| !dead[slot(*posting) as usize];
        let mut old = std::mem::take(&mut self.postings).into_iter().filter(lives).peekable();
        let mut fresh = fresh.into_iter().filter(lives).peekable();
        let mut merged = Vec::with_capacity(old.size_hint().1.unwrap_or(0));
        while let (Some(a), Some(b)) = (old.peek(), fresh.peek()) {
            merged.extend(if a <= b { old.next() } else { fresh.next() });
        }
        merged.extend(old);
        merged.extend(fresh);
        self.postings = merged;
        let slots = (0_u32..).zip(&self.dead).filter(|(_, dead)| **dead).map(|(slot, _)| slot);
        self.free = slots.collect();
    }

    /// How many records there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.live
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.live == 0
    }

    /// The `most` records that have the most in common with the suspect, best first.
    #[must_use]
    pub fn by_parts(&self, probe: &Probe, most: usize) -> Vec<Hit> {
        let mut found: Vec<(u32, f64)> = Vec::new();
        let mut read = 0;
        for &hash in &probe.hashes {
            let begin = found.len();
            let range = posting(hash, 0)..=posting(hash, u32::MAX);
            let from = self.postings.partition_point(|p| p < range.start());
            let sorted = self.postings[from..].iter().take_while(|p| *p <= range.end());
            let both = sorted.chain(self.waiting.range(range.clone()));
            let left = MOST_READ - read;
            let slots = both.map(|&p| slot(p)).take(left);
            found.extend(
                slots.inspect(|_| read += 1).filter(|&s| !self.dead[s as usize]).map(|s| (s, 0.0)),
            );
            let sharing = (found.len() - begin) as f64;
            let weight = libm::log(1.0 + self.live as f64 / sharing);
            found[begin..].iter_mut().for_each(|(_, w)| *w = weight);
        }
        // A stable sort, so that weights are added in the order of the hashes.
        found.sort_by_key(|&(slot, _)| slot);
        let hit = |same: &[(u32, f64)]| {
            let id = self.ids[same.first()?.0 as usize];
            let hits = u32::try_from(same.len()).unwrap_or(u32::MAX);
            Some(Hit { id, hits, weight: same.iter().map(|(_, w)| w).sum() })
        };
        let mut hits: Vec<Hit> = found.chunk_by(|a, b| a.0 == b.0).filter_map(hit).collect();
        hits.sort_unstable_by(|a, b| b.weight.total_cmp(&a.weight).then(a.id.cmp(&b.id)));
        hits.truncate(most);
        hits
    }

    /// The `most` records whose descriptors are nearest to the suspect's, best first.
    #[must_use]
    pub fn by_descriptor(&self, probe: &Probe, most: usize) -> Vec<Likeness> {
        let nearest = |all: &mut Vec<Likeness>| {
            all.sort_unstable_by_key(|l| (l.distance, l.id));
            all.truncate(most);
        };
        let block = |slots: std::ops::Range<usize>| {
            let mut best = Vec::new();
            let mut worst = u32::MAX;
            for slot in slots {
                let distance = self.outlines[slot].distance(&probe.outline);
                if distance <= worst && !self.dead[slot] {
                    best.push(Likeness { id: self.ids[slot], distance });
                    if best.len() >= 2 * most.max(64) {
                        nearest(&mut best);
                        worst = best.last().map_or(0, |l| l.distance);
                    }
                }
            }
            nearest(&mut best);
            best
        };
        let count = self.ids.len();
        let mut all: Vec<Likeness> = (0..count.div_ceil(BLOCK))
            .into_par_iter()
            .flat_map_iter(|k| block(k * BLOCK..((k + 1) * BLOCK).min(count)))
            .collect();
        nearest(&mut all);
        all
    }
}

/// Half of a hash suffices: with the 10^8 postings of a million records, 1 in 40 probes meets a
/// wrong one.
fn posting(hash: u64, slot: u32) -> u64 {
    // A sketch keeps the smallest hashes, so only their lower halves are evenly spread.
    hash << 32 | u64::from(slot)
}

fn slot(posting: u64) -> u32 {
    let [a, b, c, d, ..] = posting.to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::by_vertices::signatures::mix;
    use crate::registration::retrieval::descriptor::BYTES;

    fn sketch(record: u64) -> Sketch {
        let hashes = (0..100).map(|k| mix(1000 * record + k, 9) >> 8).collect();
        let bytes = mix(record, 11).to_le_bytes();
        Sketch::from_parts(hashes, ShapeDescriptor(std::array::from_fn(|i| bytes[i % 8])))
    }

    fn probe(record: u64, hashes: usize) -> Probe {
        let sketch = sketch(record);
        Probe { hashes: sketch.hashes()[..hashes].to_vec(), outline: *sketch.outline() }
    }

    #[test]
    fn a_few_hashes_find_their_record_wherever_its_postings_are() {
        let mut index = GeometryIndex::default();
        let sketches: Vec<Sketch> = (0..2000).map(sketch).collect();
        index.extend((0..).zip(&sketches).take(1000));
        for (id, sketch) in (0..).zip(&sketches).skip(1000) {
            index.insert(id, sketch);
        }
        assert_eq!(index.len(), 2000);
        for record in [0, 999, 1000, 1999] {
            let hits = index.by_parts(&probe(record, 5), 3);
            assert_eq!((hits[0].id, hits[0].hits), (u128::from(record), 5));
            assert_eq!(index.by_descriptor(&probe(record, 5), 1)[0].distance, 0);
            assert_eq!(index.by_descriptor(&probe(record, 5), 1)[0].id, u128::from(record));
        }
        assert!(index.by_parts(&probe(5000, 100), 3).is_empty());
    }

    #[test]
    fn removed_records_are_gone_and_their_slots_used_again() {
        let mut index = GeometryIndex::default();
        for id in 0..10 {
            index.insert(u128::from(id), &sketch(id));
        }
        assert!(index.remove(3) && !index.remove(3));
        index.insert(4, &sketch(40));
        assert_eq!(index.len(), 9);
        assert!(index.by_parts(&probe(3, 100), 5).is_empty());
        assert!(index.by_parts(&probe(4, 100), 5).is_empty());
        assert_eq!(index.by_parts(&probe(40, 100), 5)[0].id, 4);
        index.extend(std::iter::empty());
        index.insert(77, &sketch(77));
        assert_eq!(index.ids.len(), 11);
        assert_eq!(index.by_parts(&probe(77, 100), 5)[0].hits, 100);
        assert!(index.by_parts(&probe(3, 100), 5).is_empty());
        assert!(index.by_descriptor(&probe(3, 1), 20).iter().all(|l| l.id != 3));
    }

    #[test]
    fn a_hash_that_many_records_share_is_worth_less() {
        let mut index = GeometryIndex::default();
        let outline = ShapeDescriptor([0; BYTES]);
        for id in 0..50_u64 {
            let own = (0..3).map(|k| mix(id, k + 100));
            index.insert(id.into(), &Sketch::from_parts(own.chain(0..20).collect(), outline));
        }
        index.insert(99, &Sketch::from_parts((0..10).collect(), outline));
        let hashes: Vec<u64> = (0..10).chain((0..3).map(|k| mix(7, k + 100))).collect();
        let hits = index.by_parts(&Probe { hashes, outline }, 100);
        assert_eq!((hits[0].id, hits[0].hits, hits.len()), (7, 13, 51));
    }
}
