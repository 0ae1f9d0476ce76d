//! Keeps triangles from turning over: where moves turn one over, its corners are stiffened.
//!
//! On a dense mesh moves are as long as edges. A vertex that slides along the surface farther than its
//! neighbours turns the triangles between them over. Stiffening a vertex raises the `lambda` of its
//! objective. Its compliance falls, so it moves less. It also moves less along the surface, because
//! exact placement with a large `lambda` is radial placement, whose moves are similar among neighbours.
//! Stiffness is remembered, so the allocation of the next round takes what a bin loses from the bin's
//! other vertices. The guard costs distortion, not bits.

use super::compliance::ComplianceData;
use super::placement::PlacementSurface;
use crate::mesh::stop::{Stop, chosen, go_on, mapped};
use crate::mesh::surface::Surface;
use crate::mesh::turning::{flipped_until, is_flipped};
use glam::DVec3;

/// Factor by which a corner of a turned triangle is stiffened at a step. With 2, the hammer was
/// distorted twice as much and the dragon needed more rounds; with 4, the gear was distorted half as
/// much again. Stiffening the neighbours as well distorted the dragon half as much again.
const STIFFENING: f64 = 1.5;

/// Largest stiffness: the vertex hardly moves any more.
const STIFFEST: f64 = 1e8;

/// Largest number of steps. Turned triangles fall by a third or more from step to step: of the dragon's
/// 17,000 a handful is left after this many.
const MOST_STEPS: usize = 30;

/// The factor by which the `lambda` of each carrier is raised above the usual one.
#[derive(Debug, Default)]
pub struct Stiffness {
    /// Empty until a vertex is stiffened.
    factors: Vec<f64>,
}

impl Stiffness {
    /// The factor of a carrier, at least 1.
    #[must_use]
    pub fn of(&self, carrier: usize) -> f64 {
        self.factors.get(carrier).copied().unwrap_or(1.0)
    }

    /// Number of carriers that are stiffened: corners of triangles that moves turned over.
    #[must_use]
    pub fn stiffened(&self) -> usize {
        self.factors.iter().filter(|&&factor| factor > 1.0).count()
    }
}

/// The carriers of one pass.
#[derive(Debug)]
pub struct Moves<'a> {
    /// The assumed centre.
    pub centre: DVec3,
    /// Per carrier its norm before.
    pub rho: &'a [f64],
    /// Per carrier its norm after.
    pub new_rho: &'a mut [f64],
    /// Per carrier its place after.
    pub placed: &'a mut [DVec3],
}

/// The original surface with the data that stiffening needs.
#[derive(Debug, Clone, Copy)]
pub struct Guard<'a> {
    /// The carriers before anything moved.
    pub surface: &'a Surface,
    /// The placement of the carriers.
    pub placement: &'a PlacementSurface<'a>,
    /// Per carrier what its compliance is computed from.
    pub compliance_data: &'a [ComplianceData],
}

impl Guard<'_> {
    /// Stiffens the corners of turned triangles and moves them anew, until no triangle is turned over
    /// or the steps are spent. `None` once `stop` answers `true`.
    pub fn turn_back(
        &self,
        moves: &mut Moves<'_>,
        stiffness: &mut Stiffness,
        stop: Stop<'_>,
    ) -> Option<()> {
        let mut turned = flipped_until(self.surface, moves.placed, stop)?;
        let mut marks = Marks::new(self.surface);
        for _ in 0..MOST_STEPS {
            if turned.is_empty() {
                break;
            }
            go_on(stop)?;
            stiffness.factors.resize(moves.placed.len(), 1.0);
            let corners = marks.corners_of(self.surface, &turned);
            go_on(stop)?;
            self.stiffen(&corners, moves, stiffness, stop)?;
            // Only a triangle with a corner that moved anew can have changed.
            let touched = marks.triangles_at(self.placement, &corners);
            let placed = &*moves.placed;
            turned =
                chosen(&touched, stop, |_, &t| is_flipped(self.surface, t, placed).then_some(t))?;
        }
        Some(())
    }

    fn stiffen(
        &self,
        corners: &[u32],
        moves: &mut Moves<'_>,
        stiffness: &mut Stiffness,
        stop: Stop<'_>,
    ) -> Option<()> {
        let anew = |_, &corner: &u32| {
            let v = corner as usize;
            let (before, rho, new_rho) = (stiffness.factors[v], moves.rho[v], moves.new_rho[v]);
            let after = (before * STIFFENING).min(STIFFEST);
            if rho.to_bits() == new_rho.to_bits() {
                return (after, new_rho, moves.placed[v]);
            }
            let [soft, stiff] = [before, after].map(|factor| self.compliance_data[v].at(factor));
            // The allocation for the mean is linear in the compliance, so it would have given the
            // stiffer vertex this share of the move. For the variance the share is close.
            let share = if soft > 0.0 { stiff / soft } else { 0.0 };
            let new_rho = rho + (new_rho - rho) * share;
            (after, new_rho, self.placement.exact(moves.centre, v, rho, new_rho, after))
        };
        let anew = mapped(corners, stop, anew)?;
        for (&corner, (factor, new_rho, placed)) in corners.iter().zip(anew) {
            let v = corner as usize;
            (stiffness.factors[v], moves.new_rho[v], moves.placed[v]) = (factor, new_rho, placed);
        }
        Some(())
    }
}

