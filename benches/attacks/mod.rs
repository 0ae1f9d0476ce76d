//! Attacks on frames, for the benchmarks of the blind reader.

use std::collections::BTreeSet;

use glam::DVec3;
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;

/// An attack by name.
pub type Attack = (&'static str, fn(&Mesh) -> Mesh);

/// Attacks that must not hide a mark. The first is none.
pub const ATTACKS: [Attack; 12] = [
    ("none", Mesh::clone),
    ("farthest vertex out 1 %", |mesh| pushed(mesh, 1.01)),
    ("nearest vertex in 1 %", |mesh| pulled(mesh, 0.99)),
    ("farthest vertex out 100 %", |mesh| pushed(mesh, 2.0)),
    ("10 stray vertices", |mesh| stray_vertices(mesh, 10)),
    ("10 stray triangles", |mesh| stray_triangles(mesh, 10, 1e-4)),
    ("10 large stray triangles", |mesh| stray_triangles(mesh, 10, 1e-2)),
    ("Laplacian 0.5 x 1", |mesh| smoothed(mesh, 0.5, 1)),
    ("Laplacian 0.1 x 5", |mesh| smoothed(mesh, 0.1, 5)),
    ("farthest 0.2 % missing", |mesh| without_farthest(mesh, 2)),
    ("farthest 2 % missing", |mesh| without_farthest(mesh, 20)),
    ("cropped by a plane 2 %", |mesh| cropped(mesh, DVec3::new(0.3, 1.0, 0.2), 20)),
];

fn centre(mesh: &Mesh) -> DVec3 {
    Surface::new(mesh).centre()
}

/// Indices of used vertices by distance to the centre, nearest first.
fn by_norm(mesh: &Mesh, centre: DVec3) -> Vec<usize> {
    let used: BTreeSet<u32> = mesh.triangles().iter().flatten().copied().collect();
    let mut order: Vec<usize> = used.into_iter().map(|v| v as usize).collect();
    order.sort_by(|&a, &b| {
        let norm = |v: usize| mesh.positions()[v].distance(centre);
        norm(a).total_cmp(&norm(b))
    });
    order
}

fn rebuilt(mesh: &Mesh, positions: Vec<DVec3>) -> Mesh {
    Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
}

/// Multiplies the norm of the farthest vertex by `factor`.
fn pushed(mesh: &Mesh, factor: f64) -> Mesh {
    let centre = centre(mesh);
    let mut positions = mesh.positions().to_vec();
    let last = *by_norm(mesh, centre).last().unwrap();
    positions[last] = centre + factor * (positions[last] - centre);
    rebuilt(mesh, positions)
}

/// Moves the nearest vertex towards the centre by a share of the largest norm.
fn pulled(mesh: &Mesh, factor: f64) -> Mesh {
    let centre = centre(mesh);
    let mut positions = mesh.positions().to_vec();
    let order = by_norm(mesh, centre);
    let far = positions[*order.last().unwrap()].distance(centre);
    let at = &mut positions[order[0]];
    let norm = at.distance(centre);
    *at = centre + (norm - (1.0 - factor) * far).max(0.0) / norm * (*at - centre);
    rebuilt(mesh, positions)
}

fn far_off(mesh: &Mesh, k: usize) -> (DVec3, f64) {
    let (low, high) = mesh
        .positions()
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
    let diagonal = (high - low).length();
    let angle = k as f64 * 2.4;
    let direction = DVec3::new(angle.cos(), angle.sin(), (k as f64 * 0.7).sin());
    (low.midpoint(high) + (1.0 + 0.3 * k as f64) * diagonal * direction, diagonal)
}

/// Adds far vertices that no triangle uses.
fn stray_vertices(mesh: &Mesh, count: usize) -> Mesh {
    let mut positions = mesh.positions().to_vec();
    positions.extend((0..count).map(|k| far_off(mesh, k).0));
    rebuilt(mesh, positions)
}

/// Adds far triangles of `size` diagonals.
fn stray_triangles(mesh: &Mesh, count: usize, size: f64) -> Mesh {
    let mut positions = mesh.positions().to_vec();
    let mut triangles = mesh.triangles().to_vec();
    for k in 0..count {
        let (at, diagonal) = far_off(mesh, k);
        let first = u32::try_from(positions.len()).unwrap();
        positions.extend([at, at + size * diagonal * DVec3::X, at + size * diagonal * DVec3::Y]);
        triangles.push([first, first + 1, first + 2]);
    }
    Mesh::new(positions, triangles).unwrap()
}

/// Moves each vertex `lambda` of the way to the mean of its neighbours, `rounds` times. Welded
/// points move together.
pub fn smoothed(mesh: &Mesh, lambda: f64, rounds: usize) -> Mesh {
    let surface = Surface::new(mesh);
    let mut around = vec![BTreeSet::new(); surface.positions.len()];
    for t in &surface.triangles {
        for k in 0..3 {
            around[t[k] as usize].insert(t[(k + 1) % 3]);
            around[t[k] as usize].insert(t[(k + 2) % 3]);
        }
    }
    let mut points = surface.positions.clone();
    for _ in 0..rounds {
        points = (0..points.len())
            .map(|v| {
                let sum: DVec3 = around[v].iter().map(|&n| points[n as usize]).sum();
                points[v] + lambda * (sum / around[v].len() as f64 - points[v])
            })
            .collect();
    }
    let carried = mesh.positions().iter().zip(&surface.carrier_of);
    let positions = carried.map(|(&p, &c)| points.get(c as usize).copied().unwrap_or(p)).collect();
    rebuilt(mesh, positions)
}

/// The mesh without the vertices marked in `gone` and their triangles.
fn without(mesh: &Mesh, gone: &[bool]) -> Mesh {
    let triangles = mesh.triangles().iter().copied();
    let left = triangles.filter(|t| !t.iter().any(|&v| gone[v as usize])).collect();
    Mesh::new(mesh.positions().to_vec(), left).unwrap()
}

/// The mesh without this share of the vertices, those farthest from the centre.
fn without_farthest(mesh: &Mesh, thousandths: usize) -> Mesh {
    let order = by_norm(mesh, centre(mesh));
    let mut gone = vec![false; mesh.positions().len()];
    let left = order.len() - order.len() * thousandths / 1000;
    order[left..].iter().for_each(|&v| gone[v] = true);
    without(mesh, &gone)
}

/// The mesh without this share of the vertices, cut off by a plane.
fn cropped(mesh: &Mesh, normal: DVec3, thousandths: usize) -> Mesh {
    let used: BTreeSet<u32> = mesh.triangles().iter().flatten().copied().collect();
    let mut heights: Vec<f64> =
        used.iter().map(|&v| normal.dot(mesh.positions()[v as usize])).collect();
    heights.sort_by(f64::total_cmp);
    let cut = heights[heights.len() - heights.len() * thousandths / 1000];
    let gone: Vec<bool> = mesh.positions().iter().map(|p| normal.dot(*p) >= cut).collect();
    without(mesh, &gone)
}
