use glam::{DQuat, DVec3};

use super::*;
use crate::mesh::Mesh;
use crate::relief::Field;
use crate::sample::Sample;
use crate::watermark::MarkKey;

const AMPLITUDE: f64 = 8e-5;

fn surface(positions: Vec<DVec3>, triangles: &[[u32; 3]]) -> Surface {
    Surface::new(&Mesh::new(positions, triangles.to_vec()).unwrap())
}

struct Case {
    host: ReliefHost,
    plain: Surface,
    marked: Surface,
    signs: Signs,
}

fn signs(host: &ReliefHost, key: u8) -> Signs {
    Signs::new(&MarkKey::from_bytes([key; 32]), host.field().signs())
}

fn case(sample: Sample, vertices: u32) -> Case {
    let plain = Surface::new(&sample.mesh(vertices).unwrap());
    let host = ReliefHost::new(plain.clone()).unwrap();
    let signs = signs(&host, 1);
    let moved = host.field().marked(&plain, &signs, AMPLITUDE, &[]);
    Case { marked: surface(moved, &plain.triangles), host, plain, signs }
}

fn read(case: &Case, suspect: &Surface) -> Option<ReliefReading> {
    ReliefReading::new(&case.host, suspect, &suspect.positions, false, AMPLITUDE, &|| false)
}

fn log10(case: &Case, suspect: &Surface) -> f64 {
    let reading = read(case, suspect).unwrap();
    for key in 2..=40 {
        let of_another = reading.deviations(reading.score(&signs(&case.host, key)));
        assert!(of_another.abs() < 4.5, "key {key}: {of_another}");
    }
    reading.log10_bound(reading.score(&case.signs))
}

#[test]
fn a_mark_is_read_whole_in_part_and_a_little_off_and_nothing_from_the_host() {
    for sample in [Sample::Blob, Sample::Knot] {
        let case = case(sample, 12_000);
        assert!(log10(&case, &case.marked) < -200.0, "{sample}");
        let plain = log10(&case, &case.plain);
        assert!(plain > -5.0, "{sample}: {plain}");
        let part: Vec<[u32; 3]> = case.marked.triangles.iter().copied().take(1600).collect();
        let part = surface(case.marked.positions.clone(), &part);
        assert!(log10(&case, &part) < -12.0, "{sample}");
        // Off as registration leaves it: half a degree, 0.2 % of the diagonal and of the size.
        let diagonal = case.host.field().diagonal();
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.0087);
        let shift = 0.001 * diagonal * DVec3::new(1.0, -1.0, 1.0);
        let off = |p: &DVec3| turn * *p * 1.002 + shift;
        let off = case.marked.positions.iter().map(off).collect();
        let off = log10(&case, &surface(off, &case.marked.triangles));
        assert!(off < -150.0, "{sample}: {off}");
    }
}

#[test]
fn the_surface_moves_as_far_as_asked_and_no_triangle_turns() {
    for (sample, vertices) in [(Sample::Blob, 12_000), (Sample::Gear, 2000), (Sample::Knot, 500)] {
        let plain = Surface::new(&sample.mesh(vertices).unwrap());
        let field = Field::new(&plain).unwrap();
        for key in 1..=10 {
            let signs = Signs::new(&MarkKey::from_bytes([key; 32]), field.signs());
            let moved = field.marked(&plain, &signs, AMPLITUDE, &[]);
            let quality = crate::mesh::quality::quality_until(&plain, &moved, &|| false).unwrap();
            assert_eq!(quality.flipped, 0, "{sample}");
            assert!(
                (0.7 * AMPLITUDE..1.2 * AMPLITUDE).contains(&quality.mrms),
                "{sample}: {}",
                quality.mrms
            );
        }
    }
}

#[test]
fn pinned_vertices_stay() {
    let plain = Surface::new(&Sample::Blob.mesh(2000).unwrap());
    let field = Field::new(&plain).unwrap();
    let signs = Signs::new(&MarkKey::from_bytes([1; 32]), field.signs());
    let pinned: Vec<bool> = (0..plain.positions.len()).map(|v| v < 100).collect();
    let moved = field.marked(&plain, &signs, AMPLITUDE, &pinned);
    assert_eq!(moved[..100], plain.positions[..100]);
    assert_ne!(moved[100..], plain.positions[100..]);
}

#[test]
fn scores_by_fours_are_those_sign_by_sign() {
    let weights: Vec<f64> = (0..131_u32).map(|k| f64::from(k % 17) - 8.0).collect();
    let reading = ReliefReading::weighted(weights);
    for key in 0..20 {
        let signs = Signs::new(&MarkKey::from_bytes([key; 32]), 131);
        let one = |(cell, z): (u32, &f64)| z * signs.sign(cell);
        let sum: f64 = (0..).zip(reading.signed_weights()).map(one).sum();
        assert!((reading.score(&signs) - sum).abs() < 1e-9);
        let (read, agreeing) = reading.agreeing(&signs);
        assert!(agreeing <= read && read < 131);
        // No score that is worth a report is sieved out.
        let bound = reading.log10_bound(sum);
        assert!(reading.least_score(bound).unwrap() <= sum.max(0.0) + 1e-9);
    }
}

#[test]
fn the_reading_is_the_same_on_one_and_on_many_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let case = case(Sample::Knot, 6000);
            read(&case, &case.marked).unwrap().signed_weights().to_vec()
        })
    };
    let one = run(1);
    for threads in [2, 5] {
        assert!(run(threads).iter().zip(&one).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
}

#[test]
fn what_is_elsewhere_or_stopped_or_strange_is_not_read() {
    let case = case(Sample::Blob, 3000);
    let far = case.marked.positions.iter().map(|p| *p + DVec3::splat(100.0)).collect();
    assert!(read(&case, &surface(far, &case.marked.triangles)).is_none());
    let stopped = ReliefReading::new(
        &case.host,
        &case.marked,
        &case.marked.positions,
        false,
        AMPLITUDE,
        &|| true,
    );
    assert!(stopped.is_none());
    let flat: Vec<DVec3> =
        (0..900).map(|k| DVec3::new(f64::from(k % 30), f64::from(k / 30), 0.0)).collect();
    let squares = |k: u32| [[k, k + 1, k + 31], [k, k + 31, k + 30]];
    let all: Vec<[u32; 3]> = (0..869).filter(|k| k % 30 < 29).flat_map(squares).collect();
    let plane = surface(flat, &all);
    let host = ReliefHost::new(plane.clone()).unwrap();
    let signs = signs(&host, 1);
    let marked = surface(host.field().marked(&plane, &signs, AMPLITUDE, &[]), &plane.triangles);
    let reading =
        ReliefReading::new(&host, &marked, &marked.positions, false, AMPLITUDE, &|| false).unwrap();
    assert!(reading.log10_bound(reading.score(&signs)) < -50.0);
    for size in [1e200, 1e-200] {
        let tiny = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p * size).to_vec();
        assert!(ReliefHost::new(surface(tiny, &[[0, 1, 2]])).is_none());
    }
}
