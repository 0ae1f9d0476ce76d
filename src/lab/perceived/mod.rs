//! How visible a change of a surface is: MSDM2 (G. Lavoué, *A multiscale metric for 3D mesh visual
//! quality assessment*, Computer Graphics Forum 30(5), 2011).
//!
//! Mean curvatures of the two surfaces are compared window by window, as images are by SSIM: by
//! their means, deviations and covariance. So a change counts more on a smooth part than on a rough
//! one, which masks it. 0 is no difference; values towards 1 are gross differences. The parameters
//! are those of the author's implementation (MEPP2): three scales, curvature from balls of 0.2, 0.3
//! and 0.4 % of the longest side, windows five times as wide, and pooling with the exponent 3.
//!
//! Where that implementation departs from the definition, this module follows the implementation,
//! so that values compare with published ones. Edges of a ball that pass its centre are left out.
//! Angles between triangles follow from their sines. Curvatures of a matched triangle are weighted
//! by areas from the vertex instead of from its foot point. The covariance of a window is weighted
//! by one surface and divided by the weights of the other.
//!
//! The module is checked against closed forms (curvature of spheres and cylinders), against
//! published behaviour (masking, order of strengths), and by `benches/metro/msdm2.py` against a
//! literal implementation in another language. That implementation reproduces the map that the
//! author's program is published with.

mod curvature;
mod window;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::closest::{Closest, Footpoint};
use crate::mesh::surface::{Surface, doubled_area};
use curvature::{Shape, mean_curvatures};
use window::Window;

/// Radii of the balls that curvature is taken from, as shares of the longest side.
const RADII: [f64; 3] = [0.002, 0.003, 0.004];

/// Radius of a window over that of a ball.
const WINDOW: f64 = 5.0;

/// Exponent of the pooling.
const POWER: f64 = 3.0;

/// Weight of the structure term. The other two terms have weight 1.
const STRUCTURE: f64 = 0.5;

/// Largest number of windows. On larger meshes every k-th vertex stands for all.
const WINDOWS: usize = 50_000;

/// MSDM2 between two surfaces, the mean of both directions. `None` when one has no triangle.
#[must_use]
pub fn msdm2(a: &Surface, b: &Surface) -> Option<f64> {
    let (a, b) = (Shape::new(a), Shape::new(b));
    Some(f64::midpoint(one_sided(&a, &b)?, one_sided(&b, &a)?))
}

/// What a vertex is compared with: the closest point of the other surface.
struct Match {
    place: DVec3,
    curvature: f64,
}

fn one_sided(a: &Shape<'_>, b: &Shape<'_>) -> Option<f64> {
    let target = Closest::new(b.surface)?;
    let shown = Shown {
        surface: b.surface,
        around: Adjacency::new(b.surface.positions.len(), &b.surface.triangles),
    };
    let places = &a.surface.positions;
    let feet: Vec<Footpoint> =
        places.par_iter().with_min_len(1024).map(|&p| target.footpoint(p)).collect();
    // Lengths are relative to the surface whose windows are compared.
    let side = a.longest_side();
    let stride = places.len().div_ceil(WINDOWS).max(1);
    let mut local = vec![0.0; places.len().div_ceil(stride)];
    for radius in RADII {
        let [own, other] = [a, b].map(|shape| mean_curvatures(shape, radius * side));
        let interpolated =
            |(&place, foot): (&DVec3, &Footpoint)| side * shown.curvature(place, foot, &other);
        let own: Vec<f64> = own.iter().map(|c| side * c).collect();
        let matches: Vec<Match> = places
            .iter()
            .zip(&feet)
            .map(|matched| Match { place: matched.1.place, curvature: interpolated(matched) })
            .collect();
        let window =
            Window { shape: a, own: &own, matches: &matches, radius: WINDOW * radius * side };
        local.par_iter_mut().with_min_len(2048).enumerate().for_each_init(
            window::Scratch::default,
            |scratch, (k, sum)| {
                *sum += window.difference(k * stride, scratch);
            },
        );
    }
    let scales = RADII.len() as f64;
    let powers: f64 = local.iter().map(|sum| (sum / scales).powi(3)).sum();
    Some(libm::pow(powers / local.len() as f64, 1.0 / POWER))
}

/// The other surface, for the curvature at matched points.
struct Shown<'a> {
    surface: &'a Surface,
    around: Adjacency,
}

impl Shown<'_> {
    /// The curvature at the match of a point, from the curvatures at the vertices. If the closest
    /// point is on a side or a corner, the published program takes the triangle that its search
    /// finds first. Here it is the mean over all triangles that share the side or corner.
    fn curvature(&self, point: DVec3, foot: &Footpoint, of_vertices: &[f64]) -> f64 {
        let of = |triangle: u32| {
            let corners = self.surface.triangles[triangle as usize];
            let weights = weights(point, corners.map(|v| self.surface.positions[v as usize]));
            corners.iter().zip(weights).map(|(&v, w)| w * of_vertices[v as usize]).sum::<f64>()
        };
        let corners = self.surface.triangles[foot.triangle as usize];
        let spans = || corners.iter().zip(foot.weights).filter(|(_, w)| *w > 0.0).map(|(&v, _)| v);
        let shares = |t: &&u32| spans().all(|v| self.surface.triangles[**t as usize].contains(&v));
        let around = spans().next().map_or(&[][..], |v| self.around.around(v as usize));
        let (count, sum) = around
            .iter()
            .filter(shares)
            .fold((0.0, 0.0), |(count, sum), &triangle| (count + 1.0, sum + of(triangle)));
        if count > 0.0 { sum / count } else { of(foot.triangle) }
    }
}

