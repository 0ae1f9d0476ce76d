//! A new surface extracted from a voxel grid.

use glam::DVec3;

use super::edges::Edges;
use super::isosurface::{Grid, Winding, extract, is_closed, touched};
use super::{AttackError, Target};
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::closest::{Closest, Footpoint};
use crate::mesh::surface::{Surface, doubled_area};

/// Tolerance for rounding of distances, as a share of a cell.
const ROUNDING: f64 = 1e-6;

/// Extracts the surface anew by marching cubes from its signed distance at the corners of a cubic
/// grid. The cells measure `share` of the diagonal. The grid has the axes of the file and an offset
/// drawn from the seed. No vertex or triangle stays. Common programs call this "uniform resampling"
/// or "voxel remeshing".
///
/// In a closed surface, a corner is inside if the surface winds around it (`Winding`). Parts that
/// touch or pass through each other become one. In any other surface, a corner is inside if the
/// angle-weighted normal at its closest point faces away from it (Bærentzen and Aanæs, *Signed
/// distance computation using the angle weighted pseudonormal*, IEEE TVCG 11(3), 2005). Such a
/// surface stays open. It loses up to a cell along its borders, and along lines where it passes
/// through itself (`extract`).
///
/// # Errors
/// [`AttackError::NoSurface`], also where all parts are thinner than a cell.
pub fn voxel(target: &Target<'_>, share: f64, seed: u64) -> Result<Mesh, AttackError> {
    let surface = target.surface()?;
    let cell = share * surface.diagonal();
    let mut random = Random::new(seed);
    let shift = DVec3::from_array(std::array::from_fn(|_| random.share()));
    let low = surface.positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let grid = Grid::new(low - cell * shift, cell);
    let cells = touched(&grid, surface);
    target.go_on()?;
    let edges = target.edges()?;
    let distance = SignedDistance::new(surface, edges).ok_or(AttackError::NoSurface)?;
    if is_closed(surface, edges) {
        let winding = Winding::new(&grid, surface);
        target.go_on()?;
        extract(&grid, &cells, 1.0 + ROUNDING, |place| {
            let distance = distance.at(place).abs();
            if winding.is_inside(&grid, place) { -distance } else { distance }
        })
    } else {
        extract(&grid, &cells, 1.0 + ROUNDING, |place| distance.at(place))
    }
}

/// A surface prepared for signed distances.
struct SignedDistance<'a> {
    surface: &'a Surface,
    edges: &'a Edges,
    closest: Closest,
    of_triangles: Vec<DVec3>,
    of_edges: Vec<DVec3>,
    of_vertices: Vec<DVec3>,
}

impl<'a> SignedDistance<'a> {
    fn new(surface: &'a Surface, edges: &'a Edges) -> Option<Self> {
        let closest = Closest::new(surface)?;
        let mut of_edges = vec![DVec3::ZERO; edges.ends.len()];
        let mut of_vertices = vec![DVec3::ZERO; surface.positions.len()];
        let mut of_triangles = Vec::with_capacity(surface.triangles.len());
        for (number, triangle) in surface.triangles.iter().enumerate() {
            let corners = triangle.map(|v| surface.positions[v as usize]);
            let [a, b, c] = corners;
            let normal = doubled_area(a, b, c).normalize_or_zero();
            of_triangles.push(normal);
            for k in 0..3 {
                let [here, one, other] = [0, 1, 2].map(|by| corners[(k + by) % 3]);
                let (one, other) = (one - here, other - here);
                let angle = libm::atan2(one.cross(other).length(), one.dot(other));
                of_vertices[triangle[k] as usize] += angle * normal;
                of_edges[edges.of_side[3 * number + k]] += normal;
            }
        }
        Some(Self { surface, edges, closest, of_triangles, of_edges, of_vertices })
    }

    /// The signed distance of a point, negative inside.
    fn at(&self, point: DVec3) -> f64 {
        let foot = self.closest.footpoint(point);
        let from = point - foot.place;
        let side = from.dot(self.normal(&foot));
        if side < 0.0 { -from.length() } else { from.length() }
    }

    /// The normal of the triangle, edge or vertex that a point lies on.
    fn normal(&self, foot: &Footpoint) -> DVec3 {
        let triangle = foot.triangle as usize;
        let on = foot.weights.map(|weight| weight != 0.0);
        match on {
            [true, false, false] | [false, true, false] | [false, false, true] => {
                let corner = on.iter().position(|&on| on).unwrap_or(0);
                self.of_vertices[self.surface.triangles[triangle][corner] as usize]
            }
            [true, true, false] => self.of_edges[self.edges.of_side[3 * triangle]],
            [false, true, true] => self.of_edges[self.edges.of_side[3 * triangle + 1]],
            [true, false, true] => self.of_edges[self.edges.of_side[3 * triangle + 2]],
            _ => self.of_triangles[triangle],
        }
    }
}
