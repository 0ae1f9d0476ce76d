//! Everything that takes long stops when it is told to. Each stage is told so at its first call of
//! `stop`, half way, and near its end, and must return within the time of two passes over the mesh.
//! No stage runs for longer than a few passes without a call. `benches/stops.rs` measures the gaps
//! on a large mesh.
//!
//! Time is CPU time of this process, which runs only this one test. It is compared with the time
//! for preparing the same surface, so neither a slow nor a busy machine matters.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use quadmark::blobs::{geometry, marked};
use quadmark::forecast::expected;
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{
    Amplitude, Layers, MarkError, MarkRequest, inspect_asset_until, mark_asset,
};
use quadmark::mesh::Mesh;
use quadmark::mesh::quality::quality_until;
use quadmark::mesh::surface::Surface;
use quadmark::recognition::{HostModel, SuspectModel, poses};
use quadmark::registration::{
    Budget, Effort, PreparedHost, PreparedSuspect, Probe, Shape, Sketch, WorkLimits, by_surface,
    in_place,
};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, Correspondence, EmbedParams, Host, HostFilter, MarkKey, Message, Method,
    Modulation, Suspect, embed, extract_until, synchronise_until,
};
use rustix::time::{ClockId, clock_gettime};

/// Number of vertices of the mesh.
const VERTICES: u32 = 100_000;

/// Time within which a stage ends after it is told to stop, in preparations of the surface. With
/// 100,000 vertices one takes 15 to 40 ms. All stages end within 1.3 of them.
const MOST_LATE: f64 = 2.0;

/// Largest gap between two calls of `stop`, anywhere in a stage, in preparations of the surface.
/// The largest gaps are 2 to 5 of them, 40 to 70 ms: some parts take as long on a small mesh as on
/// a large one. A stage that calls in steps of a constant size has no longer gaps on a larger mesh.
const MOST_BETWEEN: f64 = 8.0;

/// CPU seconds of this process so far.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Returns `true` after `after` calls. Records when it first did, and the longest time between two
/// calls.
struct Stop {
    after: u64,
    asked: AtomicU64,
    at: AtomicU64,
    gaps: Mutex<Gaps>,
}

struct Gaps {
    last: f64,
    largest: f64,
}

impl Stop {
    fn after(after: u64) -> Self {
        let gaps = Mutex::new(Gaps { last: cpu(), largest: 0.0 });
        Self { after, asked: AtomicU64::new(0), at: AtomicU64::new(0), gaps }
    }

    fn now(&self) -> bool {
        // Some stages call a million times. In runs that are stopped, they must not pay for this
        // clock.
        if self.after == u64::MAX {
            self.note();
        }
        let number = self.asked.fetch_add(1, Ordering::Relaxed);
        if number == self.after {
            self.at.store(cpu().to_bits(), Ordering::Relaxed);
        }
        number >= self.after
    }
}

impl Stop {
    fn note(&self) {
        let mut gaps = self.gaps.lock().unwrap();
        let now = cpu();
        *gaps = Gaps { last: now, largest: gaps.largest.max(now - gaps.last) };
    }
}

type Stage<'a> = (&'static str, Box<dyn Fn(&(dyn Fn() -> bool + Sync)) + 'a>);

/// The mesh and what else the stages need.
struct Case {
    mesh: Mesh,
    surface: Surface,
    obj: Vec<u8>,
    glb: Vec<u8>,
    codeword: Codeword,
    marked: Mesh,
    smoothed: Vec<Correspondence>,
    filter: HostFilter,
    shape: Shape,
    host: PreparedHost,
    other: PreparedSuspect,
}

