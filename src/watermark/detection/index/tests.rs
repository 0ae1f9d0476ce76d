use super::*;
use crate::sample::Sample;
use crate::watermark::{MarkKey, Message, Suspect};

const ALL: ReportLimits = ReportLimits { log10_bound: 0.0, most: usize::MAX };

fn codeword(seed: u32, bits: u32) -> Codeword {
    let mut key = [0x5a; 32];
    key[..4].copy_from_slice(&seed.to_le_bytes());
    let bits = BitCount::new(bits).unwrap();
    Codeword::new(&MarkKey::from_bytes(key), &Message::from_hex("c0ff", bits).unwrap())
}

/// An index of `count` records of 100 bits, so that the last byte of a row is not full.
fn index(count: u32, modulation: Modulation) -> CodewordIndex {
    let mut index = CodewordIndex::default();
    for seed in 0..count {
        index.insert(u128::from(seed), modulation, &codeword(seed, 100));
    }
    index
}

fn blind(suspect: &Suspect) -> impl Fn(GroupKey) -> Vec<Hypothesis> + Sync + '_ {
    |key| {
        let soft = Arc::new(suspect.read(key.class, key.bits, key.modulation));
        vec![Hypothesis { frame: suspect.frame(), soft }]
    }
}

#[test]
fn a_search_scores_each_record_as_a_direct_score_does() {
    let suspect = Suspect::new(&Sample::Blob.mesh(8000).unwrap()).unwrap();
    let index = index(2000, Modulation::Mean);
    let search = index.search(&blind(&suspect), ALL);
    assert_eq!(search.hypotheses, 2000);
    assert!(search.candidates.len() > 800, "about half of all agree better than chance");
    for candidate in &search.candidates {
        let codeword = codeword(u32::try_from(candidate.id).unwrap(), 100);
        let soft = suspect.read(codeword.layout_class(), codeword.bit_count(), Modulation::Mean);
        let score = soft.score(&codeword);
        assert_eq!(score, candidate.score);
        assert!((soft.log10_bound(score.t) - candidate.log10_bound).abs() < 1e-9);
    }
    // An unmarked mesh: the best of 2000 records is no better than chance allows.
    let best = search.candidates[0].log10_bound + 2000_f64.log10();
    assert!(best > -2.0, "{best}");
}

#[test]
fn what_is_worth_a_report_is_never_missed() {
    let suspect = Suspect::new(&Sample::Knot.mesh(6000).unwrap()).unwrap();
    // Nineteen readings: three rounds of tables, the last one not full.
    let readings = |key: GroupKey| -> Vec<Hypothesis> {
        (0..19_u8)
            .map(|k| {
                let soft = suspect.read(key.class.wrapping_add(k), key.bits, key.modulation);
                Hypothesis { frame: suspect.frame(), soft: Arc::new(soft) }
            })
            .collect()
    };
    for bits in [16, 64, 100, 256] {
        let mut index = CodewordIndex::default();
        index.extend((0..3000).map(|id| (u128::from(id), Modulation::Mean, codeword(id, bits))));
        let all = index.search(&readings, ALL);
        assert_eq!(all.hypotheses, 3000 * 19);
        for log10_bound in [-0.3, -1.0, -2.0, -3.0] {
            let some = index.search(&readings, ReportLimits { log10_bound, ..ALL });
            let worth = |c: &&Candidate| c.log10_bound <= log10_bound;
            let (ids, wanted): (Vec<_>, Vec<_>) = (
                some.candidates.iter().map(|c| c.id).collect(),
                all.candidates.iter().filter(worth).map(|c| c.id).collect(),
            );
            assert_eq!(ids, wanted, "{bits} bits, {log10_bound}");
        }
    }
}

#[test]
fn what_is_removed_is_not_found_and_what_remains_is() {
    let suspect = Suspect::new(&Sample::Blob.mesh(4000).unwrap()).unwrap();
    let key = |seed| GroupKey::of(&codeword(seed, 100), Modulation::Variance);
    let mut index = index(600, Modulation::Variance);
    let before = index.clone();
    for seed in (0..600).step_by(2) {
        assert!(index.remove(u128::from(seed), key(seed)));
        assert!(!index.remove(u128::from(seed), key(seed)));
    }
    index.insert(1, Modulation::Variance, &codeword(1, 100)); // is there
    assert_eq!((index.len(), before.len()), (300, 600), "a clone keeps what it had");
    let found = index.search(&blind(&suspect), ALL);
    assert_eq!(found.hypotheses, 300);
    let odd_before: Vec<_> = before.search(&blind(&suspect), ALL).candidates;
    let odd = odd_before.iter().filter(|c| c.id % 2 == 1).map(|c| (c.id, c.score));
    assert!(odd.eq(found.candidates.iter().map(|c| (c.id, c.score))));
    let only = before.only(&[3, 5, 598, 7_000]);
    assert_eq!(only.search(&blind(&suspect), ALL).hypotheses, 3);
    for seed in (1..600).step_by(2) {
        assert!(index.remove(u128::from(seed), key(seed)));
    }
    assert!(index.is_empty());
}

#[test]
fn records_may_come_in_any_order() {
    let suspect = Suspect::new(&Sample::Blob.mesh(4000).unwrap()).unwrap();
    let in_order = index(900, Modulation::Mean);
    let mut other = CodewordIndex::default();
    let shuffled = (0..900_u32).map(|k| k * 7 % 900);
    other.extend(shuffled.map(|id| (u128::from(id), Modulation::Mean, codeword(id, 100))));
    let scores = |index: &CodewordIndex| -> Vec<_> {
        let found = index.search(&blind(&suspect), ALL).candidates;
        found.into_iter().map(|c| (c.id, c.score)).collect()
    };
    assert_eq!(scores(&in_order), scores(&other));
    assert!(other.remove(1, GroupKey::of(&codeword(1, 100), Modulation::Mean)));
}
