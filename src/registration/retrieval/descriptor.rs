//! The descriptor of a whole shape: a few dozen bytes. They do not change when the shape is moved,
//! rotated, scaled or mirrored, and change little when it is tessellated anew, smoothed or made
//! noisy. The descriptor is useless for fragments.
//!
//! It holds the energies per degree of the spherical harmonics of nested shells about the centre,
//! which no rotation changes (Kazhdan, Funkhouser and Rusinkiewicz 2003), and quantiles of the
//! distances from the centre. Lengths are relative to the root mean square of these distances.

use glam::DVec3;

use crate::mesh::stop::{Stop, unstopped};
use crate::registration::by_surface::samples::scatter_until;
use crate::registration::shape::Shape;

/// Degrees of the harmonics.
const DEGREES: usize = 8;

/// Shells, spaced by half of the root mean square distance.
const SHELLS: usize = 4;

/// Quantiles of the distances.
const QUANTILES: usize = 16;

/// Bytes of a descriptor.
pub const BYTES: usize = DEGREES * SHELLS + QUANTILES;

/// Points that stand for the surface. Four times as many change descriptors of real meshes by less
/// than simplification to a tenth does.
const POINTS: usize = 16_384;

/// A shape descriptor. It is stored: the meaning of its bytes is fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShapeDescriptor(pub [u8; BYTES]);

impl ShapeDescriptor {
    /// The descriptor of a shape.
    #[must_use]
    pub fn new(shape: &Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(shape: &Shape, stop: Stop<'_>) -> Option<Self> {
        let points = scatter_until(shape, POINTS, stop)?;
        let mut points: Vec<DVec3> = points.into_iter().map(|p| p.position).collect();
        let share = 1.0 / points.len().max(1) as f64;
        let centre = points.iter().sum::<DVec3>() * share;
        let square: f64 = points.iter().map(|p| p.distance_squared(centre)).sum::<f64>() * share;
        let unit = square.sqrt().recip();
        for p in &mut points {
            *p = (*p - centre) * unit;
        }
        let mut bytes = [0; BYTES];
        let (energies, quantiles) = bytes.split_at_mut(DEGREES * SHELLS);
        for (byte, energy) in energies.iter_mut().zip(shells(&points)) {
            // Energies are a few hundredths; the root spreads them over the byte's range.
            *byte = fraction((energy * share).sqrt());
        }
        let mut distances: Vec<f64> = points.iter().map(|p| p.length()).collect();
        distances.sort_unstable_by(f64::total_cmp);
        for (k, byte) in quantiles.iter_mut().enumerate() {
            let rank = (2 * k + 1) * distances.len() / (2 * QUANTILES);
            // Hardly any distance exceeds 2.5 times the root mean square.
            *byte = fraction(distances.get(rank).copied().unwrap_or(0.0) / 2.5);
        }
        Some(Self(bytes))
    }

    /// How different two descriptors are: the sum of the bytes' squared differences.
    #[must_use]
    pub fn distance(&self, other: &Self) -> u32 {
        let square = |(&a, &b): (&u8, &u8)| u32::from(a.abs_diff(b)).pow(2);
        self.0.iter().zip(&other.0).map(square).sum()
    }
}

/// A value from 0 to 1 as a byte.
fn fraction(x: f64) -> u8 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0 to 255; NaN becomes 0"
    )]
    let byte = (x * 255.0).round().clamp(0.0, 255.0) as u8;
    byte
}

/// Per shell and degree the length of the vector of coefficients.
fn shells(points: &[DVec3]) -> Vec<f64> {
    let mut sums = vec![[0.0; DEGREES * DEGREES]; SHELLS];
    for p in points {
        let radius = p.length();
        let values = harmonics(p.normalize_or(DVec3::Z));
        for (shell, sum) in (0_u8..).zip(&mut sums) {
            let weight = 1.0 - (2.0 * radius - 1.0 - f64::from(shell)).abs();
            if weight > 0.0 {
                for (s, v) in sum.iter_mut().zip(values) {
                    *s += weight * v;
                }
            }
        }
    }
    let degree = |sum: &[f64; DEGREES * DEGREES], l: usize| {
        sum[l * l..(l + 1) * (l + 1)].iter().map(|s| s * s).sum::<f64>().sqrt()
    };
    sums.iter().flat_map(|sum| (0..DEGREES).map(move |l| degree(sum, l))).collect()
}

/// Real spherical harmonics in the direction `d`, scaled so that each degree's squares sum to 1.
/// Degree `l` has the entries from `l^2` up to, but not including, `(l + 1)^2`.
fn harmonics(d: DVec3) -> [f64; DEGREES * DEGREES] {
    let mut values = [0.0; DEGREES * DEGREES];
    // (x + i y)^m, and Legendre functions without their powers of sin, by the usual recurrences.
    let (mut cosine, mut sine, mut sectoral) = (1.0, 0.0, 1.0);
    for m in 0..DEGREES {
        let (mut before, mut now) = (0.0, sectoral);
        // (l - m)! / (l + m)!, twice for m > 0.
        let mut scale = if m == 0 { 1.0 } else { 2.0 / factorial(2 * m) };
        for l in m..DEGREES {
            let value = now * f64::sqrt(scale);
            values[l * l + 2 * m] = value * cosine;
            if m > 0 {
                values[l * l + 2 * m - 1] = value * sine;
            }
            let (lf, mf) = (l as f64, m as f64);
            let next = ((2.0 * lf + 1.0) * d.z * now - (lf + mf) * before) / (lf - mf + 1.0);
            (before, now) = (now, next);
            scale *= (lf - mf + 1.0) / (lf + mf + 1.0);
        }
        (cosine, sine) = (cosine * d.x - sine * d.y, cosine * d.y + sine * d.x);
        sectoral *= 2.0 * m as f64 + 1.0;
    }
    values
}

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;

    fn outline(sample: Sample, vertices: u32, scale: f64) -> ShapeDescriptor {
        let mesh = sample.mesh(vertices).unwrap();
        let positions = mesh.positions().iter().map(|&p| awkward(scale).apply(p)).collect();
        let mesh = Mesh::new(positions, mesh.triangles().to_vec()).unwrap();
        ShapeDescriptor::new(&Shape::new(Surface::new(&mesh)).unwrap())
    }

    #[test]
    fn squares_of_harmonics_sum_to_one_in_each_degree() {
        let values = harmonics(DVec3::new(0.3, -0.5, 0.9).normalize());
        for l in 0..DEGREES {
            let sum: f64 = values[l * l..(l + 1) * (l + 1)].iter().map(|v| v * v).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{l}: {sum}");
        }
    }

    #[test]
    fn an_outline_bears_similarities_and_coarser_tessellations_and_tells_shapes_apart() {
        let hosts = Sample::ALL.map(|sample| (sample, outline(sample, 8000, 1.0)));
        for (sample, host) in hosts {
            let near = [(8000, 3.0), (8000, -0.2), (2500, 1.0)]
                .map(|(vertices, scale)| host.distance(&outline(sample, vertices, scale)));
            let far = hosts.iter().filter(|h| h.0 != sample).map(|h| h.1.distance(&host)).min();
            assert!(near.iter().all(|n| n * 10 < far.unwrap()), "{sample}: {near:?} {far:?}");
        }
    }
}
