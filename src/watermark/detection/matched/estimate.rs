//! Bits from correlations: the least squares behind the matched filter.
//!
//! Must not know meshes.

/// Least ridge, as a share of each bin's energy; and the share of the mean energy below which a bin is
/// an erasure.
pub(super) const LEAST_RIDGE: f64 = 0.02;
const LEAST_ENERGY: f64 = 1e-9;

/// Conjugate gradients: largest number of steps, and the share of the squared residual that may be
/// left.
const MOST_GRADIENTS: usize = 40;
const CLOSE: f64 = 1e-8;

/// The regularised `G`. With `E` its diagonal, `A = E^-1/2 G E^-1/2 + ridge`. The ridge is that of the
/// estimate of least mean square error for signs that count one half each (variance 1/4) in noise of a
/// given variance. The solution is, per bin, the estimated sign times the square root of the bin's
/// energy.
///
/// Conjugate gradients are used because `G` is positive semidefinite only up to the neighbours that the
/// cut of the kernel neglects. Conjugate gradients stop where a factorisation would diverge.
#[derive(Debug)]
pub(super) struct Normal {
    /// `G`, row by row.
    gram: Vec<f64>,
    /// `E^-1/2`, zero for an erasure.
    size: Vec<f64>,
    ridge: Vec<f64>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Normal {
    /// From `G` of `n` bins and the variance of the noise.
    pub(super) fn new(gram: Vec<f64>, n: usize, noise: f64) -> Self {
        let energy: Vec<f64> = (0..n).map(|i| gram[i * n + i].max(0.0)).collect();
        let least = LEAST_ENERGY * energy.iter().sum::<f64>() / n.max(1) as f64;
        let size: Vec<f64> =
            energy.iter().map(|e| if *e > least { e.sqrt().recip() } else { 0.0 }).collect();
        let ridge = size.iter().map(|size| (4.0 * noise * size * size).max(LEAST_RIDGE)).collect();
        Self { gram, size, ridge }
    }

    /// `A^-1 E^-1/2 t`.
    pub(super) fn solve(&self, t: &[f64]) -> Vec<f64> {
        let n = t.len();
        let times = |x: &[f64]| -> Vec<f64> {
            let row = |i: usize| {
                let symmetric =
                    |k: usize| f64::midpoint(self.gram[i * n + k], self.gram[k * n + i]);
                let sum: f64 = (0..n).map(|k| symmetric(k) * self.size[k] * x[k]).sum();
                self.size[i] * sum + self.ridge[i] * x[i]
            };
            (0..n).map(row).collect()
        };
        let mut x = vec![0.0; n];
        let mut rest: Vec<f64> = t.iter().zip(&self.size).map(|(t, size)| t * size).collect();
        let mut direction = rest.clone();
        let start = dot(&rest, &rest);
        let mut residual_squared = start;
        for _ in 0..MOST_GRADIENTS {
            if residual_squared <= CLOSE * start {
                break;
            }
            let image = times(&direction);
            let curvature = dot(&direction, &image);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let step = residual_squared / curvature;
            x.iter_mut().zip(&direction).for_each(|(x, direction)| *x += step * direction);
            rest.iter_mut().zip(&image).for_each(|(rest, image)| *rest -= step * image);
            let next = dot(&rest, &rest);
            direction.iter_mut().zip(&rest).for_each(|(direction, rest)| {
                *direction = rest + next / residual_squared * *direction;
            });
            residual_squared = next;
        }
        x
    }
}
