//! Exact placement: the point of a sphere with the least quadric error (method section 4, beyond
//! the paper, which calls the constrained minimum too hard in its section 3.3).
//!
//! With `p = v - o` the vertex relative to the centre and `d` its displacement, minimise
//! `d^T B d`, `B = A + lambda tr(A) I`, subject to `|p + d| = rho'`. This is an
//! equality-constrained trust-region problem: `x = p + d = (B + mu I)^-1 B p` for the one
//! `mu > -b_min` at which `|x| = rho'`, and `|x|` falls monotonically with `mu`. Newton's method on
//! `1 / |x| - 1 / rho'`, which is nearly linear in `mu` (More and Sorensen 1983), needs two to four
//! steps for the moves of a watermark.

use glam::{DMat3, DVec3};

use crate::mesh::quadric::Quadric;

/// The usual `lambda` of the objective: the share of the plain squared displacement. It picks the
/// nearest of otherwise equal points on a flat surface.
pub const LAMBDA: f64 = 0.01;

/// Newton steps at the most.
const MAX_STEPS: usize = 40;

/// Relative precision of the distance that is asked for.
const TOLERANCE: f64 = 1e-13;

/// `B = A + lambda tr(A) I`.
#[must_use]
pub fn stiffness(quadric: &Quadric, lambda: f64) -> DMat3 {
    quadric.matrix() + DMat3::from_diagonal(DVec3::splat(lambda * quadric.trace()))
}

/// The point at distance `new_rho` from the origin that minimises `(x - p)^T B (x - p)`, for a
/// positive definite `B`. `None` when no root is found (a vertex at the centre, or `p` without a
/// part along the softest axis and a move too long for the others: the caller has radial
/// placement to fall back on).
#[must_use]
pub fn on_sphere(b: DMat3, p: DVec3, new_rho: f64) -> Option<DVec3> {
    let pull = b * p;
    // mu must stay above -b_min, where B + mu I is singular; the root lies between.
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    let mut mu = 0.0;
    for _ in 0..MAX_STEPS {
        let shifted = b + DMat3::from_diagonal(DVec3::splat(mu));
        if !positive_definite(&shifted) {
            low = mu;
            mu = f64::midpoint(mu, if high.is_finite() { high } else { 0.0 });
            continue;
        }
        let inverse = shifted.inverse();
        let x = inverse * pull;
        let length = x.length();
        if (length - new_rho).abs() <= TOLERANCE * new_rho {
            return Some(x * (new_rho / length));
        }
        if length > new_rho {
            low = low.max(mu);
        } else {
            high = high.min(mu);
        }
        // d|x|/dmu = -x^T (B + mu I)^-1 x / |x|.
        let slope = x.dot(inverse * x) / length;
        let newton = mu + (length - new_rho) / slope * (length / new_rho);
        let inside = newton > low && newton < high;
        mu = if inside {
            newton
        } else if low.is_finite() && high.is_finite() {
            f64::midpoint(low, high)
        } else {
            return None;
        };
        if !mu.is_finite() {
            return None;
        }
    }
    None
}

/// Sylvester's criterion.
fn positive_definite(m: &DMat3) -> bool {
    let minor = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    m.x_axis.x > 0.0 && minor > 0.0 && m.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stiff(seed: f64) -> DMat3 {
        let turn = DMat3::from_euler(glam::EulerRot::ZYX, seed, 2.0 * seed, 0.7 - seed);
        turn * DMat3::from_diagonal(DVec3::new(0.06, 0.5 + seed.sin().abs(), 5.0))
            * turn.transpose()
    }

    #[test]
    fn the_place_is_on_the_sphere_and_no_other_point_of_it_costs_less() {
        for k in 0..40 {
            let b = stiff(f64::from(k) * 0.37);
            let p = DVec3::new(1.0, -0.4, 0.8 + 0.1 * f64::from(k % 7));
            for change in [-0.05, -1e-6, 1e-9, 1e-3, 0.05] {
                let rho = p.length() * (1.0 + change);
                let x = on_sphere(b, p, rho).unwrap();
                assert!((x.length() - rho).abs() <= 1e-12 * rho);
                let cost = |x: DVec3| (x - p).dot(b * (x - p));
                let best = cost(x);
                for angle in 0..60 {
                    for size in [1e-6, 1e-4, 1e-2, 0.3] {
                        let (axis, other) = x.normalize().any_orthonormal_pair();
                        let turn = f64::from(angle) * std::f64::consts::TAU / 60.0;
                        let aside = (axis * turn.cos() + other * turn.sin()) * size * rho;
                        let elsewhere = (x + aside).normalize() * rho;
                        assert!(cost(elsewhere) >= best * (1.0 - 1e-9) - 1e-22, "{k} {change}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_has_no_answer_says_so() {
        assert_eq!(on_sphere(stiff(0.1), DVec3::ZERO, 1.0), None);
    }
}
