//! Takes out of the heights what is not the mark: the remaining similarity between suspect and host,
//! and the host's own smoothing displacements.

use rayon::prelude::*;

use super::heights::Height;
use super::host::ReliefHost;
use super::smoothing::ROUNDS;
use crate::mesh::linear::solve;
use crate::mesh::powers::squared;

/// Parameters of a similarity: shift, turn, scale.
const SIMILARITY: usize = 7;

/// These parameters and one number per smoothing displacement.
pub(super) const TERMS: usize = SIMILARITY + ROUNDS.len();

/// Rounds of reweighting.
const REWEIGHTINGS: usize = 6;

/// Points per block of the normal equations; blocks are added in order.
const BLOCK: usize = 4096;

/// What is left after a fit.
pub(super) struct Rest {
    /// Heights without the fit.
    pub(super) heights: Vec<f64>,
    /// A robust estimate of the standard deviation of these heights.
    pub(super) deviation: f64,
    /// The similarity that was fitted: shift in shares of the diagonal, turn and change of scale, as
    /// factors of the terms; `None` where the heights do not determine it.
    pub(super) similarity: Option<[f64; SIMILARITY]>,
}

/// The terms at one point.
fn row(host: &ReliefHost, of: &Height) -> [f64; TERMS] {
    let arm = (of.foot - host.centre) / host.field.diagonal();
    let turned = of.normal.cross(arm);
    let mut row = [0.0; TERMS];
    let similarity =
        [of.normal.x, of.normal.y, of.normal.z, turned.x, turned.y, turned.z, arm.dot(of.normal)];
    row[..SIMILARITY].copy_from_slice(&similarity);
    let corners = host.tree.triangles()[of.triangle as usize];
    for (vertex, share) in corners.into_iter().zip(of.at) {
        let moved = host.smoothed[vertex as usize];
        for (term, moved) in row[SIMILARITY..].iter_mut().zip(moved) {
            *term += share * f64::from(moved);
        }
    }
    row
}

type Normal = ([[f64; TERMS]; TERMS], [f64; TERMS]);

fn normal_equations(
    rows: &[[f64; TERMS]],
    heights: &[f64],
    weight: impl Fn(f64) -> f64 + Sync,
    now: &[f64],
) -> Normal {
    let zero = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
    let blocks: Vec<Normal> = rows
        .par_chunks(BLOCK)
        .zip(heights.par_chunks(BLOCK))
        .zip(now.par_chunks(BLOCK))
        .map(|((rows, heights), now)| {
            let mut sum = zero;
            for ((row, height), now) in rows.iter().zip(heights).zip(now) {
                let w = weight(*now);
                for (i, x) in row.iter().enumerate() {
                    let wx = w * x;
                    for (sum, y) in sum.0[i].iter_mut().zip(row).take(i + 1) {
                        *sum += wx * y;
                    }
                    sum.1[i] += wx * height;
                }
            }
            sum
        })
        .collect();
    let mut sum = blocks.into_iter().fold(zero, |mut a, b| {
        for i in 0..TERMS {
            for j in 0..=i {
                a.0[i][j] += b.0[i][j];
            }
            a.1[i] += b.1[i];
        }
        a
    });
    for i in 0..TERMS {
        for j in i + 1..TERMS {
            sum.0[i][j] = sum.0[j][i];
        }
    }
    sum
}

/// Median of absolute values; 0 of an empty slice.
pub(super) fn median_size(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Fits by reweighted least squares, with Cauchy weights at two deviations, and subtracts the fit. With
/// `expected`, a prior holds the parameters of the similarity to about that size where the heights do
/// not determine them. A fragment of a sphere, for example, does not determine its rotation.
pub(super) fn regress(host: &ReliefHost, all: &[Height], expected: Option<f64>) -> Rest {
    /// Factor from the median of absolute values to the standard deviation, for a normal distribution.
    const MEDIAN: f64 = 1.4826;
    let heights: Vec<f64> = all.iter().map(|of| of.above).collect();
    let mut rows: Vec<[f64; TERMS]> =
        all.par_iter().with_min_len(1024).map(|of| row(host, of)).collect();
    // Terms are scaled to one size.
    let mut sizes = [0.0; TERMS];
    for row in &rows {
        for (size, x) in sizes.iter_mut().zip(row) {
            *size += x.abs();
        }
    }
    let count = rows.len().max(1) as f64;
    for row in &mut rows {
        for (x, size) in row.iter_mut().zip(sizes) {
            *x /= size / count + 1e-30;
        }
    }
    let mut rest = heights.clone();
    let mut similarity = None;
    let mut deviation = MEDIAN * median_size(&rest) + 1e-12;
    for _ in 0..REWEIGHTINGS {
        let weight = |rest: f64| 1.0 / (1.0 + squared(rest / (2.0 * deviation)));
        let (mut a, b) = normal_equations(&rows, &heights, weight, &rest);
        for (i, row) in a.iter_mut().enumerate() {
            // A small ridge: linearly dependent terms, as of a flat host, share the fit instead of
            // making the system singular.
            row[i] = row[i] * (1.0 + 1e-9) + 1e-9 * count;
            if let Some(expected) = expected.filter(|_| i < SIMILARITY) {
                let size = sizes[i] / count + 1e-30;
                row[i] += squared(deviation / (expected * size));
            }
        }
        let Some(fit) = solve(a, b) else { break };
        similarity = Some(std::array::from_fn(|k| fit[k] / (sizes[k] / count + 1e-30)));
        rest.par_iter_mut().zip(&rows).zip(&heights).with_min_len(1024).for_each(
            |((rest, row), height)| {
                *rest = height - row.iter().zip(fit).map(|(x, fit)| x * fit).sum::<f64>();
            },
        );
        deviation = MEDIAN * median_size(&rest) + 1e-12;
    }
    Rest { heights: rest, deviation, similarity }
}
