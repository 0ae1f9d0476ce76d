//! The false-positive bound, checked by simulation: a million random codewords against suspects of
//! every kind. The share of them that reaches a bound is never above the bound.
#![allow(clippy::unwrap_used, reason = "a test")]

mod support;

use std::sync::Arc;

use glam::DVec3;
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::relief::{ReliefHost, ReliefReading, Signs};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, CodewordIndex, Correspondence, EmbedParams, GroupKey, HostFilter,
    Hypothesis, LayoutEffort, MarkKey, Message, Method, Modulation, ReportLimits, SoftBits,
    Suspect, synchronise,
};
use rayon::prelude::*;

const CODEWORDS: u32 = 1_000_000;

/// Records with a fresh key each. The message does not matter, since it is whitened.
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
    let worth = ReportLimits { log10_bound: -2.0, most: usize::MAX };
    let search = index.search(readings, worth);
    // Layout classes differ in how many bin layouts fit them, so the count is a mean, as in a
    // verdict.
    let readings = per_record(search.hypotheses);
    assert!(readings > 0.0, "{what}: nothing was scored");
    for log10_bound in [-2.0, -2.5, -3.0, -3.5, -4.0, -5.0] {
        let reached = search.candidates.iter().filter(|c| c.log10_bound <= log10_bound).count();
        let expected = f64::from(CODEWORDS) * readings * 10_f64.powf(log10_bound);
        // Four standard deviations and some more, since the bound is about a mean.
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
    suspects
}

/// Suspects that are not generated.
fn scans() -> Vec<(String, Mesh)> {
    let folder = support::meshes("obj");
    let scan = |name: &str| {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        (name.to_owned(), Asset::read(&bytes, &Limits::default()).unwrap().into_mesh())
    };
    ["paper/bunny.obj", "cad/bracket2_16k.obj"].map(scan).into()
}

#[test]
fn no_more_codewords_reach_a_bound_than_it_says() {
    assert_all_bounded(&suspects());
}

#[test]
#[cfg_attr(not(shared_meshes), ignore = "needs the shared meshes: set QUADMARK_MESHES")]
fn nor_on_scans() {
    assert_all_bounded(&scans());
}

fn assert_all_bounded(suspects: &[(String, Mesh)]) {
    let bits = BitCount::default();
    let effort = LayoutEffort { radius: 0.002, candidates: 1, centres: 2, layouts: 5 };
    for modulation in [Modulation::Mean, Modulation::Variance] {
        let index = index(modulation);
        for (name, mesh) in suspects {
            let suspect = Suspect::new(mesh).unwrap();
            let blind = |key: GroupKey| {
                let soft = Arc::new(suspect.read(key.class, key.bits, key.modulation));
                vec![Hypothesis { frame: suspect.frame(), soft }]
            };
            assert_bounded(&format!("{name}, {modulation}, blind"), &index, &blind);
            let layouts = synchronise(&suspect, bits, modulation, &effort);
            let searched = |key: GroupKey| layouts.of_class(key.class);
            assert_bounded(&format!("{name}, {modulation}, searched"), &index, &searched);
        }
    }
}

/// Codewords of any layout class. A reading for one class is equally good for their bits.
fn codewords(count: u32) -> Vec<Codeword> {
    let message = Message::from_bytes(&[0; 8], BitCount::default()).unwrap();
    let codeword = |id: u32| {
        let mut key = [0x72; 32];
        key[..4].copy_from_slice(&id.to_le_bytes());
        Codeword::new(&MarkKey::from_bytes(key), &message)
    };
    (0..count).into_par_iter().map(codeword).collect()
}

