//! A host's surface as surfels of equal area, and a grid that gives the nearest one. Serves the
//! many searches of rough alignment, which only need to know about where the surface is.
//!
//! A search in the tree of all triangles takes longer the farther the point is from the surface and
//! the finer the triangles are: 15 us on a scan of 900,000 triangles. A look-up in the grid is the
//! same few memory accesses on any mesh, even on one of overlapping slivers.

use glam::DVec3;

use super::icp::{AlignmentTarget, Touch, same_side};
use super::samples::{Point, scatter_until};
use crate::mesh::stop::{STEP, Stop, go_on};
use crate::mesh::surface::doubled_area;
use crate::registration::by_vertices::one_rings::NONE;
use crate::registration::shape::Shape;
use crate::registration::similarity::Similarity;

/// Number of surfels of a host.
const SURFELS: usize = 15_000;

/// Points farther outside of the host's box than this share of its diagonal touch nothing.
pub const MARGIN: f64 = 0.08;

/// Cells along the diagonal of the host's box; at most 210,000 in all, for a cube.
const CELLS: f64 = 80.0;

/// Cells around a point; a look-up reads all of them.
const CELLS_AROUND: u64 = 8;

/// A surfel's radius relative to the side of a square that has the surfel's share of the area. With
/// this radius, surfels at random positions leave few holes.
const RADIUS: f64 = 1.5;

/// A host's surfels, and the nearest of them to each cell of a grid.
pub struct Surfels {
    all: Vec<Point>,
    radius: f64,
    low: DVec3,
    counts: [usize; 3],
    nearest: Vec<u32>,
}

impl Surfels {
    /// Spreads surfels over the surface; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new(host: &Shape, stop: Stop<'_>) -> Option<Self> {
        let all = scatter_until(host, SURFELS, stop)?;
        let corners = |t: &[u32; 3]| t.map(|v| host.positions[v as usize]);
        let doubled = |[a, b, c]: [DVec3; 3]| doubled_area(a, b, c).length();
        let mut area = 0.0;
        for step in host.triangles.chunks(STEP) {
            go_on(stop)?;
            area = step.iter().fold(area, |sum, t| sum + 0.5 * doubled(corners(t)));
        }
        let (mut low, mut high) = (DVec3::ZERO, DVec3::ZERO);
        for &p in &host.positions {
            (low, high) = (low.min(p), high.max(p));
        }
        let (low, high) = (low - MARGIN, high + MARGIN);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a shape's diagonal is 1"
        )]
        let counts = ((high - low) * CELLS).to_array().map(|n| n as usize + 1);
        let mut grid = Self {
            radius: RADIUS * (area / all.len().max(1) as f64).sqrt(),
            nearest: vec![NONE; counts.iter().product()],
            all,
            low,
            counts,
        };
        go_on(stop)?;
        grid.seed();
        // After two rounds, one cell in thousands has its second nearest surfel instead of the
        // nearest.
        for _ in 0..2 {
            go_on(stop)?;
            grid.propagate();
        }
        Some(grid)
    }

    /// Enters each surfel in the cell that it lies in.
    fn seed(&mut self) {
        for number in (0..).take(self.all.len()) {
            let at = (self.all[number as usize].position - self.low) * CELLS;
            if let Some(cell) = self.cell(at.floor()) {
                self.enter(cell, number);
            }
        }
    }

    /// Propagates surfels from cell to cell, forwards and backwards (Danielsson 1980).
    fn propagate(&mut self) {
        let [nx, ny, nz] = self.counts;
        let cells = nx * ny * nz;
        let offsets = [1, nx, nx * ny];
        for order in [false, true] {
            for k in 0..cells {
                let cell = if order { cells - 1 - k } else { k };
                let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
                for (axis, &offset) in offsets.iter().enumerate() {
                    let inside =
                        if order { at[axis] + 1 < self.counts[axis] } else { at[axis] > 0 };
                    if inside {
                        let from = if order { cell + offset } else { cell - offset };
                        self.enter(cell, self.nearest[from]);
                    }
                }
            }
        }
    }

    /// Enters a surfel in a cell if it is nearer to the cell's centre than the cell's current
    /// surfel.
    fn enter(&mut self, cell: usize, number: u32) {
        let Some(surfel) = self.all.get(number as usize) else { return };
        let [nx, ny, _] = self.counts;
        let at = [cell % nx, cell / nx % ny, cell / (nx * ny)].map(|n| n as f64 + 0.5);
        let middle = self.low + DVec3::from_array(at) / CELLS;
        let far = |p: &Point| p.position.distance_squared(middle);
        let known = self.all.get(self.nearest[cell] as usize);
        if known.is_none_or(|known| far(surfel) < far(known)) {
            self.nearest[cell] = number;
        }
    }

    /// The number of the cell with these coordinates; `None` outside the grid.
    fn cell(&self, at: DVec3) -> Option<usize> {
        let [nx, ny, nz] = self.counts;
        let inside =
            at.cmpge(DVec3::ZERO).all() && at.x < nx as f64 && at.y < ny as f64 && at.z < nz as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "inside the grid"
        )]
        let [x, y, z] = at.to_array().map(|c| c as usize);
        inside.then_some((z * ny + y) * nx + x)
    }
}

