//! How long each stage of the service runs without calling `stop`, on a mesh of 3 million vertices:
//! the largest gap between two calls, or between a call and the beginning or the end of the stage.
//! `cargo bench --bench stops [-- VERTICES]`.
//!
//! Everything runs on one thread and is measured in CPU time of the process. So a busy machine does
//! not matter, and what is parallel in the service counts here in full. `tests/stops.rs` checks
//! that stages end when they are told to.
//!
//! On a virtual core of 2026, compiled as the tests are (`--profile dev`), the largest gaps are 169
//! ms in looking at a host for a moved copy, 117 ms in making a filter and 100 ms in marking a
//! file. Everything else calls `stop` within 95 ms. Before passes called it inside, gaps were up to
//! 9 s.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a benchmark")]

use std::hint::black_box;
use std::sync::Mutex;

use glam::DVec3;
use quadmark::attacks::Target;
use quadmark::attacks::simplify::simplify;
use quadmark::blobs::{geometry, marked};
use quadmark::forecast::expected;
use quadmark::formats::{Asset, Format, Limits, agrees_until};
use quadmark::marking::{
    Amplitude, Layers, MarkRequest, inspect_asset, inspect_asset_until, mark_asset,
};
use quadmark::mesh::Mesh;
use quadmark::mesh::quality::quality_until;
use quadmark::mesh::surface::Surface;
use quadmark::recognition::{HostModel, SuspectModel, poses};
use quadmark::registration::{
    Budget, Effort, PreparedHost, PreparedSuspect, Probe, Shape, Sketch, WorkLimits,
};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, Correspondence, EmbedParams, Host, HostFilter, MarkKey, Message, Method,
    Modulation, Suspect, embed, synchronise_until,
};
use rustix::time::{ClockId, clock_gettime};

/// Number of vertices of the mesh.
const VERTICES: u32 = 3_000_000;

/// Vertices of a mesh whose OBJ is as long as a file may be that another reader opens, too.
const CHECKED: u32 = 230_000;

/// Vertices of a mesh on which simplification is rehearsed, too. With more triangles it is not.
const SIMPLIFIED: u32 = 39_900;

/// Vertices of the mesh that is rehearsed on. Larger meshes are not rehearsed.
const REHEARSED: u32 = 199_000;

type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// CPU seconds of this process so far.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Times of the calls of `stop`.
#[derive(Default)]
struct Asked {
    last: f64,
    largest: f64,
    count: u64,
}

impl Asked {
    fn note(&mut self) {
        let now = cpu();
        self.largest = self.largest.max(now - self.last);
        self.last = now;
        self.count += 1;
    }
}

