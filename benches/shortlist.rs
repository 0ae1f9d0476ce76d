//! The short list alone: whether a suspect finds its record among many, and how fast.
//!
//! ```text
//! cargo bench --bench shortlist -- FILE...
//! ```
//!
//! The index holds the files, 1,500 bent variants of generated shapes, and random sketches up to
//! 100,000 records; then up to a million, for the time. Sketches are of the hosts. Suspects are the
//! marked meshes (default parameters), attacked and then moved. Printed per attack: how often the
//! record came first and among the first ten, by parts and by outline, and the time of a query.
//! Without files: generated shapes.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::time::Instant;

use glam::{DQuat, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::registration::retrieval::descriptor::{BYTES, ShapeDescriptor};
use quadmark::registration::retrieval::sketch::HASHES;
use quadmark::registration::{GeometryIndex, Probe, Shape, Similarity, Sketch};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

#[path = "support/attacks.rs"]
mod attacks;

use attacks::{clustered, cropped, direction, noise, quantised, smoothed, uniform};

const VARIANTS: u32 = 1500;
const RECORDS: u32 = 100_000;
const MANY: u32 = 1_000_000;

type Attack = (&'static str, fn(&Mesh, &mut ChaCha20Rng) -> Mesh);

const ATTACKS: [Attack; 15] = [
    ("none", |m, _| m.clone()),
    ("crop 50 %", |m, r| cropped(m, 0.5, r)),
    ("crop 80 %", |m, r| cropped(m, 0.2, r)),
    ("crop 95 %", |m, r| cropped(m, 0.05, r)),
    ("noise 0.5 %", |m, r| noise(m, 5e-3, r)),
    ("noise 0.5 %, crop 80 %", |m, r| cropped(&noise(m, 5e-3, r), 0.2, r)),
    ("noise 0.5 %, crop 95 %", |m, r| cropped(&noise(m, 5e-3, r), 0.05, r)),
    ("8 bits", |m, _| quantised(m, 8)),
    ("8 bits, crop 80 %", |m, r| cropped(&quantised(m, 8), 0.2, r)),
    ("smoothed 20 times", |m, _| smoothed(m, 20)),
    ("smoothed 20, crop 80 %", |m, r| cropped(&smoothed(m, 20), 0.2, r)),
    ("clustered 150", |m, _| clustered(m, 150.0)),
    ("clustered 60", |m, _| clustered(m, 60.0)),
    ("clustered 30", |m, _| clustered(m, 30.0)),
    ("clustered 60, noise 0.5 %", |m, r| noise(&clustered(m, 60.0), 5e-3, r)),
];

fn shape(mesh: &Mesh) -> Shape {
    Shape::new(Surface::new(mesh)).unwrap()
}

fn placed(mesh: &Mesh, random: &mut ChaCha20Rng) -> Mesh {
    let place = Similarity {
        scale: 1.0 + uniform(random).abs(),
        rotation: DQuat::from_axis_angle(direction(random), 2.0),
        translation: direction(random),
    };
    let positions = mesh.positions().iter().map(|&p| place.apply(p)).collect();
    Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
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

/// A generated shape, stretched and bent at random.
fn variant(number: u32, random: &mut ChaCha20Rng) -> Mesh {
    let sample = Sample::ALL[number as usize % Sample::ALL.len()];
    let mesh = sample.mesh(600 + random.next_u32() % 1500).unwrap();
    let stretch = DVec3::ONE + 0.4 * direction(random);
    let (wave, across) = (2.0 * direction(random), 0.25 * direction(random));
    let bent = |&p: &DVec3| (p + across * (wave.dot(p) + f64::from(number)).sin()) * stretch;
    Mesh::new(mesh.positions().iter().map(bent).collect(), mesh.triangles().to_vec()).unwrap()
}

/// A sketch as of a mesh of some ten thousand vertices, with an outline like one of `outlines`.
fn filler(outlines: &[ShapeDescriptor], random: &mut ChaCha20Rng) -> Sketch {
    let hashes = (0..HASHES).map(|_| random.next_u64() >> 7).collect();
    let model = outlines[random.next_u32() as usize % outlines.len()];
    let mut bytes = model.0;
    for byte in bytes.iter_mut().take(BYTES) {
        let other = outlines[random.next_u32() as usize % outlines.len()];
        if random.next_u32().is_multiple_of(3) {
            *byte = byte.midpoint(other.0[0]);
        }
        *byte = byte.saturating_add(u8::try_from(random.next_u32() % 9).unwrap()).saturating_sub(4);
    }
    Sketch::from_parts(hashes, ShapeDescriptor(bytes))
}

fn rank(ids: impl IntoIterator<Item = u128>, id: u128) -> Option<usize> {
    ids.into_iter().position(|other| other == id)
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let mut hosts: Vec<Vec<u8>> = files.into_iter().map(|f| std::fs::read(f).unwrap()).collect();
    if hosts.is_empty() {
        hosts = Sample::ALL.iter().map(|s| to_obj(&s.mesh(20_000).unwrap())).collect();
    }
    let mut random = ChaCha20Rng::from_seed([3; 32]);
    let (mut records, mut suspects) = (Vec::new(), Vec::new());
    for (id, bytes) in (0_u128..).zip(&hosts) {
        let mesh = Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
        records.push((id, Sketch::new(&shape(&mesh))));
        suspects.extend(marked(bytes).map(|mesh| (id, mesh)));
    }
    println!("{} hosts, of which {} could be marked", hosts.len(), suspects.len());
    let start = Instant::now();
    for number in 0..VARIANTS {
        let sketch = Sketch::new(&shape(&variant(number, &mut random)));
        records.push((u128::from(number) + 1000, sketch));
    }
    println!("{VARIANTS} variants sketched in {:.1?}", start.elapsed());
    let outlines: Vec<ShapeDescriptor> = records.iter().map(|(_, s)| *s.outline()).collect();
    let mut index = GeometryIndex::default();
    for (id, sketch) in &records {
        index.insert(*id, sketch);
    }
    let mut next = 1_000_000_u128;
    let mut fill = |index: &mut GeometryIndex, to: u32| {
        while index.len() < to as usize {
            let batch: Vec<(u128, Sketch)> = (0..50_000.min(to as usize - index.len()))
                .map(|_| {
                    next += 1;
                    (next, filler(&outlines, &mut random))
                })
                .collect();
            index.extend(batch.iter().map(|(id, sketch)| (*id, sketch)));
        }
    };
    fill(&mut index, RECORDS);
    println!("{} records", index.len());
    for (attack, apply) in ATTACKS {
        let mut random = ChaCha20Rng::from_seed([1; 32]);
        let (mut first, mut ten, mut misses) = ([0; 2], [0; 2], Vec::new());
        let (mut probing, mut asking) = (0.0, [0.0; 2]);
        for (id, mesh) in &suspects {
            let suspect = placed(&apply(mesh, &mut random), &mut random);
            let start = Instant::now();
            let probe = Probe::new(&shape(&suspect));
            probing += start.elapsed().as_secs_f64();
            let start = Instant::now();
            let parts = rank(index.by_parts(&probe, 10).into_iter().map(|h| h.id), *id);
            asking[0] += start.elapsed().as_secs_f64();
            let start = Instant::now();
            let whole = rank(index.by_descriptor(&probe, 10).into_iter().map(|l| l.id), *id);
            asking[1] += start.elapsed().as_secs_f64();
            for (k, rank) in [parts, whole].into_iter().enumerate() {
                first[k] += u32::from(rank == Some(0));
                ten[k] += u32::from(rank.is_some());
            }
            if parts != Some(0) {
                let all = index.by_parts(&probe, usize::MAX);
                let hits = all.iter().find(|h| h.id == *id).map_or(0, |h| h.hits);
                misses.push((*id, probe.hashes.len(), hits, all.first().map_or(0, |h| h.hits)));
            }
        }
        let n = suspects.len() as f64;
        println!(
            "  {attack:27} by parts {:3} first {:3} in ten {:.1} ms; by outline {:3} first {:3} in \
             ten {:.1} ms; probe {:.0} ms; not first by \
             parts (id, probes, its hits, most hits): {misses:?}",
            first[0],
            ten[0],
            1e3 * asking[0] / n,
            first[1],
            ten[1],
            1e3 * asking[1] / n,
            1e3 * probing / n,
        );
    }
    fill(&mut index, MANY);
    for (_, mesh) in suspects.iter().take(3) {
        let probe = Probe::new(&shape(mesh));
        let start = Instant::now();
        let _ = index.by_parts(&probe, 10);
        let parts = start.elapsed();
        let start = Instant::now();
        let _ = index.by_descriptor(&probe, 10);
        let outline = start.elapsed();
        println!("{} records: by parts {parts:.1?}, by outline {outline:.1?}", index.len());
    }
}