/// Weights of the corners of the triangle that a point is matched with: the areas that the point
/// spans with the two other corners. They are barycentric coordinates if the point lies on the
/// triangle.
fn weights(point: DVec3, corners: [DVec3; 3]) -> [f64; 3] {
    let [a, b, c] = corners;
    let areas = [(b, c), (c, a), (a, b)].map(|(p, q)| doubled_area(point, p, q).length());
    let total: f64 = areas.iter().sum();
    if total > 0.0 { areas.map(|area| area / total) } else { [1.0 / 3.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attacks::{Target, noise, smooth};
    use crate::mesh::Mesh;
    use crate::sample::Sample;

    fn between(a: &Mesh, b: &Mesh) -> f64 {
        msdm2(&Surface::new(a), &Surface::new(b)).unwrap()
    }

    #[test]
    fn nothing_is_nothing_and_more_is_more() {
        let host = Sample::Blob.mesh(4000).unwrap();
        assert!(between(&host, &host) < 1e-9);
        let noisy =
            [0.0005, 0.002, 0.01].map(|s| noise::unit_vectors(&Target::new(&host), s, 1).unwrap());
        let [weak, middle, strong] = noisy.each_ref().map(|mesh| between(&host, mesh));
        assert!(
            0.01 < weak && weak < middle && middle < strong && strong < 1.0,
            "{weak} {middle} {strong}"
        );
        assert!((between(&noisy[1], &host) - middle).abs() < 1e-9, "symmetric");
    }

    /// Values of `benches/metro/msdm2.py` for `quadmark sample blob --vertices 1500`.
    #[test]
    fn values_are_those_of_the_literal_implementation() {
        let bytes = crate::sample::to_obj(&Sample::Blob.mesh(1500).unwrap());
        let limits = crate::formats::Limits::default();
        let host = crate::formats::Asset::read(&bytes, &limits).unwrap().into_mesh();
        let centre = host.positions().iter().sum::<DVec3>() / host.positions().len() as f64;
        let size = host.positions().iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
        let shaken = |share: f64| {
            let step = |p: DVec3| (p / size * DVec3::new(97.0, 101.0, 103.0)).map(libm::sin);
            let moved = host.positions().iter().map(|&p| p + share * size * step(p));
            Mesh::new(moved.collect(), host.triangles().to_vec()).unwrap()
        };
        let smoothed = smooth::laplacian(&Target::new(&host), 0.5, 3).unwrap();
        let cases = [(shaken(0.002), 0.116_519), (shaken(0.02), 0.539_724), (smoothed, 0.363_210)];
        for (changed, literal) in cases {
            let lab = between(&host, &changed);
            assert!((lab - literal).abs() < 1e-6, "{lab} for {literal}");
        }
    }

    #[test]
    fn size_and_place_do_not_matter() {
        let host = Sample::Blob.mesh(3000).unwrap();
        let noisy = noise::unit_vectors(&Target::new(&host), 0.002, 1).unwrap();
        let moved = |mesh: &Mesh| {
            let positions = mesh.positions().iter().map(|p| 40.0 * *p + DVec3::splat(3.0));
            Mesh::new(positions.collect(), mesh.triangles().to_vec()).unwrap()
        };
        let (here, there) = (between(&host, &noisy), between(&moved(&host), &moved(&noisy)));
        assert!((here / there - 1.0).abs() < 1e-6, "{here} {there}");
    }

    /// Lavoué 2011, section 3: a rough surface masks what a smooth one shows.
    #[test]
    fn rough_parts_mask() {
        let smooth = Sample::Blob.mesh(6000).unwrap();
        let rough = noise::unit_vectors(&Target::new(&smooth), 0.01, 5).unwrap();
        let changed = |mesh: &Mesh| {
            let steps = noise::unit_vectors(&Target::new(&smooth), 0.001, 2).unwrap();
            let moved = mesh
                .positions()
                .iter()
                .zip(smooth.positions().iter().zip(steps.positions()))
                .map(|(p, (from, to))| *p + (*to - *from));
            Mesh::new(moved.collect(), mesh.triangles().to_vec()).unwrap()
        };
        let seen = between(&smooth, &changed(&smooth));
        let masked = between(&rough, &changed(&rough));
        assert!(masked < 0.8 * seen, "{masked} against {seen}");
        // Smoothing a rough surface is visible.
        let smoothed = smooth::laplacian(&Target::new(&rough), 0.5, 5).unwrap();
        assert!(between(&rough, &smoothed) > masked);
    }
}
