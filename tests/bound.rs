//! The false-positive bound, held against simulation: a million random codewords against suspects of
//! every kind; the share of them that reaches a bound is never above it.
#![allow(clippy::unwrap_used, reason = "a test")]

mod support;

use std::sync::Arc;

use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, CodewordIndex, Effort, GroupKey, Hypothesis, MarkKey, Message, Method,
    Modulation, Suspect, Worth, synchronise,
};
use rayon::prelude::*;

const CODEWORDS: u32 = 1_000_000;

/// Honest records: a fresh key each. (The message does not matter: it is whitened.)
fn index(modulation: Modulation) -> CodewordIndex {
    let message = Message::from_bytes(&[0; 8], BitCount::default()).unwrap();
    let mut index = CodewordIndex::default();
    let records: Vec<_> = (0..CODEWORDS)
        .into_par_iter()
        .map(|id| {
            let mut key = [0x39; 32];
            key[..4].copy_from_slice(&id.to_le_bytes());
            (u128::from(id), modulation, Codeword::new(&MarkKey::from_bytes(key), &message))
        })
        .collect();
    index.extend(records);
    index
}

/// Asserts that at most `10^log10_bound` of the records reach a bound, over all readings.
fn assert_bounded(
    what: &str,
    index: &CodewordIndex,
    readings: &(dyn Fn(GroupKey) -> Vec<Hypothesis> + Sync),
) {
    let per_record = |hypotheses: u64| hypotheses as f64 / f64::from(CODEWORDS);
    let worth = Worth { log10_bound: -2.0, most: usize::MAX };
    let search = index.search(readings, worth);
    // Classes differ in how many lattices fit them, so the count is a mean: as in a verdict.
    let readings = per_record(search.hypotheses);
    assert!(readings > 0.0, "{what}: nothing was scored");
    for log10_bound in [-2.0, -2.5, -3.0, -3.5, -4.0, -5.0] {
        let reached = search.candidates.iter().filter(|c| c.log10_bound <= log10_bound).count();
        let expected = f64::from(CODEWORDS) * readings * 10_f64.powf(log10_bound);
        // Four standard deviations and a little: the bound is about a mean.
        let most = expected + 4.0 * expected.sqrt() + 2.0;
        assert!(reached as f64 <= most, "{what}, {log10_bound}: {reached} of at most {expected}");
    }
    let found = search.candidates.len();
    println!("{what}: {readings:.1} readings a record, {found} beyond 10^-2 of one");
    // The bound is no better than chance allows, and not so loose that this shows nothing.
    assert!(found as f64 >= 1e-4 * f64::from(CODEWORDS), "{what}: {found}");
}

fn suspects() -> Vec<(String, Mesh)> {
    let read = |bytes: &[u8]| Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
    let mut suspects = Vec::new();
    for sample in [Sample::Blob, Sample::Knot] {
        let host = to_obj(&sample.mesh(12_000).unwrap());
        let marked = support::mark_named("other", &host, Method::QspMean).unwrap().bytes;
        suspects.push((format!("{sample}"), read(&host)));
        suspects.push((format!("{sample}, marked by another"), read(&marked)));
    }
    if let Some(folder) = support::meshes("obj") {
        for name in ["paper/bunny.obj", "cad/bracket2_16k.obj"] {
            suspects.push((name.to_owned(), read(&std::fs::read(folder.join(name)).unwrap())));
        }
    }
    suspects
}

#[test]
fn no_more_codewords_reach_a_bound_than_it_says() {
    let bits = BitCount::default();
    let effort = Effort { radius: 0.002, candidates: 1, centres: 2, lattices: 5 };
    for modulation in [Modulation::Mean, Modulation::Variance] {
        let index = index(modulation);
        for (name, mesh) in suspects() {
            let suspect = Suspect::new(&mesh).unwrap();
            let blind = |key: GroupKey| {
                let soft = Arc::new(suspect.read(key.class, key.bits, key.modulation));
                vec![Hypothesis { frame: suspect.frame(), soft }]
            };
            assert_bounded(&format!("{name}, {modulation}, blind"), &index, &blind);
            let lattices = synchronise(&suspect, bits, modulation, &effort);
            let searched = |key: GroupKey| lattices.of_class(key.class);
            assert_bounded(&format!("{name}, {modulation}, searched"), &index, &searched);
        }
    }
}
