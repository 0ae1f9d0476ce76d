//! A new surface reconstructed from points that are sampled on the old one, as by a scanner.

mod fit;
mod parts;

use glam::DVec3;

use super::isosurface::{Grid, extract, grown};
use super::{AttackError, Target};
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::surface::{Surface, doubled_area};
use fit::Fit;

/// How the surface is sampled, and how finely it is reconstructed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scanning {
    /// Number of points.
    pub points: usize,
    /// Standard deviation of the noise on each of their coordinates, as a share of the diagonal.
    pub noise: f64,
    /// Cells of the grid along the diagonal.
    pub cells: f64,
}

impl Scanning {
    /// 100,000 points and 256 cells (an octree of depth 8, usual for Poisson reconstruction), with
    /// noise of this share of the diagonal.
    #[must_use]
    pub fn with_noise(noise: f64) -> Self {
        Self { points: 100_000, noise, cells: 256.0 }
    }
}

/// Reach of a fit, in mean distances between points. It takes in about fifty points.
const REACH: f64 = 4.0;
/// Least reach of a fit, in cells. The corners of a cell that the surface passes are up to 1.7
/// cells away.
const LEAST_REACH: f64 = 2.0;

/// Largest difference between the values of two neighbouring corners of opposite sign, in cells.
/// Each corner has its own fit; distances to one surface would differ by at most 1.
const SLACK: f64 = 2.0;

/// Connected components with less than this share of the triangles are removed as noise, as is
/// usual in reconstruction from scans: between close sheets the fits leave small pieces.
const LEAST_PART: f64 = 1e-3;

/// A sampled point with its outward normal.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Its position, with noise.
    pub place: DVec3,
    /// Outward, of length 1.
    pub normal: DVec3,
}

/// Draws points uniformly over the surface, with the normals of their triangles, moves them by
/// Gaussian noise, and reconstructs a surface from the points alone. It uses marching cubes of the
/// signed distance to the algebraic sphere that is fitted around each corner of a grid (`fit`).
/// Nothing of the old mesh remains but the location of its surface, to within the noise.
///
/// Where sheets are closer to each other than a few cells, the new surface may have holes, as scans
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
