//! The cubic grid that carries the signs, and the spline that spreads a sign over its cell.

use glam::{DVec3, IVec3};

/// Cells along each axis that a point belongs to: a quadratic B-spline is three cells wide.
const SUPPORT: usize = 3;

/// Cells that a point belongs to.
pub(super) const AROUND: usize = SUPPORT * SUPPORT * SUPPORT;

/// Parts of a cell's side; points within one part are grouped together.
const PARTS: i32 = 2;

/// Marks a cell that the host does not have.
const NONE: u32 = u32::MAX;

/// Width of the rim around a host, in cells: a point touches the neighbours of its own cell.
const RIM: f64 = 2.0;

/// Grid cells that a set of points touches, numbered by their places in the order x, y, z.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    /// Centre of the first cell, in the unit of positions.
    origin: DVec3,
    /// Side of a cell, in the unit of positions.
    side: f64,
    /// Number of cells along each axis.
    sizes: IVec3,
    /// Per place of the grid, the number of the cell there, or [`NONE`].
    numbers: Vec<u32>,
    count: usize,
}

/// Where a point lies in the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CellPlace {
    /// The middle one of the cells that the point belongs to.
    middle: IVec3,
    /// Offset from that cell's centre, in cells, each coordinate in [-1/2, 1/2].
    offset: DVec3,
}

fn axis(x: i32) -> usize {
    usize::try_from(x).unwrap_or(0)
}

impl Cells {
    /// The cells of side `side` that the points touch. The bounding box of the points must not be
    /// longer than a thousand cells.
    #[must_use]
    pub(super) fn new(points: &[DVec3], side: f64) -> Self {
        let bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = points.iter().fold(bounds, |(low, high), &p| (low.min(p), high.max(p)));
        let origin = low - DVec3::splat(RIM * side);
        let sizes = ((high - low) / side).ceil().as_ivec3() + IVec3::splat(6);
        let places = axis(sizes.x) * axis(sizes.y) * axis(sizes.z);
        let mut cells = Self { origin, side, sizes, numbers: vec![NONE; places], count: 0 };
        for p in points {
            let middle = cells.place(*p).middle;
            for at in cells.around(middle) {
                if let Some(number) = cells.numbers.get_mut(at) {
                    *number = 0;
                }
            }
        }
        let mut next = 0;
        for number in cells.numbers.iter_mut().filter(|number| **number != NONE) {
            *number = next;
            next += 1;
        }
        cells.count = usize::try_from(next).unwrap_or(0);
        cells
    }

    /// How many cells there are.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Side of a cell.
    pub(super) fn side(&self) -> f64 {
        self.side
    }

    /// The place of a point.
    pub(super) fn place(&self, p: DVec3) -> CellPlace {
        let at = (p - self.origin) / self.side;
        let middle = at.round();
        CellPlace { middle: middle.as_ivec3(), offset: at - middle }
    }

    /// An index of the part of a cell that a point lies in. Points of one part belong to the same
    /// cells.
    pub(super) fn part(place: &CellPlace) -> u64 {
        let fine = (f64::from(PARTS) * (place.offset + DVec3::splat(0.5))).floor().as_ivec3();
        let fine = fine.clamp(IVec3::ZERO, IVec3::splat(PARTS - 1));
        let at = place.middle * PARTS + fine;
        (axis(at.x) as u64) << 42 | (axis(at.y) as u64) << 21 | axis(at.z) as u64
    }

    /// Numbers of the cells that a point at a place belongs to, in the order of [`weights`]; `u32::MAX`
    /// for cells that the host does not have.
    pub(super) fn numbers(&self, place: &CellPlace) -> [u32; AROUND] {
        let around = self.around(place.middle);
        around.map(|at| self.numbers.get(at).copied().unwrap_or(NONE))
    }

    /// Indices of the cells around the middle one, in the order of [`weights`].
    fn around(&self, middle: IVec3) -> [usize; AROUND] {
        let low = middle - IVec3::ONE;
        let inside = low.cmpge(IVec3::ZERO).all() && (middle + IVec3::ONE).cmplt(self.sizes).all();
        let mut all = [usize::MAX; AROUND];
        if !inside {
            return all;
        }
        let (across, along) = (axis(self.sizes.y) * axis(self.sizes.z), axis(self.sizes.z));
        let first = axis(low.x) * across + axis(low.y) * along + axis(low.z);
        for (k, at) in all.iter_mut().enumerate() {
            *at = first + k / 9 * across + k / 3 % 3 * along + k % 3;
        }
        all
    }

    /// `sum_c B_c(p) B_c(q)` of two points given by their places and weights.
    pub(super) fn common(
        (p, of_p): (&CellPlace, &[f64; AROUND]),
        (q, of_q): (&CellPlace, &[f64; AROUND]),
    ) -> f64 {
        let apart = q.middle - p.middle;
        if apart == IVec3::ZERO {
            return of_p.iter().zip(of_q).map(|(a, b)| a * b).sum();
        }
        if apart.abs().max_element() >= 3 {
            return 0.0;
        }
        let mut sum = 0.0;
        for (k, a) in (0..).zip(of_p) {
            let at = IVec3::new(k / 9, k / 3 % 3, k % 3) - apart;
            if at.cmpge(IVec3::ZERO).all() && at.cmplt(IVec3::splat(3)).all() {
                sum += a * of_q.get(axis(at.x * 9 + at.y * 3 + at.z)).copied().unwrap_or(0.0);
            }
        }
        sum
    }
}

/// The quadratic B-spline for the cells before, at and after a point.
fn spline(offset: f64) -> [f64; SUPPORT] {
    let (below, above) = (0.5 - offset, 0.5 + offset);
    [0.5 * below * below, 0.75 - offset * offset, 0.5 * above * above]
}

/// The weights of the signs of the cells that a point belongs to in the field there; they add up to 1.
pub(super) fn weights(place: &CellPlace) -> [f64; AROUND] {
    let [x, y, z] = place.offset.to_array().map(spline);
    let mut all = [0.0; AROUND];
    let mut next = all.iter_mut();
    for a in x {
        for b in y {
            for (c, weight) in z.into_iter().zip(&mut next) {
                *weight = a * b * c;
            }
        }
    }
    all
}