/// Runs a stage and prints its row.
fn stage<T>(name: &str, run: impl FnOnce(Stop<'_>) -> T) -> T {
    let start = cpu();
    let asked = Mutex::new(Asked { last: start, ..Asked::default() });
    let result = run(&|| {
        asked.lock().unwrap().note();
        false
    });
    let mut asked = asked.into_inner().unwrap();
    asked.note();
    let whole = asked.last - start;
    let (questions, gap) = (asked.count - 1, asked.largest);
    println!("| {name} | {whole:.2} | {questions} | {:.0} |", 1e3 * gap);
    result
}

fn files(mesh: &Mesh) {
    let limits = Limits::default();
    for (format, bytes) in [("OBJ", to_obj(mesh)), ("GLB", to_glb(mesh))] {
        let asset = stage(&format!("reading {format}"), |stop| {
            Asset::read_until(&bytes, &limits, stop).unwrap()
        });
        let message = Message::from_bytes(&[0x5a; 8], BitCount::default()).unwrap();
        let made = stage(&format!("marking {format}, qsp-mean, bytes to bytes"), |stop| {
            let request = MarkRequest {
                key: &MarkKey::from_bytes([3; 32]),
                others: &[],
                message: &message,
                params: EmbedParams { method: Method::QspMean, ..EmbedParams::default() },
                limits,
                stop,
                layers: Layers::Blind,
                amplitude: Amplitude::default(),
                independent_check_max_bytes: 0,
            };
            mark_asset(asset, &bytes, &request).unwrap().bytes
        });
        stage(&format!("packing a marked {format}"), |stop| {
            black_box(marked::pack_until(&made, &[0; 32], stop).unwrap());
        });
    }
}

/// The second opinion of another reader, on files of the largest size that it is asked about.
fn checking() {
    let mesh = Sample::Knot.mesh(CHECKED).unwrap();
    for (format, bytes) in [(Format::Obj, to_obj(&mesh)), (Format::Glb, to_glb(&mesh))] {
        let size = bytes.len() as f64 / f64::from(1 << 20);
        stage(&format!("second opinion on {size:.0} MiB of {format:?}"), |stop| {
            agrees_until(format, &bytes, &bytes, stop)
        });
    }
}

fn inspecting(mesh: &Mesh) {
    let params = EmbedParams::default();
    let asset = Asset::read(&to_glb(mesh), &Limits::default()).unwrap();
    stage("inspecting", |stop| inspect_asset_until(&asset, &params, stop).unwrap());
    let small = Sample::Knot.mesh(REHEARSED).unwrap();
    let asset = Asset::read(&to_glb(&small), &Limits::default()).unwrap();
    let seen = inspect_asset(&asset, &params).unwrap();
    let simplified = Sample::Knot.mesh(SIMPLIFIED).unwrap();
    let target = Target::new(&simplified);
    target.surface().unwrap();
    stage(&format!("simplifying {SIMPLIFIED} vertices by 90 %, one call"), |_| {
        simplify(&target, 0.9).unwrap()
    });
    stage(&format!("rehearsing on {SIMPLIFIED} vertices"), |stop| {
        let asset = Asset::read(&to_glb(&simplified), &Limits::default()).unwrap();
        let seen = inspect_asset(&asset, &params).unwrap();
        expected(asset.mesh(), &seen, &params, stop)
    });
    stage(&format!("rehearsing on {REHEARSED} vertices"), |stop| {
        expected(asset.mesh(), &seen, &params, stop)
    });
}

fn marking(mesh: &Mesh, surface: &Surface) -> (Vec<DVec3>, Codeword) {
    let bits = BitCount::default();
    let message = Message::from_bytes(&[0x5a; 8], bits).unwrap();
    let codeword = Codeword::new(&MarkKey::from_bytes([3; 32]), &message);
    let host = Host { mesh, surface, pinned: &[], round: &|_| {}, original: None };
    let mut positions = Vec::new();
    for method in [Method::QspMean, Method::ExactVar, Method::ExactMean] {
        let params = EmbedParams { method, ..EmbedParams::default() };
        let made = stage(&format!("marking, {method}"), |stop| {
            embed(host, &codeword, &params, stop).unwrap()
        });
        positions = made.positions;
    }
    let moved: Vec<DVec3> = surface.first_vertex.iter().map(|&v| positions[v as usize]).collect();
    stage("measuring", |stop| quality_until(surface, &moved, stop).unwrap());
    (positions, codeword)
}

fn keeping(mesh: &Mesh) {
    stage("hashing a geometry", |stop| geometry::key_until(mesh, stop).unwrap());
    let packed = stage("packing a geometry", |stop| geometry::pack_until(mesh, stop).unwrap());
    stage("unpacking a geometry", |stop| {
        geometry::unpack_until(&packed, usize::MAX, usize::MAX, stop).unwrap()
    });
}

fn preparing(surface: &Surface) -> (Shape, PreparedHost) {
    let shape = stage("preparing a shape", |stop| Shape::new_until(surface.clone(), stop).unwrap());
    stage("sketching", |stop| Sketch::new_until(&shape, stop).unwrap());
    stage("sketching a suspect", |stop| Probe::new_until(&shape, stop).unwrap());
    let copy = shape.clone();
    let host = stage("preparing a host", |stop| PreparedHost::new_until(copy, stop).unwrap());
    let copy = shape.clone();
    stage("preparing a suspect of hosts", |stop| PreparedSuspect::new_until(copy, stop).unwrap());
    (shape, host)
}

fn looking(mesh: &Mesh, marked: &Mesh) {
    let budget = Budget::new(200_000_000);
    let host_model =
        stage("preparing a home", |stop| HostModel::new_until(mesh.clone(), stop).unwrap());
    let moved = marked.positions().iter().map(|p| 0.5 * *p + DVec3::ONE).collect();
    let twin = Mesh::new(moved, marked.triangles().to_vec()).unwrap();
    let other = Sample::Knot.mesh(VERTICES / 2).unwrap();
    for (name, suspect) in [("a moved copy", &twin), ("another tessellation", &other)] {
        let surface = Surface::new(suspect);
        let suspect_model = SuspectModel::new(suspect, &surface);
        stage(&format!("looking at a host for {name}"), |stop| {
            let within = WorkLimits { budget: &budget, stop };
            let _ = poses(&host_model, &suspect_model, Effort::Thorough, within, &mut |pose| {
                black_box(pose);
                std::ops::ControlFlow::Continue(())
            });
        });
    }
}

fn verifying(mesh: &Mesh, marked: &Mesh, codeword: &Codeword) {
    let bits = BitCount::default();
    let suspect = stage("preparing a suspect", |stop| Suspect::new_until(marked, stop).unwrap());
    let full =
        quadmark::watermark::LayoutEffort { radius: 0.018, candidates: 4, centres: 2, layouts: 4 };
    stage("searching bin layouts", |stop| {
        synchronise_until(&suspect, bits, Modulation::Mean, &full, stop)
    });
    let params = EmbedParams::default();
    let class = codeword.layout_class();
    let filter =
        stage("making a filter", |stop| HostFilter::new_until(mesh, class, &params, stop).unwrap());
    let carriers = (0..).zip(&filter.surface().first_vertex);
    let seen = |scale: f64| -> Vec<Correspondence> {
        let at = |v: u32| scale * marked.positions()[v as usize];
        carriers.clone().map(|(carrier, &v)| Correspondence { carrier, at: at(v) }).collect()
    };
    let (as_it_was, smoothed) = (seen(1.0), seen(0.998));
    stage("comparing", |stop| drop(filter.compare_until(&as_it_was, None, stop)));
    stage("comparing with smoothing", |stop| {
        drop(filter.compare_until(&smoothed, Some(glam::DQuat::IDENTITY), stop));
    });
}

fn main() {
    let vertices = std::env::args().find_map(|a| a.parse().ok()).unwrap_or(VERTICES);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        let mesh = Sample::Knot.mesh(vertices).unwrap();
        println!("{} vertices, {} triangles\n", mesh.positions().len(), mesh.triangles().len());
        println!("| stage | seconds in all | questions | largest gap, ms |\n|---|---|---|---|");
        let surface = stage("preparing a surface", |stop| Surface::new_until(&mesh, stop).unwrap());
        files(&mesh);
        checking();
        inspecting(&mesh);
        let (positions, codeword) = marking(&mesh, &surface);
        keeping(&mesh);
        preparing(&surface);
        let marked = Mesh::new(positions, mesh.triangles().to_vec()).unwrap();
        drop(surface);
        looking(&mesh, &marked);
        verifying(&mesh, &marked, &codeword);
    });
}
