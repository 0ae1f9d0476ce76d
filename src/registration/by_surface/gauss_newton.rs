//! One least-squares step towards the similarity under which distances along given directions
//! vanish. Point-to-plane alignment and the last refinement of vertex correspondences share it.

use glam::{DQuat, DVec3};

use crate::mesh::linear::solve;
use crate::registration::similarity::Similarity;

/// Normal equations of a small similarity of the host: rotation, logarithm of the scale, shift.
///
/// The equations move the host under the suspect's points, and the result is inverted. The noise is
/// in the suspect: in the matrix, it would pull the scale towards zero.
#[derive(Debug, Clone, Copy, Default)]
pub struct Equations {
    matrix: [[f64; 7]; 7],
    right: [f64; 7],
}

impl Equations {
    /// Adds the condition that two points agree along `direction`: `host`, a point of the host, and
    /// `suspect`, the current position of the suspect's point. `weight` is the inverse of the
    /// expected squared error.
    pub fn add(&mut self, host: DVec3, suspect: DVec3, direction: DVec3, weight: f64) {
        let turn = host.cross(direction);
        let stretch = direction.dot(host);
        let row = [turn.x, turn.y, turn.z, stretch, direction.x, direction.y, direction.z];
        let residual = direction.dot(suspect - host);
        for (i, &x) in row.iter().enumerate() {
            let wx = weight * x;
            self.right[i] += wx * residual;
            // Both halves of the matrix are filled: the compiler vectorises whole rows.
            for (entry, &y) in self.matrix[i].iter_mut().zip(&row) {
                *entry += wx * y;
            }
        }
    }

    /// The sum of two sets of equations.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        for i in 0..7 {
            self.right[i] += other.right[i];
            for j in 0..7 {
                self.matrix[i][j] += other.matrix[i][j];
            }
        }
        self
    }

    /// The similarity one step after `now`, with the same sign of scale. The scale is held where
    /// `scaled` is false. `None` where the directions do not determine the step, or it is too
    /// large.
    #[must_use]
    pub fn improved(mut self, now: &Similarity, scaled: bool) -> Option<Similarity> {
        if !scaled {
            for k in 0..7 {
                self.matrix[3][k] = 0.0;
                self.matrix[k][3] = 0.0;
            }
            self.matrix[3][3] = 1.0;
            self.right[3] = 0.0;
        }
        let [x, y, z, stretch, i, j, k] = solve(self.matrix, self.right)?;
        // A step so large leads nowhere.
        if stretch.abs() > 0.5 || DVec3::new(x, y, z).length() > 1.0 {
            return None;
        }
        let step = Similarity {
            scale: libm::exp(stretch),
            rotation: turn_by(DVec3::new(x, y, z)),
            translation: DVec3::new(i, j, k),
        };
        Some(now.then(&step.inverse())).filter(Similarity::is_valid)
    }
}

/// The rotation about `axis`, by an angle in radians that is its length.
fn turn_by(axis: DVec3) -> DQuat {
    let angle = axis.length();
    if angle <= 0.0 {
        return DQuat::IDENTITY;
    }
    let [x, y, z] = (axis * (libm::sin(0.5 * angle) / angle)).to_array();
    DQuat::from_xyzw(x, y, z, libm::cos(0.5 * angle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_along_three_directions_lead_home_quadratically() {
        let truth = Similarity {
            scale: 1.02,
            rotation: DQuat::from_scaled_axis(DVec3::new(0.05, -0.03, 0.04)),
            translation: DVec3::new(0.01, 0.02, -0.02),
        };
        let points: Vec<DVec3> = (0..30)
            .map(f64::from)
            .map(|t| DVec3::new((t * 1.7).sin(), (t * 0.6).cos(), (t * 2.9).sin()))
            .collect();
        let mut now = Similarity::IDENTITY;
        for _ in 0..5 {
            let mut equations = Equations::default();
            for (k, &p) in points.iter().enumerate() {
                equations.add(truth.apply(p), now.apply(p), DVec3::AXES[k % 3], 2.0);
            }
            now = equations.improved(&now, true).unwrap();
        }
        assert!(points.iter().all(|&p| now.apply(p).distance(truth.apply(p)) < 1e-12));
    }

    #[test]
    fn a_plane_leaves_the_way_along_it_open() {
        let mut equations = Equations::default();
        for k in 0..20 {
            let p = DVec3::new(f64::from(k), f64::from(k * k % 7), 0.0);
            equations.add(p, p, DVec3::Z, 1.0);
        }
        assert_eq!(equations.improved(&Similarity::IDENTITY, true), None);
    }
}
