//! Similarities, and the one that fits pairs of points best.

use glam::{DQuat, DVec3};

use crate::mesh::linear::eigen;

/// `x -> scale * rotation * x + translation`.
///
/// A negative scale is a mirror image: a reflection through a point, the one reflection that needs
/// no axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Factor of all lengths; negative for a mirror image, never zero.
    pub scale: f64,
    /// The rotation, a unit quaternion.
    pub rotation: DQuat,
    /// Where the origin goes.
    pub translation: DVec3,
}

impl Similarity {
    /// Leaves everything where it is.
    pub const IDENTITY: Self =
        Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Where `p` goes.
    #[must_use]
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * p * self.scale + self.translation
    }

    /// The direction `d` under the similarity; mirrored for a mirror image.
    #[must_use]
    pub fn turn(&self, d: DVec3) -> DVec3 {
        self.rotation * d * self.scale.signum()
    }

    /// The inverse similarity.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (self.scale.recip(), self.rotation.inverse());
        Self { scale, rotation, translation: rotation * -self.translation * scale }
    }

    /// First `self`, then `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            scale: self.scale * next.scale,
            rotation: (next.rotation * self.rotation).normalize(),
            translation: next.apply(self.translation),
        }
    }

    /// About the largest distance between the images of a point of the unit box under the two
    /// similarities.
    #[must_use]
    pub fn apart(&self, other: &Self) -> f64 {
        let apart = |&p: &DVec3| self.apply(p).distance(other.apply(p));
        DVec3::AXES.iter().chain(&[DVec3::ZERO]).map(apart).fold(0.0, f64::max)
    }

    /// Whether all its numbers are finite and the scale is not zero.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.scale.is_normal() && self.rotation.is_finite() && self.translation.is_finite()
    }
}

/// A pair of points that ought to coincide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// The suspect's point.
    pub from: DVec3,
    /// The host's point.
    pub to: DVec3,
    /// The weight of the pair, at least 0.
    pub weight: f64,
}

/// The similarity that takes `from` to `to` with the least weighted squares (Horn 1987), a mirror
/// image if `mirrored`.
///
/// The noise is in the suspect, so the squares are taken in the suspect's space. The scale is
/// `sum(w b.b) / sum(w b.R a)` and not `sum(w b.R a) / sum(w a.a)`, which noise in `a` makes too
/// small: by 0.06 % for noise of 0.5 % on a fragment of a fifth of the diagonal.
///
/// `None` for fewer than three pairs, or points that do not fix a similarity.
#[must_use]
pub fn fit(pairs: &[Pair], mirrored: bool) -> Option<Similarity> {
    let sign = if mirrored { -1.0 } else { 1.0 };
    let (mut weight, mut a_mean, mut b_mean) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for p in pairs {
        weight += p.weight;
        a_mean += p.weight * p.from;
        b_mean += p.weight * p.to;
    }
    if pairs.len() < 3 || weight.is_nan() || weight <= 0.0 {
        return None;
    }
    a_mean /= weight;
    b_mean /= weight;
    // Rows: the sums of w a_x b, w a_y b and w a_z b.
    let (mut rows, mut b_square) = ([DVec3::ZERO; 3], 0.0);
    for p in pairs {
        let (a, b) = (sign * (p.from - a_mean), p.to - b_mean);
        let wb = p.weight * b;
        rows[0] += a.x * wb;
        rows[1] += a.y * wb;
        rows[2] += a.z * wb;
        b_square += wb.dot(b);
    }
    let rotation = best_rotation(rows)?;
    let along: f64 =
        DVec3::AXES.iter().zip(rows).map(|(&axis, row)| (rotation * axis).dot(row)).sum();
    let scale = sign * b_square / along;
    let translation = b_mean - rotation * a_mean * scale;
    let found = Similarity { scale, rotation, translation };
    (along > 0.0 && found.is_valid()).then_some(found)
}

/// The rotation `R` that makes `sum(b . R a)` largest: the top eigenvector of Horn's matrix. `None`
/// when it is not the only one (points on a line).
fn best_rotation([x, y, z]: [DVec3; 3]) -> Option<DQuat> {
    let n = [
        [x.x + y.y + z.z, y.z - z.y, z.x - x.z, x.y - y.x],
        [y.z - z.y, x.x - y.y - z.z, x.y + y.x, z.x + x.z],
        [z.x - x.z, x.y + y.x, y.y - x.x - z.z, y.z + z.y],
        [x.y - y.x, z.x + x.z, y.z + z.y, z.z - x.x - y.y],
    ];
    let (values, vectors) = eigen(n);
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&i, &j| values[j].total_cmp(&values[i]));
    let [top, next, ..] = order;
    let [w, i, j, k] = vectors[top];
    let unique = values[top] - values[next] > 1e-9 * values[top].abs();
    let q = DQuat::from_xyzw(i, j, k, w);
    (unique && q.is_finite() && q.length_squared() > 0.5).then(|| q.normalize())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn awkward(scale: f64) -> Similarity {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -2.1, 1.3);
        Similarity { scale, rotation, translation: DVec3::new(11.0, -4.0, 0.5) }
    }

    fn points(count: u32) -> impl Iterator<Item = DVec3> {
        (0..count).map(|i| {
            let t = f64::from(i);
            DVec3::new(libm::sin(t * 1.7), libm::cos(t * 0.6) * 2.0, libm::sin(t * 2.9) * 0.5)
        })
    }

    #[test]
    fn pairs_give_back_the_similarity_mirrored_or_not() {
        for scale in [0.01, 3.0, -2.0] {
            let truth = awkward(scale);
            let pairs: Vec<Pair> =
                points(5).map(|p| Pair { from: p, to: truth.apply(p), weight: 0.3 }).collect();
            let found = fit(&pairs, scale < 0.0).unwrap();
            assert!(points(20).all(|p| found.apply(p).distance(truth.apply(p)) < 1e-12 * scale.abs().max(1.0)));
            assert!((found.scale / scale - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn there_and_back_is_nowhere() {
        let truth = awkward(-2.5);
        let back = truth.then(&truth.inverse());
        assert!(points(9).all(|p| back.apply(p).distance(p) < 1e-13));
    }

    #[test]
    fn noise_in_the_suspect_does_not_shrink_it() {
        let noise =
            |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 23) - 1.0;
        let pairs: Vec<Pair> = (0_u32..)
            .zip(points(60_000))
            .map(|(i, p)| {
                let rough = DVec3::new(noise(3 * i), noise(3 * i + 1), noise(3 * i + 2));
                Pair { from: p + 0.3 * rough, to: p, weight: 1.0 }
            })
            .collect();
        let found = fit(&pairs, false).unwrap();
        assert!((found.scale - 1.0).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn a_line_fixes_no_rotation_and_a_point_nothing() {
        let line = |t: f64| Pair { from: DVec3::X * t, to: DVec3::Y * t, weight: 1.0 };
        assert_eq!(fit(&[line(0.0), line(1.0), line(2.0)], false), None);
        assert_eq!(fit(&[line(1.0), line(1.0), line(1.0)], false), None);
        assert_eq!(fit(&[], false), None);
    }
}
