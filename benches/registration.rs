//! Whether registration finds a suspect's pose in its host's coordinates, and how precisely.
//!
//! ```text
//! cargo bench --bench registration -- FILE...
//! ```
//!
//! Per mesh and attack: the suspect is the marked mesh (default parameters) after the attack,
//! turned, scaled, moved and with its vertices and triangles in another order; the host is the
//! unmarked mesh. Printed are the distance between the host's centre and where registration takes
//! it, in percent of the host's diagonal, the error of rotation and scale, the overlap, and the
//! time. A success is an error of the centre below 0.05 %. Without files: a generated mesh.
//! `HOST=SUSPECT` takes a suspect that is already attacked but still in its host's pose, as
//! `benches/tessellations.py` makes them.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::time::Instant;

use glam::{DQuat, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::registration::{
    Alignment, Budget, Effort, PreparedHost, PreparedSuspect, Shape, Similarity, WorkLimits,
    by_surface, by_vertices, suffices,
};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

#[path = "support/attacks.rs"]
mod attacks;

use attacks::{clustered, cropped, direction, noise, quantised, smoothed};

const SUCCESS: f64 = 5e-4;

type Attack = (&'static str, fn(&Mesh, &mut ChaCha20Rng) -> Mesh);

const ATTACKS: [Attack; 20] = [
    ("none", |m, _| m.clone()),
    ("crop 10 %", |m, r| cropped(m, 0.9, r)),
    ("crop 30 %", |m, r| cropped(m, 0.7, r)),
    ("crop 50 %", |m, r| cropped(m, 0.5, r)),
    ("crop 80 %", |m, r| cropped(m, 0.2, r)),
    ("crop 95 %", |m, r| cropped(m, 0.05, r)),
    ("noise 0.1 %", |m, r| noise(m, 1e-3, r)),
    ("noise 0.5 %", |m, r| noise(m, 5e-3, r)),
    ("noise 0.5 %, crop 50 %", |m, r| cropped(&noise(m, 5e-3, r), 0.5, r)),
    ("noise 0.5 %, crop 80 %", |m, r| cropped(&noise(m, 5e-3, r), 0.2, r)),
    ("quantised to 10 bits", |m, _| quantised(m, 10)),
    ("10 bits, crop 50 %", |m, r| cropped(&quantised(m, 10), 0.5, r)),
    ("quantised to 8 bits", |m, _| quantised(m, 8)),
    ("smoothed 5 times", |m, _| smoothed(m, 5)),
    ("smoothed 5, crop 50 %", |m, r| cropped(&smoothed(m, 5), 0.5, r)),
    ("smoothed 20 times", |m, _| smoothed(m, 20)),
    ("clustered 150", |m, _| clustered(m, 150.0)),
    ("clustered 60", |m, _| clustered(m, 60.0)),
    ("clustered 150, crop 50 %", |m, r| cropped(&clustered(m, 150.0), 0.5, r)),
    ("clustered 150, crop 80 %", |m, r| cropped(&clustered(m, 150.0), 0.2, r)),
];

/// The mesh in another pose and in another order.
fn shuffled(mesh: &Mesh, place: &Similarity, random: &mut ChaCha20Rng) -> Mesh {
    let n = mesh.positions().len();
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, random.next_u32() as usize % (i + 1));
    }
    let mut new_of = vec![0_u32; n];
    let mut positions = Vec::with_capacity(n);
    for (new, &old) in (0..).zip(&order) {
        new_of[old] = new;
        // Rounded as most files store them.
        #[expect(clippy::cast_possible_truncation, reason = "to 32 bits, on purpose")]
        let single = |x: f64| f64::from(x as f32);
        let p = place.apply(mesh.positions()[old]);
        positions.push(DVec3::new(single(p.x), single(p.y), single(p.z)));
    }
    let mut triangles: Vec<[u32; 3]> =
        mesh.triangles().iter().map(|&[a, b, c]| [b, c, a].map(|v| new_of[v as usize])).collect();
    for i in (1..triangles.len()).rev() {
        triangles.swap(i, random.next_u32() as usize % (i + 1));
    }
    Mesh::new(positions, triangles).unwrap()
}

