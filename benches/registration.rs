//! Whether a suspect is brought home into its host's coordinates, and how precisely.
//!
//! ```text
//! cargo bench --bench registration -- FILE...
//! ```
//!
//! Per mesh and attack: the suspect is the marked mesh (`qsp-mean`, strength 0.1, 64 bits) after the
//! attack, turned, scaled, moved and with its vertices and triangles in another order; the host is
//! the unmarked mesh. Printed are the distance between the host's centre and where registration
//! takes it, in percent of the host's diagonal, the error of rotation and scale, the overlap, and
//! the time. A success is an error of the centre below 0.05 %. Without files: a generated mesh.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::time::Instant;

use glam::{DQuat, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::registration::shape::Shape;
use quadmark::registration::similarity::Similarity;
use quadmark::registration::twins::{Landmarks, twins};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const SUCCESS: f64 = 5e-4;

/// Uniform in [-1, 1).
fn uniform(random: &mut ChaCha20Rng) -> f64 {
    f64::from(random.next_u32()) / f64::from(1_u32 << 31) - 1.0
}

fn direction(random: &mut ChaCha20Rng) -> DVec3 {
    loop {
        let d = DVec3::from_array(std::array::from_fn(|_| uniform(random)));
        if d.length() < 1.0 && d.length() > 0.01 {
            return d.normalize();
        }
    }
}

fn moved(mesh: &Mesh, new: impl FnMut(&DVec3) -> DVec3) -> Mesh {
    Mesh::new(mesh.positions().iter().map(new).collect(), mesh.triangles().to_vec()).unwrap()
}

/// The paper's eq. 23.
fn noise(mesh: &Mesh, share: f64, random: &mut ChaCha20Rng) -> Mesh {
    let middle = mesh.positions().iter().sum::<DVec3>() / mesh.positions().len() as f64;
    let size = mesh.positions().iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
    moved(mesh, |p| p + share * size * direction(random))
}

fn quantised(mesh: &Mesh, bits: i32) -> Mesh {
    let low = mesh.positions().iter().copied().reduce(DVec3::min).unwrap();
    let high = mesh.positions().iter().copied().reduce(DVec3::max).unwrap();
    let step = (high - low).max_element() / (2_f64.powi(bits) - 1.0);
    moved(mesh, |&p| low + ((p - low) / step).round() * step)
}

/// Laplacian smoothing, 0.5, so many times.
fn smoothed(mesh: &Mesh, times: usize) -> Mesh {
    let mut positions = mesh.positions().to_vec();
    for _ in 0..times {
        let mut sums = vec![(DVec3::ZERO, 0.0); positions.len()];
        for t in mesh.triangles() {
            for k in 0..3 {
                let (a, b) = (t[k] as usize, t[(k + 1) % 3] as usize);
                sums[a] = (sums[a].0 + positions[b], sums[a].1 + 1.0);
                sums[b] = (sums[b].0 + positions[a], sums[b].1 + 1.0);
            }
        }
        for (p, (sum, count)) in positions.iter_mut().zip(sums) {
            if count > 0.0 {
                *p = 0.5 * *p + 0.5 * sum / count;
            }
        }
    }
    Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
}

/// Keeps the given share of the vertices, beyond a plane.
fn cropped(mesh: &Mesh, kept: f64, random: &mut ChaCha20Rng) -> Mesh {
    let normal = direction(random);
    let mut heights: Vec<f64> = mesh.positions().iter().map(|p| p.dot(normal)).collect();
    heights.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rank")]
    let plane = heights[(heights.len() as f64 * (1.0 - kept)) as usize];
    let beyond = |v: u32| mesh.positions()[v as usize].dot(normal) >= plane;
    let triangles = mesh.triangles().iter().copied().filter(|t| t.iter().all(|&v| beyond(v)));
    Mesh::new(mesh.positions().to_vec(), triangles.collect()).unwrap()
}

/// Every second vertex pulled together with a neighbour: a tessellation of its own with about
/// half of the vertices.
fn clustered(mesh: &Mesh, cells: f64) -> Mesh {
    let low = mesh.positions().iter().copied().reduce(DVec3::min).unwrap();
    let high = mesh.positions().iter().copied().reduce(DVec3::max).unwrap();
    let size = (high - low).max_element() / cells;
    let cell = |p: &DVec3| ((*p - low) / size).floor().to_array().map(|x| x.to_bits());
    let mut sums = std::collections::BTreeMap::new();
    for p in mesh.positions() {
        let sum = sums.entry(cell(p)).or_insert((DVec3::ZERO, 0.0));
        *sum = (sum.0 + *p, sum.1 + 1.0);
    }
    moved(mesh, |p| {
        let (sum, count) = sums[&cell(p)];
        sum / count
    })
}

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

/// Another place, another order.
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
        // Stored as most files store them.
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

fn marked(host: &[u8]) -> Mesh {
    let request = MarkRequest {
        key: &MarkKey::from_bytes([7; 32]),
        message: &Message::from_bytes(&[151; 8], BitCount::default()).unwrap(),
        params: EmbedParams::default(),
        limits: Limits::default(),
        stop: &|| false,
        independent_check_max_bytes: 0,
    };
    Asset::read(&mark(host, &request).unwrap().bytes, &Limits::default()).unwrap().into_mesh()
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let mut hosts: Vec<(String, Vec<u8>)> =
        files.into_iter().map(|name| (name.clone(), std::fs::read(name).unwrap())).collect();
    if hosts.is_empty() {
        hosts.push(("a generated knot".into(), to_obj(&Sample::Knot.mesh(40_000).unwrap())));
    }
    for (name, bytes) in hosts {
        let mesh = Asset::read(&bytes, &Limits::default()).unwrap().into_mesh();
        let surface = Surface::new(&mesh);
        let (centre, diagonal) = (surface.centre(), surface.diagonal());
        let start = Instant::now();
        let host = Shape::new(surface).unwrap();
        let landmarks = Landmarks::new(&host);
        println!("{name}: {} vertices, prepared in {:.2?}", host.positions.len(), start.elapsed());
        let marked = marked(&bytes);
        for (attack, apply) in ATTACKS {
            let mut random = ChaCha20Rng::from_seed([1; 32]);
            let place = Similarity {
                scale: 0.3,
                rotation: DQuat::from_axis_angle(direction(&mut random), 2.0),
                translation: diagonal * direction(&mut random),
            };
            let suspect = shuffled(&apply(&marked, &mut random), &place, &mut random);
            let start = Instant::now();
            let suspect = Shape::new(Surface::new(&suspect)).unwrap();
            let found = twins(&host, &landmarks, &suspect);
            let time = start.elapsed().as_secs_f64();
            let Some(found) = found else {
                println!("  {attack:25} not found                    {time:6.2} s");
                continue;
            };
            let home = suspect.unit.then(&found.similarity).then(&host.unit.inverse());
            let error = home.apply(place.apply(centre)).distance(centre) / diagonal;
            let all = place.then(&home);
            println!(
                "  {attack:25} {} centre {:9.6} %  rotation {:.1e} deg  scale {:.1e}  \
                 {:6} of {} pairs, median {:.1e}  {time:6.2} s",
                if error < SUCCESS { "ok " } else { "BAD" },
                100.0 * error,
                2.0 * all.rotation.xyz().length().asin().to_degrees(),
                (all.scale - 1.0).abs(),
                found.pairs.len(),
                suspect.positions.len(),
                found.median,
            );
        }
    }
}
