use super::*;
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::sample::Sample;
use crate::watermark::{Codeword, EmbedParams, Host, MarkKey, Message, embed};

const EFFORT: LayoutEffort = LayoutEffort { radius: 0.018, candidates: 4, centres: 2, layouts: 4 };

fn marked() -> (Mesh, Codeword) {
    let mesh = Sample::Blob.mesh(20_000).unwrap();
    let surface = Surface::new(&mesh);
    let host = Host { mesh: &mesh, surface: &surface, pinned: &[], round: &|_| {}, original: None };
    let message = Message::from_bytes(&[0xc5; 8], BitCount::default()).unwrap();
    let codeword = Codeword::new(&MarkKey::from_bytes([8; 32]), &message);
    let embedding = embed(host, &codeword, &EmbedParams::default(), &|| false).unwrap();
    (Mesh::new(embedding.positions, mesh.triangles().to_vec()).unwrap(), codeword)
}

/// The bound of the best reading, and the number of readings.
fn best(mesh: &Mesh, codeword: &Codeword) -> (f64, usize) {
    let suspect = Suspect::new(mesh).unwrap();
    let found = synchronise(&suspect, codeword.bit_count(), Modulation::Mean, &EFFORT);
    let readings = found.of_class(codeword.layout_class());
    let bound = |reading: &Hypothesis| {
        let soft = &reading.soft;
        soft.log10_bound(soft.score(codeword).t)
    };
    (readings.iter().map(bound).fold(0.0, f64::min), readings.len())
}

fn blind(mesh: &Mesh, codeword: &Codeword) -> f64 {
    let suspect = Suspect::new(mesh).unwrap();
    let soft = suspect.read(codeword.layout_class(), codeword.bit_count(), Modulation::Mean);
    soft.log10_bound(soft.score(codeword).t)
}

#[test]
fn damaged_frames_are_found_again() {
    let (mesh, codeword) = marked();
    let centre = Surface::new(&mesh).centre();
    let farthest = |p: &DVec3, q: &DVec3| p.distance(centre).total_cmp(&q.distance(centre));
    let far = *mesh.positions().iter().max_by(|p, q| farthest(p, q)).unwrap();
    let moved = |new: &dyn Fn(DVec3) -> DVec3| {
        let positions = mesh.positions().iter().map(|&p| new(p)).collect();
        Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
    };
    let without = |gone: &dyn Fn(DVec3) -> bool| {
        let at = |v: u32| mesh.positions()[v as usize];
        let triangles = mesh.triangles().iter().filter(|t| !t.iter().any(|&v| gone(at(v))));
        Mesh::new(mesh.positions().to_vec(), triangles.copied().collect()).unwrap()
    };
    let strays = {
        let mut positions = mesh.positions().to_vec();
        let mut triangles = mesh.triangles().to_vec();
        for k in 0..10_u32 {
            let first = u32::try_from(positions.len()).unwrap();
            let at = DVec3::new(9.0 + f64::from(k), 3.0, f64::from(k % 3));
            positions.extend([at, at + 0.001 * DVec3::X, at + 0.001 * DVec3::Y]);
            triangles.push([first, first + 1, first + 2]);
        }
        Mesh::new(positions, triangles).unwrap()
    };
    let mut heights: Vec<f64> = mesh.positions().iter().map(|p| p.y).collect();
    heights.sort_by(f64::total_cmp);
    let cut = heights[heights.len() * 98 / 100];
    for (name, suspect) in [
        ("one vertex out", moved(&|p| if p == far { centre + 1.01 * (p - centre) } else { p })),
        ("ten stray triangles", strays),
        ("2 % cut off", without(&|p| p.y > cut)),
    ] {
        let (found, readings) = best(&suspect, &codeword);
        let before = blind(&suspect, &codeword);
        assert!(before > -9.0, "{name} does no harm: {before}");
        assert!(found < -15.0, "{name}: {found}");
        assert!((1..=3 * EFFORT.layouts).contains(&readings));
    }
}

#[test]
fn the_search_is_the_same_on_one_and_on_many_threads() {
    let suspect = Suspect::new(&marked().0).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let search = || synchronise(&suspect, BitCount::default(), Modulation::Variance, &EFFORT);
        let found = pool.install(search);
        (0..=255).flat_map(|class| found.of_class(class)).map(|h| h.frame).collect::<Vec<_>>()
    };
    let one = run(1);
    assert!(!one.is_empty());
    assert_eq!(one, run(3));
}

#[test]
fn shapes_without_bins_are_no_trouble() {
    let blob = Sample::Blob.mesh(3000).unwrap();
    let ball = blob.positions().iter().map(|p| p.normalize()).collect();
    let ball = Mesh::new(ball, blob.triangles().to_vec()).unwrap();
    let triangle = Mesh::new(vec![DVec3::ZERO, DVec3::X, 3.0 * DVec3::Y], vec![[0, 1, 2]]).unwrap();
    for mesh in [ball, triangle] {
        let Ok(suspect) = Suspect::new(&mesh) else { continue };
        let small = LayoutEffort { radius: 0.002, candidates: 3, centres: 2, layouts: 3 };
        for bits in [16, 256] {
            let bits = BitCount::new(bits).unwrap();
            let found = synchronise(&suspect, bits, Modulation::Mean, &small);
            assert!(found.of_class(7).len() <= 2 * small.layouts);
        }
    }
}