impl AlignmentTarget for Surfels {
    /// The nearest surfel that faces the same way, among those of the eight cells around the point.
    fn touch(&self, s: &Similarity, point: &Point, reach: f64, tests: &mut u64) -> Option<Touch> {
        *tests += CELLS_AROUND;
        let placed = s.apply(point.position);
        let at = ((placed - self.low) * CELLS - 0.5).floor();
        let mut best: Option<(f64, &Point)> = None;
        for corner in 0..CELLS_AROUND {
            let step = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 1.0 } else { 0.0 });
            let Some(cell) = self.cell(at + DVec3::from_array(step)) else { continue };
            let Some(surfel) = self.all.get(self.nearest[cell] as usize) else { continue };
            let far = surfel.position.distance_squared(placed);
            if best.is_none_or(|(least, _)| far < least) && same_side(s, point, surfel.normal) {
                best = Some((far, surfel));
            }
        }
        let (_, &Point { position, normal }) = best?;
        let away = placed - position;
        let along = away - away.dot(normal) * normal;
        let closest = position + along.clamp_length_max(self.radius);
        (placed.distance(closest) < reach).then_some(Touch { placed, closest, normal })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::stop::never;
    use crate::mesh::surface::Surface;
    use crate::registration::by_surface::icp::IcpTarget;
    use crate::registration::by_surface::samples::scatter;
    use crate::sample::Sample;

    fn shape(mesh: &Mesh) -> Shape {
        Shape::new(Surface::new(mesh)).unwrap()
    }

    #[test]
    fn discs_are_about_where_the_surface_is() {
        for sample in [Sample::Blob, Sample::Knot] {
            let host = shape(&sample.mesh(4000).unwrap());
            let (surfels, target) =
                (Surfels::new(&host, &never).unwrap(), IcpTarget::new(&host, &never).unwrap());
            let mut errors = Vec::new();
            for height in [-0.03, -0.01, 0.0, 0.01, 0.03, 0.06] {
                for point in scatter(&host, 500) {
                    let position = point.position + height * point.normal;
                    let above = Point { position, ..point };
                    let touch = |ground: &dyn AlignmentTarget| {
                        let touch = ground.touch(&Similarity::IDENTITY, &above, MARGIN, &mut 0)?;
                        Some(touch.placed.distance(touch.closest))
                    };
                    let Some(exact) = touch(&target) else { continue };
                    let rough = touch(&surfels).unwrap();
                    // A surfel's centre lies on the surface.
                    assert!(rough > exact - surfels.radius, "{rough} {exact}");
                    errors.push((rough - exact).abs());
                }
            }
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!(errors.len() > 2000 && mean < 1e-3, "{} {mean}", errors.len());
        }
    }

    #[test]
    fn what_faces_elsewhere_or_lies_outside_touches_nothing() {
        let host = shape(&Sample::Blob.mesh(1000).unwrap());
        let surfels = Surfels::new(&host, &never).unwrap();
        for point in scatter(&host, 100) {
            let inside_out = Point { normal: -point.normal, ..point };
            let [far, nowhere] = [2.0, f64::NAN]
                .map(|to| Point { position: point.position + DVec3::splat(to), ..point });
            for lost in [inside_out, far, nowhere] {
                assert!(surfels.touch(&Similarity::IDENTITY, &lost, 0.01, &mut 0).is_none());
            }
        }
    }
}