/// Half of the bins have 1e-13 of the weight of the others, and half of those disagree. The score
/// is the whole sum but for rounding. A bin that could equally have disagreed is no evidence.
#[test]
fn agreement_counts_only_bins_that_could_have_disagreed() {
    let bits = BitCount::default().get();
    let z = |i: usize| if i.is_multiple_of(2) { 1.0 } else { 1e-13 };
    // The signs are all ones. Half of the weights are at the cap, half far below.
    let soft = SoftBits::weighted((0..bits).map(z).collect());
    let weights = soft.signed_weights();
    let total: f64 = weights.iter().sum();
    let disagreeing = (0..bits).filter(|i| i % 4 == 1);
    let t = total - disagreeing.map(|i| 2.0 * weights[i]).sum::<f64>();
    assert!(t >= total * (1.0 - 1e-12), "the score is full but for rounding");
    // The true probability: all 32 large bins agree, and at most half of the 32 small ones
    // disagree.
    let bound = soft.log10_bound(t);
    let truth = -32.0 * std::f64::consts::LOG10_2 + 0.57_f64.log10();
    assert!(bound >= truth, "{bound} {truth}");
    // A bin that agrees nearly by chance is nearly no evidence.
    let faint = SoftBits::weighted((0..bits).map(|i| if i < 40 { 1.0 } else { 1e-17 }).collect());
    let full: f64 = faint.signed_weights().iter().sum();
    let bound = faint.log10_bound(full);
    assert!((bound + 40.0 * std::f64::consts::LOG10_2).abs() < 1e-9, "{bound}");
}

/// The least score whose bound is at most `log10_bound`; `None` if none is.
fn least_score(soft: &SoftBits, log10_bound: f64) -> Option<f64> {
    let most: f64 = soft.signed_weights().iter().map(|w| w.abs()).sum();
    let (mut low, mut high) = (0.0, most);
    if soft.log10_bound(most) > log10_bound {
        return None;
    }
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if soft.log10_bound(middle) <= log10_bound { high = middle } else { low = middle }
    }
    Some(high)
}

/// Asserts that at most `10^log10_bound` of the codewords reach a bound with each reading.
fn assert_reading_bounded(what: &str, soft: &SoftBits, codewords: &[Codeword]) {
    let scores: Vec<f64> = codewords.par_iter().map(|codeword| soft.score(codeword).t).collect();
    let mut beyond = 0;
    for log10_bound in [-1.0, -2.0, -2.5, -3.0, -3.5, -4.0] {
        let Some(least) = least_score(soft, log10_bound) else { continue };
        let reached = scores.iter().filter(|t| **t >= least).count();
        let expected = codewords.len() as f64 * 10_f64.powf(log10_bound);
        let most = expected + 4.0 * expected.sqrt() + 2.0;
        assert!(reached as f64 <= most, "{what}, {log10_bound}: {reached} of at most {expected}");
        beyond = beyond.max(reached);
    }
    println!("{what}: {beyond} of {} beyond 10^-1 of one", codewords.len());
    // The bound is no better than chance allows, and not so loose that this shows nothing.
    assert!(beyond as f64 >= 1e-3 * codewords.len() as f64, "{what}: {beyond}");
}

/// A number in [-1, 1] for each vertex and axis.
fn noise(v: usize) -> DVec3 {
    let one = |k: f64| (((v as f64 + 1.0) * k).sin() * 43_758.545_3).fract();
    DVec3::new(one(12.9898), one(78.233), one(37.719))
}

/// What host frames and the matched filter read, for one record, from suspects that do not carry
/// its mark: fresh codewords for the same host and suspect.
#[test]
fn no_more_codewords_reach_a_bound_of_the_host_s_detectors_than_it_says() {
    let codewords = codewords(CODEWORDS);
    let params = EmbedParams { method: Method::ExactMean, ..EmbedParams::default() };
    for sample in [Sample::Blob, Sample::Knot] {
        let file = to_obj(&sample.mesh(12_000).unwrap());
        let read = |bytes: &[u8]| Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
        let host = read(&file);
        let copies = ["one", "two"]
            .map(|name| support::mark_named(name, &file, Method::ExactMean).unwrap().bytes);
        let [one, two] = [read(&copies[0]), read(&copies[1])];
        let again = support::mark_named("three", &copies[0], Method::ExactMean).unwrap().bytes;
        let size = host.positions().iter().map(|p| p.length()).fold(0.0, f64::max);
        let changed = |at: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
            (0..host.positions().len()).map(at).collect()
        };
        let mean = changed(&|v| one.positions()[v].midpoint(two.positions()[v]));
        let noisy = changed(&|v| one.positions()[v] + 0.003 * size * noise(v));
        let step = size / 32.0;
        let coarse = changed(&|v| (one.positions()[v] / step).round() * step);
        let suspects = [
            ("the host", host.positions().to_vec()),
            ("another's copy", one.positions().to_vec()),
            ("another's copy with noise", noisy),
            ("another's copy, quantised", coarse),
            ("the mean of two others' copies", mean),
            ("another's mark over another's", read(&again).positions().to_vec()),
        ];
        let own = HostFilter::new(&host, 77, &params).unwrap();
        let frame = Suspect::new(&host).unwrap().frame();
        for (name, positions) in suspects {
            let carriers = (0..).zip(&own.surface().first_vertex);
            let correspondences: Vec<Correspondence> = carriers
                .map(|(carrier, &v)| Correspondence { carrier, at: positions[v as usize] })
                .collect();
            let mesh = Mesh::new(positions, host.triangles().to_vec()).unwrap();
            let suspect = Suspect::new(&mesh).unwrap();
            let comparison = own.compare(&correspondences, None);
            let readings = [
                ("host frame", suspect.read_in(&frame, 77, params.bits, Modulation::Mean)),
                ("matched filter", comparison.alone()),
            ];
            for (detector, soft) in readings {
                assert_reading_bounded(&format!("{sample}, {name}, {detector}"), &soft, &codewords);
            }
        }
    }
}

