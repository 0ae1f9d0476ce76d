//! Marks outlive versions: what a key means, and what an embedding writes, bit for bit.
//!
//! `tests/golden/vectors.json` is refreshed with `QUADMARK_UPDATE_GOLDEN=1`, and a change there is
//! a change of the scheme that needs a new scheme version. `tests/golden/marked_v1.obj` is never
//! refreshed: it was made once with
//!
//! ```text
//! quadmark sample blob --vertices 2400 -o host.obj
//! quadmark embed host.obj -o marked_v1.obj --bits 32 --message c0ffee42 --key 000102...1f
//! ```
//!
//! and every later release must still read it.
//!
//! If a case is about vertex positions, its value is a hash of positions, not of a file's text.
#![allow(clippy::unwrap_used, reason = "test helpers")]

use std::path::{Path, PathBuf};

use std::sync::Arc;

use quadmark::formats::{Asset, Format, Limits};
use quadmark::marking::{
    Amplitude, Layers, MarkRequest, Marked, MaxDistortion, extract_file, mark, mark_within,
};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::relief::{ReliefHost, ReliefReading, Signs};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, CodewordIndex, Correspondence, EmbedParams, Embedding, GroupKey, Host,
    HostFilter, Hypothesis, LayoutEffort, MarkKey, Message, Method, Modulation, ReportLimits,
    Schedule, Strength, Suspect, embed, synchronise,
};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn keys() -> [(&'static str, MarkKey); 3] {
    [
        ("zeros", MarkKey::from_bytes([0; 32])),
        ("counting", MarkKey::from_bytes(counting())),
        ("sha256 of quadmark", MarkKey::from_bytes(Sha256::digest(b"quadmark").into())),
    ]
}

fn counting() -> [u8; 32] {
    std::array::from_fn(|i| u8::try_from(i).unwrap())
}

fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

fn schedules() -> Value {
    let mut cases = Vec::new();
    for (name, key) in keys() {
        for bits in [16, 64, 256] {
            let schedule = Schedule::new(&key, BitCount::new(bits).unwrap());
            // Bin numbers are below 256: one byte each.
            let bins: Vec<u8> =
                schedule.bin_of_bit.iter().map(|&bin| u8::try_from(bin).unwrap()).collect();
            let whitening: Vec<u8> = schedule.whitening.iter().map(|&bit| u8::from(bit)).collect();
            let mut case = json!({
                "key": name,
                "bits": bits,
                "layout_class": schedule.layout_class,
                "permutation_sha256": sha256(&bins),
                "whitening_sha256": sha256(&whitening),
            });
            if bits == 16 {
                case["permutation"] = json!(bins);
                case["whitening"] = json!(whitening);
            }
            cases.push(case);
        }
    }
    Value::Array(cases)
}

fn marked_bytes(host: &[u8], method: Method) -> Vec<u8> {
    let (bits, strength) = (BitCount::new(32).unwrap(), Strength::new(0.1).unwrap());
    let request = MarkRequest {
        key: &MarkKey::from_bytes(counting()),
        others: &[],
        message: &Message::from_hex("c0ffee42", bits).unwrap(),
        params: EmbedParams { method, strength, bits, closed_loop: true },
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: usize::MAX,
    };
    mark(host, &request).unwrap().bytes
}

fn marked_files() -> Value {
    // Six decimals, and a GLB made from the text, as hosts usually are.
    let obj = to_obj(&Sample::Blob.mesh(3_000).unwrap());
    let glb = to_glb(Asset::read(&obj, &Limits::default()).unwrap().mesh());
    let of = |host: &[u8], method| json!(sha256(&marked_bytes(host, method)));
    let mut files = json!({ "host.obj": sha256(&obj), "host.glb": sha256(&glb) });
    for method in Method::ALL {
        files[format!("{method}.obj")] = of(&obj, method);
        files[format!("{method}.glb")] = of(&glb, method);
    }
    files
}

/// A hash of the positions, exact to the bit.
fn positions(mesh: &Mesh) -> String {
    let bytes = mesh.positions().iter().flat_map(glam::DVec3::to_array).flat_map(f64::to_le_bytes);
    sha256(&bytes.collect::<Vec<u8>>())
}

fn read(file: &[u8]) -> Mesh {
    Asset::read(file, &Limits::default()).unwrap().into_mesh()
}

fn message(bits: BitCount) -> Message {
    Message::from_hex("c0ffee42", bits).unwrap()
}

fn params(method: Method, strength: f64, bits: u32) -> EmbedParams {
    let (bits, strength) = (BitCount::new(bits).unwrap(), Strength::new(strength).unwrap());
    EmbedParams { method, strength, bits, closed_loop: true }
}

/// A mark in single precision, as GLB stores it.
fn marked(
    mesh: &Mesh,
    key: &MarkKey,
    params: EmbedParams,
    by: impl FnOnce(&[u8], &MarkRequest<'_>) -> Marked,
) -> (Value, Mesh) {
    let host = to_glb(&read(&to_obj(mesh)));
    let request = MarkRequest {
        key,
        others: &[],
        message: &message(params.bits),
        params,
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    let marked = by(&host, &request);
    let mesh = read(&marked.bytes);
    let report = &marked.report;
    let facts = json!({
        "vertices": report.vertices,
        "strength": report.strength.get(),
        "refused": report.refused,
        "method_used": report.method_used.name(),
        "flipped": report.quality.flipped,
        "rounds": report.rounds,
        "positions_sha256": positions(&mesh),
    });
    (facts, mesh)
}

/// The full result of an embedding in single precision, which has more than its report.
fn embedded(mesh: &Mesh, key: &MarkKey, params: EmbedParams) -> Embedding {
    let mesh = read(&to_glb(&read(&to_obj(mesh))));
    let surface = Surface::new(&mesh);
    let round = |positions: &mut [glam::DVec3]| {
        for p in positions {
            *p = p.as_vec3().as_dvec3();
        }
    };
    let host = Host { mesh: &mesh, surface: &surface, pinned: &[], round: &round, original: None };
    embed(host, &Codeword::new(key, &message(params.bits)), &params, &|| false).unwrap()
}

/// A mark whose allocation does not settle. The paper's method of the same modulation takes over.
fn fallen_back(mesh: &Mesh, key: u8, exact: Method, paper: Method) -> Value {
    let key = MarkKey::from_bytes([key; 32]);
    let by = |method| {
        let plain = |host: &[u8], request: &MarkRequest<'_>| mark(host, request).unwrap();
        marked(mesh, &key, params(method, 0.02, 256), plain)
    };
    let ((asked, asked_mesh), (_, paper_mesh)) = (by(exact), by(paper));
    assert_eq!(asked["method_used"], paper.name(), "{exact} did not fall back");
    assert_eq!(positions(&asked_mesh), positions(&paper_mesh), "{exact} and {paper}");
    asked
}

/// Each triangle is cut close to its corners, so that every vertex has a short edge.
fn with_short_edges(mesh: &Mesh) -> Mesh {
    let mut positions = mesh.positions().to_vec();
    let mut triangles = Vec::new();
    for &[a, b, c] in mesh.triangles() {
        let [p, q, r] = [[a, b], [b, c], [c, a]].map(|side| {
            let [from, to] = side.map(|v| positions[v as usize]);
            positions.push(from + 0.0002 * (to - from));
            u32::try_from(positions.len() - 1).unwrap()
        });
        triangles.extend([[a, p, r], [p, b, q], [p, q, r], [q, c, r]]);
    }
    Mesh::new(positions, triangles).unwrap()
}

/// Noise as of a scan: each coordinate moves by up to `amount`, the same in every run.
fn rough(mesh: &Mesh, amount: f64) -> Mesh {
    let mut state = 0_u64;
    let mut noise = || {
        // Knuth's MMIX generator. Its upper bits are used.
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let unit = f64::from(u32::try_from(state >> 32).unwrap()) / f64::from(u32::MAX);
        amount * (2.0 * unit - 1.0)
    };
    let moved = mesh.positions().iter().map(|p| *p + glam::DVec3::new(noise(), noise(), noise()));
    Mesh::new(moved.collect(), mesh.triangles().to_vec()).unwrap()
}

/// Cases whose arithmetic takes other branches than that of a small mesh.
fn cases() -> Value {
    let plain = |host: &[u8], request: &MarkRequest<'_>| mark(host, request).unwrap();
    let key = &MarkKey::from_bytes(counting());
    let large = Sample::Blob.mesh(24_000).unwrap();
    let (large, _) = marked(&large, key, params(Method::ExactMean, 0.1, 64), plain);
    assert!(large["vertices"].as_u64().unwrap() > 20_000);
    let small = Sample::Blob.mesh(3_000).unwrap();
    let limit = MaxDistortion::new(6e-5).unwrap();
    let (within, _) = marked(&small, key, params(Method::ExactMean, 0.1, 32), |host, request| {
        mark_within(host, request, limit, Strength::MAX).unwrap()
    });
    // The exact method moves no vertex by more than half its shortest edge, so the loop runs long.
    let cut = with_short_edges(&Sample::Blob.mesh(2_000).unwrap());
    let (short_edges, _) = marked(&cut, key, params(Method::ExactMean, 0.1, 32), plain);
    assert!(short_edges["rounds"].as_u64().unwrap() > 10, "{short_edges}");
    // A dense, noisy scan. Its edges are about 0.03 long, and triangles flip where their corners
    // are not stiffened.
    let dense_host = rough(&Sample::Blob.mesh(12_000).unwrap(), 0.013);
    let dense_params = params(Method::ExactMean, 0.2, 64);
    let (mut dense, dense_mesh) = marked(&dense_host, key, dense_params, plain);
    // The guard stiffens only the corners of triangles that their moves flipped.
    let guarded = embedded(&dense_host, key, dense_params);
    assert_eq!(guarded.positions, dense_mesh.positions());
    assert!(guarded.stiffened > 0 && dense["flipped"] == 0, "{} {dense}", guarded.stiffened);
    dense["stiffened"] = json!(guarded.stiffened);
    // Expensive bins, to which the budget leaves little margin, and vertices that cross the edges of
    // their bins.
    let [blob, gear] = [(Sample::Blob, 3_000), (Sample::Gear, 8_000)]
        .map(|(sample, vertices)| sample.mesh(vertices).unwrap());
    json!({
        "large": large,
        "max_distortion": within,
        "short_edges": short_edges,
        "dense": dense,
        "fallen_back_mean": fallen_back(&gear, 32, Method::ExactMean, Method::QspMean),
        "fallen_back_var": fallen_back(&blob, 137, Method::ExactVar, Method::QspVar),
    })
}

/// Numbers, exact to the bit.
fn numbers(all: &[f64]) -> Value {
    let bytes: Vec<u8> = all.iter().flat_map(|x| x.to_le_bytes()).collect();
    json!({ "first": all.iter().take(4).collect::<Vec<_>>(), "sha256": sha256(&bytes) })
}

/// What is read of a mark, and its verdict: blind, after the layout search and by the matched
/// filter, among the marks of fifty others.
fn verdict() -> Value {
    let params = params(Method::ExactMean, 0.1, 64);
    let host = Sample::Blob.mesh(6_000).unwrap();
    let host = read(&to_glb(&read(&to_obj(&host))));
    let key = MarkKey::from_bytes(counting());
    let (_, mesh) = marked(&host, &key, params, |host, request| mark(host, request).unwrap());
    let modulation = params.method.modulation();
    let own = Codeword::new(&key, &message(params.bits));
    let mut index = CodewordIndex::default();
    index.insert(0, modulation, &own);
    for other in 1..=50_u8 {
        let codeword = Codeword::new(&MarkKey::from_bytes([other; 32]), &message(params.bits));
        index.insert(u128::from(other), modulation, &codeword);
    }
    let suspect = Suspect::new(&mesh).unwrap();
    let soft = suspect.read(own.layout_class(), params.bits, modulation);
    let effort = LayoutEffort { radius: 0.002, candidates: 3, centres: 2, layouts: 3 };
    let layouts = synchronise(&suspect, params.bits, modulation, &effort);
    let worth = ReportLimits { log10_bound: -3.0, most: 3 };
    let judged = |readings: &(dyn Fn(GroupKey) -> Vec<Hypothesis> + Sync)| {
        let search = index.search(readings, worth);
        let found = search.candidates.iter().map(|c| {
            json!({
                "id": u64::try_from(c.id).unwrap(),
                "score": c.score.t,
                "agreeing": c.score.bits_agreeing,
                "log10_bound": c.log10_bound,
                "centre": c.hypothesis.frame.centre.to_array(),
            })
        });
        json!({ "hypotheses": search.hypotheses, "found": found.collect::<Vec<_>>() })
    };
    let blind = judged(&|key| {
        let soft = Arc::new(suspect.read(key.class, key.bits, key.modulation));
        vec![Hypothesis { frame: suspect.frame(), soft }]
    });
    let searched = judged(&|key| layouts.of_class(key.class));
    let filter = HostFilter::new(&host, own.layout_class(), &params).unwrap();
    let carriers = (0..).zip(&filter.surface().first_vertex);
    let correspondences: Vec<Correspondence> = carriers
        .map(|(carrier, &v)| Correspondence { carrier, at: mesh.positions()[v as usize] })
        .collect();
    let (filtered, rounds) = filter.read(&correspondences);
    let score = filtered.score(&own);
    let filtered_bound = filtered.log10_bound(score.t);
    assert_eq!(blind["found"][0]["id"], 0);
    assert!(filtered_bound < -15.0 && rounds == 0);
    json!({
        "soft_bits": numbers(soft.signed_weights()),
        "blind": blind,
        "searched": searched,
        "matched_filter": { "soft_bits": numbers(filtered.signed_weights()), "log10_bound": filtered_bound },
    })
}

/// Marks with both layers and with the relief alone, and what is read of each against the host.
fn reliefs() -> Value {
    let key = MarkKey::from_bytes(counting());
    let host = read(&to_glb(&read(&to_obj(&Sample::Knot.mesh(5_000).unwrap()))));
    let prepared = ReliefHost::new(Surface::new(&host)).unwrap();
    let signs = Signs::new(&key, prepared.field().signs());
    let first: Vec<i8> = (0..64).map(|c| if signs.sign(c) > 0.0 { 1 } else { -1 }).collect();
    let of = |layers: Layers| {
        let params = params(Method::ExactMean, 0.08, 64);
        let (mut facts, mesh) = marked(&host, &key, params, |host, request| {
            mark(host, &MarkRequest { layers, ..*request }).unwrap()
        });
        let suspect = Surface::new(&mesh);
        let at = &suspect.positions;
        let amplitude = Amplitude::default().get();
        let reading = ReliefReading::new(&prepared, &suspect, at, false, amplitude, &|| false);
        let reading = reading.unwrap();
        let log10_bound = reading.log10_bound(reading.score(&signs));
        assert!(log10_bound < -100.0, "{layers}: {log10_bound}");
        facts["weights"] = numbers(reading.signed_weights());
        facts["log10_bound"] = json!(log10_bound);
        facts
    };
    json!({
        "signs": prepared.field().signs(),
        "first_signs": first,
        "both": of(Layers::Both),
        "relief": of(Layers::Relief),
    })
}

#[test]
fn keys_and_marked_files_are_as_they_were() {
    let path = folder().join("vectors.json");
    let now = json!({
        "scheme_version": 1,
        "schedules": schedules(),
        "marked": marked_files(),
        "cases": cases(),
        "verdict": verdict(),
        "reliefs": reliefs(),
    });
    if std::env::var_os("QUADMARK_UPDATE_GOLDEN").is_some_and(|value| value == "1") {
        std::fs::write(&path, serde_json::to_string_pretty(&now).unwrap() + "\n").unwrap();
    }
    let then: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(now["schedules"], then["schedules"], "what a key means has changed");
    assert_eq!(now["marked"], then["marked"], "what an embedding writes has changed");
    assert_eq!(now["cases"], then["cases"], "where an embedding puts vertices has changed");
    assert_eq!(now["verdict"], then["verdict"], "what is read of a mark has changed");
}

#[test]
fn the_first_release_s_mark_is_still_read() {
    let bytes = std::fs::read(folder().join("marked_v1.obj")).unwrap();
    let key = MarkKey::from_bytes(counting());
    let bits = BitCount::new(32).unwrap();
    let found = extract_file(&bytes, &key, bits, Modulation::Mean, &Limits::default()).unwrap();
    assert_eq!(found.message().unwrap().to_hex(), "c0ffee42");
    assert!(found.margins.iter().all(|margin| *margin > 0.05), "{:?}", found.margins);
    let format = Asset::read(&bytes, &Limits::default()).unwrap().format();
    assert_eq!(format, Format::Obj);
}