fn case() -> Case {
    let mesh = Sample::Knot.mesh(VERTICES).unwrap();
    let surface = Surface::new(&mesh);
    let bits = BitCount::default();
    let message = Message::from_bytes(&[0x5a; 8], bits).unwrap();
    let codeword = Codeword::new(&MarkKey::from_bytes([3; 32]), &message);
    let params = EmbedParams { method: Method::QspMean, ..EmbedParams::default() };
    let seen = Host { mesh: &mesh, surface: &surface, pinned: &[], round: &|_| {}, original: None };
    let made = embed(seen, &codeword, &params, &|| false).unwrap();
    let filter = HostFilter::new(&mesh, codeword.layout_class(), &params).unwrap();
    // Shrunk, so that many numbers of smoothing rounds are tried.
    let carriers = (0..).zip(&filter.surface().positions);
    let smoothed =
        carriers.map(|(carrier, p)| Correspondence { carrier, at: 0.998 * *p }).collect();
    let marked = Mesh::new(made.positions, mesh.triangles().to_vec()).unwrap();
    let shape = Shape::new(surface.clone()).unwrap();
    let host = PreparedHost::new(shape.clone());
    let other = Surface::new(&Sample::Knot.mesh(VERTICES - 20_000).unwrap());
    Case {
        obj: to_obj(&mesh),
        glb: to_glb(&mesh),
        other: PreparedSuspect::new(Shape::new(other).unwrap()),
        mesh,
        surface,
        codeword,
        marked,
        smoothed,
        filter,
        shape,
        host,
    }
}

fn host(case: &Case) -> Host<'_> {
    Host { mesh: &case.mesh, surface: &case.surface, pinned: &[], round: &|_| {}, original: None }
}

/// What is made of a mesh before anything else, and what is stored of it.
fn preparations(case: &Case) -> Vec<Stage<'_>> {
    let packed = geometry::pack(&case.mesh).unwrap();
    let message = Message::from_bytes(&[0x5a; 8], BitCount::default()).unwrap();
    vec![
        ("preparing a surface", Box::new(move |stop| drop(Surface::new_until(&case.mesh, stop)))),
        (
            "preparing a suspect",
            Box::new(move |stop| {
                let _ = Suspect::new_until(&case.marked, stop);
            }),
        ),
        (
            "reading blindly",
            Box::new(move |stop| {
                let key = MarkKey::from_bytes([3; 32]);
                let (bits, mean) = (BitCount::default(), Modulation::Mean);
                let _ = extract_until(&case.surface, &key, bits, mean, stop);
            }),
        ),
        (
            "preparing a shape",
            Box::new(move |stop| drop(Shape::new_until(case.surface.clone(), stop))),
        ),
        (
            "preparing a host",
            Box::new(move |stop| drop(PreparedHost::new_until(case.shape.clone(), stop))),
        ),
        ("sketching a host", Box::new(move |stop| drop(Sketch::new_until(&case.shape, stop)))),
        ("sketching a suspect", Box::new(move |stop| drop(Probe::new_until(&case.shape, stop)))),
        (
            "looking at a host",
            Box::new(move |stop| {
                let Some(host_model) = HostModel::new_until(case.mesh.clone(), stop) else {
                    return;
                };
                let budget = Budget::new(10_000_000);
                let within = WorkLimits { budget: &budget, stop };
                let suspect_model = SuspectModel::new(&case.marked, &case.surface);
                let mut go_on = |_| std::ops::ControlFlow::Continue(());
                let _ = poses(&host_model, &suspect_model, Effort::Whole, within, &mut go_on);
            }),
        ),
        (
            "hashing a file",
            Box::new(move |stop| {
                let _ = marked::sha256_until(&case.obj, stop);
            }),
        ),
        (
            "packing a file",
            Box::new(move |stop| drop(marked::pack_until(&case.obj, &[0; 32], stop))),
        ),
        (
            "hashing a geometry",
            Box::new(move |stop| {
                let _ = geometry::key_until(&case.mesh, stop);
            }),
        ),
        ("packing a geometry", Box::new(move |stop| drop(geometry::pack_until(&case.mesh, stop)))),
        (
            "unpacking a geometry",
            Box::new(move |stop| {
                let _ = geometry::unpack_until(&packed, usize::MAX, usize::MAX, stop);
            }),
        ),
        (
            "marking a file",
            Box::new(move |stop| {
                let limits = Limits::default();
                let request = MarkRequest {
                    key: &MarkKey::from_bytes([3; 32]),
                    others: &[],
                    message: &message,
                    params: EmbedParams { method: Method::QspMean, ..EmbedParams::default() },
                    limits,
                    stop,
                    layers: Layers::Both,
                    amplitude: Amplitude::default(),
                    independent_check_max_bytes: usize::MAX,
                };
                let Ok(asset) = Asset::read_until(&case.obj, &limits, stop) else { return };
                drop(mark_asset(asset, &case.obj, &request));
            }),
        ),
    ]
}