/// A small host: its relief has few signs, so that a million keys are scored in seconds.
fn relief_host() -> (Surface, ReliefHost) {
    let surface = Surface::new(&Sample::Knot.mesh(500).unwrap());
    let host = ReliefHost::new(surface.clone()).unwrap();
    (surface, host)
}

#[test]
fn no_more_keys_reach_a_bound_of_the_relief_than_it_says() {
    const AMPLITUDE: f64 = 8.5e-5;
    let (surface, host) = relief_host();
    let own = Signs::new(&MarkKey::from_bytes([0x11; 32]), host.field().signs());
    let marked = host.field().marked(&surface, &own, AMPLITUDE, &[]);
    let size = host.field().diagonal();
    let rough = |share: f64| -> Vec<DVec3> {
        marked.iter().enumerate().map(|(v, p)| *p + share * size * noise(v)).collect()
    };
    let inner = surface.triangles.iter().copied().take(surface.triangles.len() / 8).collect();
    let part = Surface { triangles: inner, ..surface.clone() };
    // Bent as a whole, by long waves that no similarity explains.
    let bent =
        surface.positions.iter().map(|p| *p + 1e-3 * size * DVec3::splat((9.0 * p.x / size).sin()));
    let cases: [(&str, &Surface, Vec<DVec3>); 6] = [
        ("the host", &surface, surface.positions.clone()),
        ("another's mark", &surface, marked.clone()),
        ("with noise", &surface, rough(3e-4)),
        ("with strong noise", &surface, rough(1e-2)),
        ("a part", &part, marked.clone()),
        ("bent", &surface, bent.collect()),
    ];
    let readings: Vec<ReliefReading> = cases
        .iter()
        .map(|(_, suspect, at)| {
            ReliefReading::new(&host, suspect, at, false, AMPLITUDE, &|| false).unwrap()
        })
        .collect();
    let scores: Vec<[f64; 6]> = (0..CODEWORDS)
        .into_par_iter()
        .map(|id| {
            let mut key = [0x93; 32];
            key[..4].copy_from_slice(&id.to_le_bytes());
            let signs = Signs::new(&MarkKey::from_bytes(key), host.field().signs());
            std::array::from_fn(|case| readings[case].score(&signs))
        })
        .collect();
    for (case, (what, ..)) in cases.iter().enumerate() {
        let reading = &readings[case];
        let mut found = 0;
        for log10_bound in [-1.0, -2.0, -3.0, -4.0, -5.0] {
            // The bound falls as the score grows.
            let total: f64 = reading.signed_weights().iter().map(|z| z.abs()).sum();
            let (mut low, mut high) = (0.0, total);
            for _ in 0..40 {
                let middle = f64::midpoint(low, high);
                if reading.log10_bound(middle) > log10_bound { low = middle } else { high = middle }
            }
            assert!(reading.least_score(log10_bound).unwrap() <= high);
            let reached = scores.iter().filter(|scores| scores[case] >= high).count();
            let expected = f64::from(CODEWORDS) * 10_f64.powf(log10_bound);
            assert!(
                reached as f64 <= expected + 4.0 * expected.sqrt() + 2.0,
                "{what}, {log10_bound}: {reached} of at most {expected}"
            );
            found += reached;
        }
        println!("{what}: {found}");
        assert!(found > 100, "{what}: the bound is so loose that this shows nothing: {found}");
    }
}
