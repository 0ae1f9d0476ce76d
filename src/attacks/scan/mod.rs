//! A new surface through points measured on the old one, as a scanner gives them.

mod fit;
mod parts;

use glam::DVec3;

use super::isosurface::{Grid, extract, grown};
use super::{AttackError, Target};
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::surface::{Surface, doubled_area};
use fit::Fit;

/// How the surface is measured, and how finely it is made anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scanning {
    /// How many points.
    pub points: usize,
    /// Standard deviation of each of their coordinates, as a share of the diagonal.
    pub noise: f64,
    /// Cells of the grid along the diagonal.
    pub cells: f64,
}

impl Scanning {
    /// 100,000 points and 256 cells (an octree of depth 8, Poisson reconstruction's usual one), with
    /// noise of this share of the diagonal.
    #[must_use]
    pub fn with_noise(noise: f64) -> Self {
        Self { points: 100_000, noise, cells: 256.0 }
    }
}

/// Points within so many mean distances between points are fitted together: some fifty points.
const REACH: f64 = 4.0;
/// And at least within so many cells: the corners of a cell that is passed are up to 1.7 away.
const LEAST_REACH: f64 = 2.0;

/// How far the values of two neighbouring corners may stand apart, in cells. Fits differ between the
/// two; distances to one surface would differ by at most 1.
const SLACK: f64 = 2.0;

/// Parts with less than this share of the triangles are taken for noise, as who makes a surface of a scan
/// does: between near sheets the fits leave crumbs.
const LEAST_PART: f64 = 1e-3;

/// A measured point, and the outward normal that it was measured with.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Where it was measured.
    pub place: DVec3,
    /// Outward, of length 1.
    pub normal: DVec3,
}

/// Draws points uniformly over the surface, with the normals of their triangles, moves them by
/// Gaussian noise, and makes a surface of the points alone: marching cubes of the signed distance to
/// the algebraic sphere that is fitted around each corner of a grid (`fit`). Of the old mesh nothing
/// stays but where its surface was, to within the noise.
///
/// Where sheets are nearer to each other than some cells the new surface may have holes, as scans
/// have.
///
/// # Errors
/// [`AttackError::NoSurface`].
pub fn scan(target: &Target<'_>, how: &Scanning, seed: u64) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let diagonal = surface.diagonal();
    let cell = diagonal / how.cells;
    let mut random = Random::new(seed);
    let (samples, area) = samples(surface, how.points, how.noise * diagonal, &mut random);
    target.go_on()?;
    let spacing = (area / how.points.max(1) as f64).sqrt();
    let low = surface.positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let shift = DVec3::from_array(std::array::from_fn(|_| random.share()));
    let grid = Grid::new(low - cell * shift, cell);
    let mut cells: Vec<u64> = samples.iter().map(|sample| grid.cell_of(sample.place)).collect();
    cells.sort_unstable();
    cells.dedup();
    let fit = Fit::new(&samples, low, (REACH * spacing).max(LEAST_REACH * cell));
    let new = extract(&grid, &grown(&cells), SLACK, |place| fit.distance(place))?;
    parts::without_crumbs(&new, LEAST_PART)
}

/// The points, and the area of the surface.
fn samples(surface: &Surface, count: usize, noise: f64, random: &mut Random) -> (Vec<Sample>, f64) {
    let corners = |t: &[u32; 3]| t.map(|v| surface.positions[v as usize]);
    let mut total = 0.0;
    let sums: Vec<f64> = surface
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = corners(t);
            total += doubled_area(a, b, c).length() / 2.0;
            total
        })
        .collect();
    let last = sums.len() - 1;
    let draw = |_| {
        let area = total * random.share();
        let triangle = sums.partition_point(|&sum| sum <= area).min(last);
        let [a, b, c] = corners(&surface.triangles[triangle]);
        // Uniform in a triangle: Turk, *Generating random points in triangles*, Graphics Gems, 1990.
        let (root, share) = (random.share().sqrt(), random.share());
        let on = a * (1.0 - root) + b * (root * (1.0 - share)) + c * (root * share);
        let off = noise * DVec3::from_array(std::array::from_fn(|_| random.normal()));
        Sample { place: on + off, normal: doubled_area(a, b, c).normalize_or_zero() }
    };
    ((0..count).map(draw).collect(), total)
}
