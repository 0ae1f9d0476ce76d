//! The search for the centre about which to embed so that the result has that same centre.
//!
//! An embedding about `o` moves the centre to `F(o)`, and the blind reader computes the bins about
//! `F(o)`. The search is for the fixed point of `F`. Plain iteration `o <- F(o)` contracts on most
//! meshes. Where norms crowd at bin edges, as on CAD parts with large flat faces, a small step of `o`
//! changes `F` by more than the step, and the iteration diverges (measured on a hammer of 30,000
//! vertices: 0.07, 0.19, 0.26, 0.48 bin widths). Broyden's method (1965) solves `G(o) = F(o) - o = 0`
//! instead. It learns the 3 x 3 slope from the steps of the iteration.

use glam::{DMat3, DVec3};

/// Broyden's iteration in three dimensions.
#[derive(Debug, Clone)]
pub struct FixedPoint {
    /// Estimate of `dG/do`.
    slope: DMat3,
    at: DVec3,
    last: Option<(DVec3, DVec3)>,
    longest_step: f64,
}

impl FixedPoint {
    /// Starts at `start`; no step is longer than `longest_step`.
    #[must_use]
    pub fn new(start: DVec3, longest_step: f64) -> Self {
        // G falls with slope -1 where F is constant, so the first step is that of the plain iteration.
        Self { slope: -DMat3::IDENTITY, at: start, last: None, longest_step }
    }

    /// Where to evaluate `F` next.
    #[must_use]
    pub fn at(&self) -> DVec3 {
        self.at
    }

    /// Takes `F(at())` as `image` and makes the next step.
    pub fn learn(&mut self, image: DVec3) {
        let residual = image - self.at;
        if let Some((before, residual_before)) = self.last {
            let step = self.at - before;
            let error = residual - residual_before - self.slope * step;
            if step.length_squared() > 0.0 {
                self.slope += outer(error, step / step.length_squared());
            }
        }
        self.last = Some((self.at, residual));
        let newton = -(self.slope.inverse() * residual);
        // A singular slope gives no usable step; the step is then taken as if F were constant.
        let sound = newton.is_finite() && newton.length() <= self.longest_step;
        let step = if sound { newton } else { residual };
        self.at += step.clamp_length_max(self.longest_step);
    }
}

/// `a b^T`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_fixed_points_from_which_plain_iteration_runs_away() {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, 0.9, -0.3);
        let target = DVec3::new(0.3, -0.2, 0.5);
        for stretch in [0.2, -0.9, -3.0, 2.5] {
            let image = |o: DVec3| {
                let d = o - target;
                target + turn * d * stretch + DVec3::splat(0.3 * d.length_squared())
            };
            let mut search = FixedPoint::new(DVec3::ZERO, 10.0);
            for _ in 0..25 {
                search.learn(image(search.at()));
            }
            assert!((search.at() - target).length() < 1e-9, "{stretch}: {}", search.at());
        }
    }
}
