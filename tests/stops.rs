//! Whatever takes long hears that it should stop: each stage is told so at its first question, half
//! way, and near its end, and is to return within the time of a few passes over the mesh.
//!
//! Time is CPU time of this process (one test, so that nothing else runs in it), and is compared with
//! that of preparing the same surface: neither a slow nor a busy machine matters.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use quadmark::formats::{Asset, Limits};
use quadmark::lab::expected::expected;
use quadmark::marking::{MarkError, inspect_asset_until};
use quadmark::mesh::Mesh;
use quadmark::mesh::quality::quality_until;
use quadmark::mesh::surface::Surface;
use quadmark::registration::{
    Budget, Effort, PreparedHost, PreparedSuspect, Shape, Within, by_surface, in_place,
};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, EmbedParams, Host, HostFilter, MarkKey, Message, Method, Modulation,
    Sighting, Suspect, embed, synchronise_until,
};
use rustix::time::{ClockId, clock_gettime};

/// Vertices of the mesh.
const VERTICES: u32 = 100_000;

/// Preparations of the surface that a stage may go on for. With 100,000 vertices one takes 20 to
/// 40 ms, so a stage with this many would still return within a quarter of a second.
const MOST: f64 = 6.0;

/// The same for a rehearsal: as many attacks as there are threads run at once, and those that subdivide
/// make four times the mesh before they ask again.
const MOST_REHEARSED: f64 = 16.0;

/// CPU seconds of this process so far.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Answers `true` from the question after `after` on, and notes when it first did.
struct Stop {
    after: u64,
    asked: AtomicU64,
    at: AtomicU64,
}

impl Stop {
    fn after(after: u64) -> Self {
        Self { after, asked: AtomicU64::new(0), at: AtomicU64::new(0) }
    }

    fn now(&self) -> bool {
        let number = self.asked.fetch_add(1, Ordering::Relaxed);
        if number == self.after {
            self.at.store(cpu().to_bits(), Ordering::Relaxed);
        }
        number >= self.after
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
    smoothed: Vec<Sighting>,
    filter: HostFilter,
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
    let seen = Host { mesh: &mesh, surface: &surface, pinned: &[], round: &|_| {} };
    let made = embed(seen, &codeword, &params, &|| false).unwrap();
    let filter = HostFilter::new(&mesh, codeword.lattice_class(), &params).unwrap();
    // Shrunk: many numbers of rounds of smoothing are tried.
    let carriers = (0..).zip(&filter.surface().positions);
    let smoothed = carriers.map(|(carrier, p)| Sighting { carrier, at: 0.998 * *p }).collect();
    let marked = Mesh::new(made.positions, mesh.triangles().to_vec()).unwrap();
    let host = PreparedHost::new(Shape::new(surface.clone()).unwrap());
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
        host,
    }
}

fn host(case: &Case) -> Host<'_> {
    Host { mesh: &case.mesh, surface: &case.surface, pinned: &[], round: &|_| {} }
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
    let class = case.codeword.lattice_class();
    let full =
        quadmark::watermark::Effort { radius: 0.018, candidates: 4, centres: 2, lattices: 4 };
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
            "searching lattices",
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
                let _ = in_place(&case.host, &case.other, true, Within { budget: &budget, stop });
            }),
        ),
        (
            "registering",
            Box::new(move |stop| {
                let budget = Budget::new(u64::MAX);
                let within = Within { budget: &budget, stop };
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
    for (name, run) in stages(&case) {
        let whole = Stop::after(u64::MAX);
        let start = cpu();
        run(&|| whole.now());
        let (asked, took) = (whole.asked.load(Ordering::Relaxed), cpu() - start);
        assert!(asked > 0, "{name} never asks");
        for after in [0, asked / 2, asked - 1] {
            let stop = Stop::after(after);
            run(&|| stop.now());
            let told = f64::from_bits(stop.at.load(Ordering::Relaxed));
            // (On several threads it may have asked less often this time.)
            if told == 0.0 {
                continue;
            }
            let late = (cpu() - told) / pass;
            eprintln!(
                "{name}: {:.1} passes, asks {asked} times, told at {after}: {late:.1}",
                took / pass
            );
            let most = if name == "rehearsing" { MOST_REHEARSED } else { MOST };
            assert!(late < most, "{name}, told at question {after} of {asked}: {late:.1} passes");
        }
    }
}
