//! A cubic grid of which only a few cells are used.
//!
//! The key of a cell is the key of its lowest corner. Keys ascend by x, y and z.

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::surface::Surface;

/// Bits per coordinate of a key.
const BITS: u32 = 21;
/// The coordinate of the origin, so that cells on both sides of it have keys.
const MIDDLE: f64 = 1_048_576.0; // 2^20

/// What a step along each axis adds to a key.
const STEPS: [u64; 3] = [1 << (2 * BITS), 1 << BITS, 1];

/// Where the grid lies and how large its cells are.
#[derive(Debug, Clone, Copy)]
pub struct Grid {
    origin: DVec3,
    cell: f64,
}

impl Grid {
    /// A grid with cells of size `cell`, one of which has its lowest corner at `origin`.
    pub fn new(origin: DVec3, cell: f64) -> Self {
        Self { origin, cell }
    }

    /// The size of its cells.
    pub fn cell(&self) -> f64 {
        self.cell
    }

    /// The cell that a point lies in. Points beyond 2^20 cells from the origin belong to the last
    /// cell.
    pub fn cell_of(&self, point: DVec3) -> u64 {
        let steps = ((point - self.origin) / self.cell).floor() + MIDDLE;
        let clamped = steps.clamp(DVec3::ONE, DVec3::splat(2.0 * MIDDLE - 3.0)).to_array();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        clamped.iter().zip(STEPS).map(|(&x, step)| x as u64 * step).sum()
    }

    /// The position of a corner.
    pub fn place(&self, corner: u64) -> DVec3 {
        let steps = coordinates(corner).map(|x| x as f64 - MIDDLE);
        self.origin + self.cell * DVec3::from_array(steps)
    }

    /// The line along x that a corner lies on.
    pub fn line_of(&self, corner: DVec3) -> u64 {
        self.cell_of(corner + DVec3::splat(0.5 * self.cell)) & (STEPS[0] - 1)
    }

    /// A corner on each line along x that passes through a box, and on some lines beside the box.
    pub fn lines_within(&self, low: DVec3, high: DVec3) -> impl Iterator<Item = DVec3> + use<> {
        let grid = *self;
        let low = coordinates(self.cell_of(low));
        let high = coordinates(self.cell_of(high)).map(|x| x + 1);
        (low[1]..=high[1]).flat_map(move |y| {
            (low[2]..=high[2])
                .map(move |z| grid.place(low[0] * STEPS[0] + y * STEPS[1] + z * STEPS[2]))
        })
    }
}

fn coordinates(key: u64) -> [u64; 3] {
    [2, 1, 0].map(|axis| (key >> (axis * BITS)) & ((1 << BITS) - 1))
}

/// The next corner along an axis.
pub fn next(corner: u64, axis: usize) -> u64 {
    corner + STEPS[axis]
}

/// The eight corners of a cell. Bit `k` of an index is the step along axis `k`.
pub fn around(cell: u64) -> [u64; 8] {
    std::array::from_fn(|corner| (0..3).filter(|axis| corner >> axis & 1 == 1).fold(cell, next))
}

/// All corners of cells, ascending.
pub fn corners(cells: &[u64]) -> Vec<u64> {
    let mut corners: Vec<u64> = cells.par_iter().flat_map_iter(|&cell| around(cell)).collect();
    corners.par_sort_unstable();
    corners.dedup();
    corners
}

/// `cells` and all cells around them, ascending.
pub fn grown(cells: &[u64]) -> Vec<u64> {
    let shifted = |cell: u64| {
        (0..27_u64).map(move |k| {
            [k / 9, k / 3 % 3, k % 3].iter().zip(STEPS).map(|(&by, step)| by * step).sum::<u64>()
                + cell
                - STEPS.iter().sum::<u64>()
        })
    };
    let mut all: Vec<u64> = cells.par_iter().flat_map_iter(|&cell| shifted(cell)).collect();
    all.par_sort_unstable();
    all.dedup();
    all
}

/// The cells that a surface may touch, ascending. Triangles are cut until no side is longer than a
/// cell; the cells of the bounding boxes of the pieces are taken.
pub fn touched(grid: &Grid, surface: &Surface) -> Vec<u64> {
    let corners = |t: &[u32; 3]| t.map(|v| surface.positions[v as usize]);
    let of = |t: &[u32; 3]| {
        let mut cells = Vec::new();
        let mut pieces = vec![corners(t)];
        while let Some(piece) = pieces.pop() {
            if let Some(halves) = halves(piece, grid.cell) {
                pieces.extend(halves);
            } else {
                boxed(grid, piece, &mut cells);
            }
        }
        cells.sort_unstable();
        cells.dedup();
        cells
    };
    let mut cells: Vec<u64> =
        surface.triangles.par_iter().with_min_len(1024).flat_map_iter(of).collect();
    cells.par_sort_unstable();
    cells.dedup();
    cells
}

/// A triangle cut at the middle of its longest side; `None` if no side is longer than `most`.
fn halves([a, b, c]: [DVec3; 3], most: f64) -> Option<[[DVec3; 3]; 2]> {
    let [x, y, z] = [a.distance(b), b.distance(c), c.distance(a)];
    let longest = x.max(y).max(z);
    if longest <= most {
        return None;
    }
    let cut = |a: DVec3, b: DVec3, c: DVec3| {
        let middle = a.midpoint(b);
        Some([[a, middle, c], [middle, b, c]])
    };
    if x >= longest {
        cut(a, b, c)
    } else if y >= longest {
        cut(b, c, a)
    } else {
        cut(c, a, b)
    }
}

/// Adds the cells of a triangle's bounding box. The box is slightly enlarged, so that a corner in
/// the plane between two cells is in both.
fn boxed(grid: &Grid, [a, b, c]: [DVec3; 3], cells: &mut Vec<u64>) {
    let more = DVec3::splat(1e-9 * grid.cell);
    let low = coordinates(grid.cell_of(a.min(b).min(c) - more));
    let high = coordinates(grid.cell_of(a.max(b).max(c) + more));
    for x in low[0]..=high[0] {
        for y in low[1]..=high[1] {
            for z in low[2]..=high[2] {
                cells.push(x * STEPS[0] + y * STEPS[1] + z * STEPS[2]);
            }
        }
    }
}
