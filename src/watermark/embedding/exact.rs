//! Exact placement: the point of a sphere with the least quadric error (method section 4). It goes
//! beyond the paper, which calls the constrained minimum too hard in its section 3.3.
//!
//! With `p = v - o` the vertex relative to the centre and `d` its displacement, minimise `d^T B d`,
//! `B = A + lambda tr(A) I`, subject to `|p + d| = rho'`. This is an equality-constrained trust-region
//! problem: `x = p + d = (B + mu I)^-1 B p` for the one `mu > -b_min` at which `|x| = rho'`. `|x|`
//! falls monotonically with `mu`. Newton's method on `1 / |x| - 1 / rho'`, which is nearly linear in
//! `mu` (More and Sorensen 1983), needs two to four steps for the moves of a watermark.

use glam::{DMat3, DVec3};

use crate::mesh::quadric::Quadric;

/// The usual `lambda` of the objective: the share of the plain squared displacement. It picks the
/// nearest of otherwise equal points on a flat surface.
pub const LAMBDA: f64 = 0.01;

/// Largest number of Newton steps.
const MAX_STEPS: usize = 40;

/// How close the distance must come to the requested one, as a share of the change of distance. The
/// remaining error is corrected along the ray, at a cost of second order.
const TOLERANCE: f64 = 1e-6;

/// The same as a share of the distance itself, below which there is only rounding.
const ROUNDING: f64 = 1e-15;

/// `B = A + lambda tr(A) I`.
#[must_use]
pub fn penalised(quadric: &Quadric, lambda: f64) -> DMat3 {
    quadric.matrix() + DMat3::from_diagonal(DVec3::splat(lambda * quadric.trace()))
}

/// `B + mu I = L D L^T` with a unit lower triangle. The factorisation takes half the work of an inverse
/// and detects whether the matrix is positive definite.
#[derive(Debug, Clone, Copy)]
pub struct Factors {
    /// Inverses of the diagonal of `D`.
    inverse: DVec3,
    /// `L_yx, L_zx, L_zy`.
    lower: DVec3,
}

impl Factors {
    /// Factors the symmetric matrix `b + mu I`; `None` when it is not positive definite.
    #[must_use]
    pub fn new(b: &DMat3, mu: f64) -> Option<Self> {
        let x = b.x_axis.x + mu;
        let (yx, zx) = (b.x_axis.y / x, b.x_axis.z / x);
        let y = b.y_axis.y + mu - yx * b.x_axis.y;
        let zy = (b.y_axis.z - yx * b.x_axis.z) / y;
        let z = b.z_axis.z + mu - zx * b.x_axis.z - zy * zy * y;
        let definite = x > 0.0 && y > 0.0 && z > 0.0;
        definite
            .then(|| Self { inverse: DVec3::new(x, y, z).recip(), lower: DVec3::new(yx, zx, zy) })
    }

    /// `(B + mu I)^-1 v`.
    #[must_use]
    pub fn solve(&self, v: DVec3) -> DVec3 {
        let [yx, zx, zy] = self.lower.to_array();
        let y = v.y - yx * v.x;
        let z = v.z - zx * v.x - zy * y;
        let w = DVec3::new(v.x, y, z) * self.inverse;
        let y = w.y - zy * w.z;
        DVec3::new(w.x - yx * y - zx * w.z, y, w.z)
    }
}

/// The point at distance `new_rho` from the origin that minimises `(x - p)^T B (x - p)`, for a positive
/// definite `B`. `None` when no root is found: for a vertex at the centre, or where `p` has no part
/// along the softest axis and the move is too long for the other axes. The caller falls back on another
/// placement.
#[must_use]
pub fn on_sphere(b: DMat3, p: DVec3, new_rho: f64) -> Option<DVec3> {
    let pull = b * p;
    let near = (TOLERANCE * (new_rho - p.length()).abs()).max(ROUNDING * new_rho);
    // mu must stay above -b_min, where B + mu I is singular. The root lies between `low` and `high`.
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    // At mu = 0, x is p itself.
    let (mut mu, mut at_rest) = (0.0, Some(p));
    for _ in 0..MAX_STEPS {
        let Some(factors) = Factors::new(&b, mu) else {
            low = mu;
            mu = f64::midpoint(mu, if high.is_finite() { high } else { 0.0 });
            continue;
        };
        let x = at_rest.take().unwrap_or_else(|| factors.solve(pull));
        let length = x.length();
        if (length - new_rho).abs() <= near {
            return (length > 0.0).then(|| x * (new_rho / length));
        }
        if length > new_rho {
            low = low.max(mu);
        } else {
            high = high.min(mu);
        }
        // d|x|/dmu = -x^T (B + mu I)^-1 x / |x|.
        let slope = x.dot(factors.solve(x)) / length;
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
