//! The attacks for the benchmarks of registration.

use glam::DVec3;
use quadmark::mesh::Mesh;
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::Rng;

/// Uniform in [-1, 1).
pub fn uniform(random: &mut ChaCha20Rng) -> f64 {
    f64::from(random.next_u32()) / f64::from(1_u32 << 31) - 1.0
}

pub fn direction(random: &mut ChaCha20Rng) -> DVec3 {
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
pub fn noise(mesh: &Mesh, share: f64, random: &mut ChaCha20Rng) -> Mesh {
    let middle = mesh.positions().iter().sum::<DVec3>() / mesh.positions().len() as f64;
    let size = mesh.positions().iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
    moved(mesh, |p| p + share * size * direction(random))
}

pub fn quantised(mesh: &Mesh, bits: i32) -> Mesh {
    let low = mesh.positions().iter().copied().reduce(DVec3::min).unwrap();
    let high = mesh.positions().iter().copied().reduce(DVec3::max).unwrap();
    let step = (high - low).max_element() / (2_f64.powi(bits) - 1.0);
    moved(mesh, |&p| low + ((p - low) / step).round() * step)
}

/// Laplacian smoothing by 0.5, `times` times.
pub fn smoothed(mesh: &Mesh, times: usize) -> Mesh {
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

/// Keeps the given share of the vertices, on one side of a plane.
pub fn cropped(mesh: &Mesh, kept: f64, random: &mut ChaCha20Rng) -> Mesh {
    let normal = direction(random);
    let mut heights: Vec<f64> = mesh.positions().iter().map(|p| p.dot(normal)).collect();
    heights.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rank")]
    let plane = heights[(heights.len() as f64 * (1.0 - kept)) as usize];
    let beyond = |v: u32| mesh.positions()[v as usize].dot(normal) >= plane;
    let triangles = mesh.triangles().iter().copied().filter(|t| t.iter().all(|&v| beyond(v)));
    Mesh::new(mesh.positions().to_vec(), triangles.collect()).unwrap()
}

/// Merges the vertices of each cell of a grid: a coarse tessellation.
pub fn clustered(mesh: &Mesh, cells: f64) -> Mesh {
    let low = mesh.positions().iter().copied().reduce(DVec3::min).unwrap();
    let high = mesh.positions().iter().copied().reduce(DVec3::max).unwrap();
    let size = (high - low).max_element() / cells;
    let cell = |p: &DVec3| ((*p - low) / size).floor().to_array().map(f64::to_bits);
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