/// Carriers and triangles that are listed already, so that each is listed once.
struct Marks {
    carriers: Vec<bool>,
    triangles: Vec<bool>,
}

impl Marks {
    fn new(surface: &Surface) -> Self {
        Self {
            carriers: vec![false; surface.positions.len()],
            triangles: vec![false; surface.triangles.len()],
        }
    }

    fn corners_of(&mut self, surface: &Surface, triangles: &[u32]) -> Vec<u32> {
        let corners = triangles.iter().flat_map(|&t| surface.triangles[t as usize]);
        once_each(&mut self.carriers, corners)
    }

    fn triangles_at(&mut self, placement: &PlacementSurface<'_>, carriers: &[u32]) -> Vec<u32> {
        let around = carriers.iter().flat_map(|&v| placement.adjacency.around(v as usize)).copied();
        once_each(&mut self.triangles, around)
    }
}

/// The distinct elements of `all`. Leaves `seen` as it was: all false.
fn once_each(seen: &mut [bool], all: impl Iterator<Item = u32>) -> Vec<u32> {
    let first: Vec<u32> =
        all.filter(|&i| !std::mem::replace(&mut seen[i as usize], true)).collect();
    for &i in &first {
        seen[i as usize] = false;
    }
    first
}

#[cfg(test)]
mod tests {
    use super::super::compliance::compliance_data;
    use super::*;
    use crate::mesh::stop::never;
    use crate::mesh::turning::turning;
    use crate::sample::Sample;
    use crate::watermark::bins::norms;

    #[test]
    fn turned_triangles_are_turned_back_and_the_stiffness_is_remembered() {
        let surface = Surface::new(&Sample::Blob.mesh(9000).unwrap());
        let centre = surface.centre();
        let placement = PlacementSurface::new(&surface, &never).unwrap();
        let compliance_data =
            compliance_data(&surface, &placement.quadrics, centre, &never).unwrap();
        let guard =
            Guard { surface: &surface, placement: &placement, compliance_data: &compliance_data };
        let rho = norms(&surface.positions, centre);
        // Every third vertex moves far.
        let far = |(v, rho): (usize, &f64)| if v % 3 == 0 { rho * 1.02 } else { *rho };
        let mut new_rho: Vec<f64> = rho.iter().enumerate().map(far).collect();
        let place = |v: usize| {
            if v.is_multiple_of(3) {
                placement.exact(centre, v, rho[v], new_rho[v], 1.0)
            } else {
                surface.positions[v]
            }
        };
        let mut placed: Vec<DVec3> = (0..rho.len()).map(place).collect();
        assert!(turning(&surface, &placed).flipped > 100);
        let mut stiffness = Stiffness::default();
        let moves = &mut Moves { centre, rho: &rho, new_rho: &mut new_rho, placed: &mut placed };
        guard.turn_back(moves, &mut stiffness, &never).unwrap();
        assert_eq!(turning(&surface, &placed).flipped, 0);
        for (v, (position, new_rho)) in placed.iter().zip(&new_rho).enumerate() {
            assert!(((*position - centre).length() - new_rho).abs() < 1e-12, "{v}");
            assert!((rho[v]..=rho[v] * 1.02).contains(new_rho), "{v}");
            assert!(stiffness.of(v) >= 1.0);
            assert!(v % 3 == 0 || *position == surface.positions[v]);
        }
        assert!((0..rho.len()).any(|v| stiffness.of(v) > 1.0));
        assert!((0..rho.len()).any(|v| v % 3 == 0 && stiffness.of(v) <= 1.0));
    }
}