fn marked(host: &[u8]) -> Option<Mesh> {
    let request = MarkRequest {
        key: &MarkKey::from_bytes([7; 32]),
        others: &[],
        message: &Message::from_bytes(&[151; 8], BitCount::default()).unwrap(),
        params: EmbedParams::default(),
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    let bytes = mark(host, &request).ok()?.bytes;
    Some(Asset::read(&bytes, &Limits::default()).unwrap().into_mesh())
}

struct Prepared {
    host: PreparedHost,
    centre: DVec3,
    diagonal: f64,
}

impl Prepared {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let mesh = Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
        let surface = Surface::new(&mesh);
        let (centre, diagonal) = (surface.centre(), surface.diagonal());
        let start = Instant::now();
        let host = PreparedHost::new(Shape::new(surface).unwrap());
        let vertices = host.shape().positions.len();
        println!("{name}: {vertices} vertices, prepared in {:.2?}", start.elapsed());
        Self { host, centre, diagonal }
    }

    /// Moves a mesh, registers it and prints a row; `true` if it succeeded.
    fn attempt(&self, attack: &str, mesh: &Mesh, random: &mut ChaCha20Rng) -> bool {
        let Self { host, centre, diagonal } = self;
        let place = Similarity {
            scale: 0.3,
            rotation: DQuat::from_axis_angle(direction(random), 2.0),
            translation: diagonal * direction(random),
        };
        let suspect = shuffled(mesh, &place, random);
        let start = Instant::now();
        let suspect = PreparedSuspect::new(Shape::new(Surface::new(&suspect)).unwrap());
        let budget = Budget::new(u64::MAX);
        let within = WorkLimits { budget: &budget, stop: &|| false };
        let shared = by_vertices(host, &suspect, within.stop);
        let enough = shared.as_ref().is_some_and(|found| suffices(host, &suspect, found, within));
        let mut found: Vec<Alignment> = shared.into_iter().collect();
        if !enough {
            found.splice(0..0, by_surface(host, &suspect, Effort::Thorough, &[], within));
        }
        let time = start.elapsed().as_secs_f64();
        let error =
            |a: &Alignment| a.similarity.apply(place.apply(*centre)).distance(*centre) / diagonal;
        let right = found.iter().position(|a| error(a) < SUCCESS);
        let Some(Alignment { similarity, basis, overlap, rms, pairs }) = found.first() else {
            println!("  {attack:25} BAD not found  {time:6.2} s");
            return false;
        };
        let all = place.then(similarity);
        println!(
            "  {attack:25} {} centre {:9.6} %  rotation {:.1e} deg  scale {:.1e}  {basis:?} \
             overlap {overlap:.3}  rms {rms:.1e}  {} pairs  {time:.2} s",
            match right {
                Some(0) => "ok ".to_owned(),
                Some(k) => format!("ok as number {k}"),
                None => "BAD".to_owned(),
            },
            100.0 * error(&found[0]),
            2.0 * all.rotation.xyz().length().min(1.0).asin().to_degrees(),
            (all.scale - 1.0).abs(),
            pairs.len(),
        );
        right.is_some()
    }
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let (ready, files): (Vec<String>, Vec<String>) =
        files.into_iter().partition(|f| f.contains('='));
    let (mut tried, mut right) = (0, 0);
    let mut last: Option<(String, Prepared)> = None;
    for both in &ready {
        let (host, suspect) = both.split_once('=').unwrap();
        if last.as_ref().is_none_or(|(name, _)| name != host) {
            last = Some((host.into(), Prepared::new(host, &std::fs::read(host).unwrap())));
        }
        let mesh = Asset::read(&std::fs::read(suspect).unwrap(), &Limits::default());
        let name = suspect.rsplit('/').next().unwrap().trim_end_matches(".obj");
        let mut random = ChaCha20Rng::from_seed([1; 32]);
        let (_, prepared) = last.as_ref().unwrap();
        tried += 1;
        right += u32::from(prepared.attempt(name, mesh.unwrap().mesh(), &mut random));
    }
    let mut hosts: Vec<(String, Vec<u8>)> =
        files.into_iter().map(|name| (name.clone(), std::fs::read(name).unwrap())).collect();
    if hosts.is_empty() && ready.is_empty() {
        hosts.push(("a generated knot".into(), to_obj(&Sample::Knot.mesh(40_000).unwrap())));
    }
    for (name, bytes) in hosts {
        let prepared = Prepared::new(&name, &bytes);
        let Some(marked) = marked(&bytes) else {
            println!("  cannot be marked");
            continue;
        };
        for (attack, apply) in ATTACKS {
            let mut random = ChaCha20Rng::from_seed([1; 32]);
            let suspect = apply(&marked, &mut random);
            tried += 1;
            right += u32::from(prepared.attempt(attack, &suspect, &mut random));
        }
    }
    println!("{right} of {tried}");
}