fn stages(case: &Case) -> Vec<Stage<'_>> {
    let limits = Limits::default();
    let exact = EmbedParams::default();
    let qsp = EmbedParams { method: Method::QspMean, ..exact };
    let asset = Asset::read(&case.glb, &limits).unwrap();
    let seen = inspect_asset_until(&asset, &qsp, &|| false).unwrap();
    let inspected = Asset::read(&case.glb, &limits).unwrap();
    let suspect = Suspect::new(&case.marked).unwrap();
    let moved: Vec<DVec3> = case.surface.positions.iter().map(|p| 1.001 * *p).collect();
    let class = case.codeword.layout_class();
    let full =
        quadmark::watermark::LayoutEffort { radius: 0.018, candidates: 4, centres: 2, layouts: 4 };
    vec![
        ("reading OBJ", Box::new(move |stop| drop(Asset::read_until(&case.obj, &limits, stop)))),
        ("reading GLB", Box::new(move |stop| drop(Asset::read_until(&case.glb, &limits, stop)))),
        (
            "inspecting",
            Box::new(move |stop| {
                let seen = inspect_asset_until(&inspected, &qsp, stop);
                assert!(!matches!(seen, Err(MarkError::Format(_))));
            }),
        ),
        ("rehearsing", Box::new(move |stop| drop(expected(asset.mesh(), &seen, &qsp, stop)))),
        (
            "measuring",
            Box::new(move |stop| {
                let _ = quality_until(&case.surface, &moved, stop);
            }),
        ),
        (
            "marking, qsp-mean",
            Box::new(move |stop| {
                let _ = embed(host(case), &case.codeword, &qsp, &|| stop());
            }),
        ),
        (
            "marking, exact-mean",
            Box::new(move |stop| {
                let _ = embed(host(case), &case.codeword, &exact, &|| stop());
            }),
        ),
        (
            "searching bin layouts",
            Box::new(move |stop| {
                let _ =
                    synchronise_until(&suspect, BitCount::default(), Modulation::Mean, &full, stop);
            }),
        ),
        (
            "making a filter",
            Box::new(move |stop| {
                let _ = HostFilter::new_until(&case.mesh, class, &qsp, stop);
            }),
        ),
        (
            "comparing",
            Box::new(move |stop| {
                let _ =
                    case.filter.compare_until(&case.smoothed, Some(glam::DQuat::IDENTITY), stop);
            }),
        ),
        (
            "looking in place",
            Box::new(move |stop| {
                let budget = Budget::new(u64::MAX);
                let _ = in_place(&case.host, &case.other, WorkLimits { budget: &budget, stop });
            }),
        ),
        (
            "registering",
            Box::new(move |stop| {
                let budget = Budget::new(u64::MAX);
                let within = WorkLimits { budget: &budget, stop };
                let _ = by_surface(&case.host, &case.other, Effort::Thorough, &[], within);
            }),
        ),
    ]
}

#[test]
fn every_stage_ends_soon_after_it_is_told_to() {
    let case = case();
    let start = cpu();
    for _ in 0..3 {
        drop(Surface::new(&case.mesh));
    }
    let pass = (cpu() - start) / 3.0;
    let mut slow = Vec::new();
    for (name, run) in preparations(&case).into_iter().chain(stages(&case)) {
        let whole = Stop::after(u64::MAX);
        let start = cpu();
        run(&|| whole.now());
        let (asked, took) = (whole.asked.load(Ordering::Relaxed), cpu() - start);
        assert!(asked > 0, "{name} never asks");
        whole.note();
        let gap = whole.gaps.lock().unwrap().largest / pass;
        eprintln!("{name}: the largest gap is {gap:.1} passes");
        if gap >= MOST_BETWEEN {
            slow.push(format!("{name} does not ask for {gap:.1} passes"));
        }
        for after in [0, asked / 2, asked - 1] {
            let stop = Stop::after(after);
            run(&|| stop.now());
            let told = f64::from_bits(stop.at.load(Ordering::Relaxed));
            // On several threads, it may have called less often this time.
            if told == 0.0 {
                continue;
            }
            let late = (cpu() - told) / pass;
            eprintln!(
                "{name}: {:.1} passes, asks {asked} times, told at {after}: {late:.1}",
                took / pass
            );
            if late >= MOST_LATE {
                slow.push(format!("{name}, told at {after} of {asked}: {late:.1} passes late"));
            }
        }
    }
    assert!(slow.is_empty(), "{slow:#?}");
}
