//! Which way the triangles of a closed surface face.
//!
//! Files may have all triangles turned over, because of an exporter's other handedness or an owner's
//! habit. Software that reconstructs a surface makes triangles face outward. Must not know what the
//! surface is compared with.

use super::mixing::mixed;
use super::surface::{Surface, doubled_area};

/// Least enclosed volume, as a share of the volume of the ball with the same area. The sign of a
/// smaller volume, as of a folded sheet, is not reliable.
const LEAST_VOLUME: f64 = 3e-3;

/// Whether the triangles face inward; `None` where the surface is open or encloses too little volume.
/// The volume under a part of a surface has a sign too, but not always that of the whole. Two copies of
/// one surface, one of them cut, must not disagree.
#[must_use]
pub fn faces_inward(surface: &Surface) -> Option<bool> {
    let origin = *surface.positions.first()?;
    let (mut area, mut volume) = (0.0, 0.0);
    for t in &surface.triangles {
        let [a, b, c] = t.map(|v| surface.positions[v as usize] - origin);
        let vector = 0.5 * doubled_area(a, b, c);
        area += vector.length();
        volume += vector.dot(a) / 3.0;
    }
    // The ball of this area has a volume of area^1.5 / (6 sqrt(pi)).
    let ball = area * area.sqrt() / (6.0 * std::f64::consts::PI.sqrt());
    (volume.abs() >= LEAST_VOLUME * ball && is_closed(&surface.triangles)).then_some(volume < 0.0)
}

/// Whether every side of a triangle is passed in the other direction by another triangle. Each side has
/// a hash, whose sign depends on the direction, and the hashes of a closed surface sum up to zero.
/// Those of an open surface do so with probability 2^-64.
fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let sides = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let mark = |[a, b]: [u32; 2]| {
        let side = u64::from(a.min(b)) << 32 | u64::from(a.max(b));
        let mark = mixed(side);
        if a < b { mark } else { mark.wrapping_neg() }
    };
    sides.fold(0_u64, |sum, side| sum.wrapping_add(mark(side))) == 0
}

/// The same surface with all triangles turned over.
#[must_use]
pub fn turned_over(surface: &Surface) -> Surface {
    let triangles = surface.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    Surface { triangles, ..surface.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::sample::Sample;

    #[test]
    fn generated_meshes_face_the_other_way_once_turned_over_and_parts_do_not_say() {
        for sample in Sample::ALL {
            let mesh = sample.mesh(3000).unwrap();
            let moved: Vec<_> =
                mesh.positions().iter().map(|p| *p + glam::DVec3::splat(9.0)).collect();
            let surface = Surface::new(&Mesh::new(moved, mesh.triangles().to_vec()).unwrap());
            let inward = faces_inward(&surface);
            assert!(inward.is_some(), "{sample}");
            assert_eq!(faces_inward(&turned_over(&surface)), inward.map(|x| !x), "{sample}");
            let some = mesh.triangles().iter().take(mesh.triangles().len() / 3).copied().collect();
            let part = Surface::new(&Mesh::new(mesh.positions().to_vec(), some).unwrap());
            assert_eq!(faces_inward(&part), None, "{sample}");
        }
        let corner =
            |i: u32| glam::DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
        let corners = [0, 1, 2, 4].map(corner).to_vec();
        let outward = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let surface = Surface::new(&Mesh::new(corners, outward).unwrap());
        assert_eq!(faces_inward(&surface), Some(false));
    }
}
