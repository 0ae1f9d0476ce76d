//! Rough similarities for a suspect that is a whole: centre on centre, principal axes on principal
//! axes.

use glam::{DMat3, DQuat, DVec3};

use super::samples::Point;
use crate::mesh::linear::eigen;
use crate::registration::similarity::Similarity;

/// Centre, size and principal axes of points.
struct Moments {
    centre: DVec3,
    size: f64,
    axes: DMat3,
    /// The moments, descending, in the order of the axes.
    values: [f64; 3],
}

/// Two moments are alike from this ratio on. The directions of their axes within their plane are
/// then arbitrary.
const ALIKE: f64 = 0.85;

/// Rotations about the odd axis where two moments are alike: steps of 5 degrees, half of a tooth of
/// a gear of 36.
const AROUND: u32 = 72;

fn moments(points: &[Point]) -> Option<Moments> {
    let share = 1.0 / points.len().max(1) as f64;
    let centre = points.iter().map(|p| p.position).sum::<DVec3>() * share;
    let mut covariance = [[0.0; 3]; 3];
    for p in points {
        let d = (p.position - centre).to_array();
        for (row, x) in covariance.iter_mut().zip(d) {
            row.iter_mut().zip(d).for_each(|(entry, y)| *entry += share * x * y);
        }
    }
    let (values, vectors) = eigen(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| values[j].total_cmp(&values[i]));
    let [x, y, _] = order.map(|k| DVec3::from_array(vectors[k]));
    let values = order.map(|k| values[k]);
    let size = values.iter().sum::<f64>().sqrt();
    let axes = DMat3::from_cols(x, y, x.cross(y));
    (size.is_normal() && axes.is_finite()).then_some(Moments { centre, size, axes, values })
}

/// The similarities that bring the moments of `suspect` onto those of `host`. First the 24
/// rotations that take axes to axes, beginning with those that keep the order of the axes: where
/// two moments are alike, their order means nothing. Then, where two moments are alike, rotations
/// about the third axis.
#[must_use]
pub fn by_moments(host: &[Point], suspect: &[Point], mirrored: bool) -> Vec<Similarity> {
    let (Some(h), Some(s)) = (moments(host), moments(suspect)) else { return Vec::new() };
    let scale = if mirrored { -h.size / s.size } else { h.size / s.size };
    let place = |turn: DMat3| {
        let rotation = DQuat::from_mat3(&(h.axes * turn * s.axes.transpose())).normalize();
        let translation = h.centre - rotation * s.centre * scale;
        Similarity { scale, rotation, translation }
    };
    let around = h.odd_axis().filter(|_| s.odd_axis().is_some()).map(around).unwrap_or_default();
    turns().into_iter().chain(around).map(place).filter(Similarity::is_valid).collect()
}

impl Moments {
    /// The axis of the one moment that differs where two are alike; `None` where no two are alike,
    /// or all are.
    fn odd_axis(&self) -> Option<usize> {
        let [most, middle, least] = self.values;
        match (middle >= ALIKE * most, least >= ALIKE * middle) {
            (true, false) => Some(2),
            (false, true) => Some(0),
            _ => None,
        }
    }
}

/// Rotations about an axis of a box, upright and upside down.
fn around(axis: usize) -> Vec<DMat3> {
    let [x, y, z] = [0, 1, 2].map(|k| DMat3::IDENTITY.col((axis + k) % 3));
    let step = std::f64::consts::TAU / f64::from(AROUND);
    // A change of basis to the axes in this order, and back.
    let (to, back) = (DMat3::from_cols(x, y, z), DMat3::from_cols(x, y, z).transpose());
    let turned = |k: u32, over: f64| {
        let (sine, cosine) = libm::sincos(f64::from(k) * step);
        let columns = [
            DVec3::new(over, 0.0, 0.0),
            DVec3::new(0.0, cosine, sine),
            over * DVec3::new(0.0, -sine, cosine),
        ];
        to * DMat3::from_cols(columns[0], columns[1], columns[2]) * back
    };
    // Quarter turns are among the 24.
    let between = (0..AROUND).filter(|k| !k.is_multiple_of(AROUND / 4));
    between.flat_map(|k| [turned(k, 1.0), turned(k, -1.0)]).collect()
}

/// The 24 rotations of the cube.
fn turns() -> Vec<DMat3> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let orders = [[0, 1], [1, 0], [0, 2], [2, 1], [1, 2], [2, 0]];
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let turn = |[i, j]: [usize; 2], (a, b): (f64, f64)| {
        let (x, y) = (a * axes[i], b * axes[j]);
        DMat3::from_cols(x, y, x.cross(y))
    };
    orders.into_iter().flat_map(|order| signs.map(|sign| turn(order, sign))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::by_surface::samples::scatter;
    use crate::registration::shape::Shape;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;

    #[test]
    fn one_of_the_turns_is_the_right_one() {
        let shape = Shape::new(Surface::new(&Sample::Blob.mesh(3000).unwrap())).unwrap();
        let host = scatter(&shape, 3000);
        for scale in [0.3, -4.0] {
            let place = awkward(scale);
            let moved = |p: &Point| Point { position: place.apply(p.position), ..*p };
            let suspect: Vec<Point> = host.iter().map(moved).collect();
            let found = by_moments(&host, &suspect, scale < 0.0);
            // Two moments of the blob are nearly alike.
            assert_eq!(found.len(), 24 + 2 * 68);
            let error = |s: &Similarity| s.apply(place.apply(DVec3::ONE)).distance(DVec3::ONE);
            assert_eq!(found.iter().filter(|s| error(s) < 1e-9).count(), 1);
        }
        assert!(by_moments(&host, &[], false).is_empty());
    }
}
