//! Signed distance to a surface that is given by points with normals.

use glam::DVec3;
use rayon::prelude::*;

use super::Sample;
use crate::attacks::isosurface::{Grid, UNKNOWN};
use crate::mesh::powers::squared;

/// Columns of buckets per axis around a position. Buckets along z have consecutive keys.
const COLUMN: usize = 3;

/// Two samples are of one sheet if the cosine between their normals is above this (120 degrees).
/// The two sides of a right-angled crease are one sheet, since fits would otherwise break there.
/// The two sides of a thin wall are not.
const ONE_SHEET: f64 = -0.5;

/// Points in buckets as large as the reach of a fit.
pub struct Fit {
    samples: Vec<Sample>,
    /// The bucket of each sample, ascending.
    keys: Vec<u64>,
    buckets: Grid,
    reach: f64,
}

impl Fit {
    /// Prepares samples. A fit around a position uses those within `reach`.
    pub fn new(samples: &[Sample], low: DVec3, reach: f64) -> Self {
        let buckets = Grid::new(low, reach);
        let mut keyed: Vec<(u64, usize)> =
            samples.iter().enumerate().map(|(k, s)| (buckets.cell_of(s.place), k)).collect();
        keyed.par_sort_unstable();
        let keys = keyed.iter().map(|&(key, _)| key).collect();
        let samples = keyed.iter().map(|&(_, k)| samples[k]).collect();
        Self { samples, keys, buckets, reach }
    }

    /// The samples of the buckets around a position.
    fn around(&self, place: DVec3) -> impl Iterator<Item = &Sample> {
        let columns: [u64; 9] = std::array::from_fn(|k| {
            let [x, y] = [k / COLUMN, k % COLUMN].map(|step| step as f64 - 1.0);
            self.buckets.cell_of(place + self.reach * DVec3::new(x, y, 0.0))
        });
        columns.into_iter().flat_map(|key| {
            let from = self.keys.partition_point(|&k| k + 1 < key);
            let to = from + self.keys[from..].partition_point(|&k| k <= key + 1);
            &self.samples[from..to]
        })
    }

    /// The signed distance, positive outside, to the algebraic sphere that fits the samples around
    /// a position (Guennebaud and Gross, *Algebraic point set surfaces*, SIGGRAPH 2007). The fit to
    /// positions and normals is in closed form, as in Guennebaud, Germann and Gross, *Dynamic
    /// sampling and rendering of algebraic point set surfaces*, Eurographics 2008, eqs. 4 to 6.
    /// Weights are `(1 - (r / reach)^2)^4`.
    ///
    /// Samples whose normals differ too much from that of the nearest sample ([`ONE_SHEET`]) are
    /// left out: they are of another sheet, such as the other side of a thin wall. NaN if no sample
    /// is within reach.
    pub fn distance(&self, place: DVec3) -> f64 {
        let squared_reach = squared(self.reach);
        let near = || {
            let off = self.around(place).map(|s| (s.place.distance_squared(place), s));
            off.filter(|(r, _)| *r < squared_reach)
        };
        let Some((_, nearest)) = near().min_by(|(a, _), (b, _)| a.total_cmp(b)) else {
            return UNKNOWN;
        };
        let (mut w, mut wp, mut wn) = (0.0, DVec3::ZERO, DVec3::ZERO);
        let (mut wpp, mut wpn) = (0.0, 0.0);
        for (r, sample) in near().filter(|(_, s)| s.normal.dot(nearest.normal) > ONE_SHEET) {
            let weight = squared(squared(1.0 - r / squared_reach));
            let p = sample.place - place;
            w += weight;
            wp += weight * p;
            wn += weight * sample.normal;
            wpp += weight * r;
            wpn += weight * p.dot(sample.normal);
        }
        if w <= 0.0 {
            return UNKNOWN;
        }
        // The sphere `c + l . x + q |x|^2 = 0`, with x relative to `place`.
        let spread = wpp - wp.length_squared() / w;
        let q = if spread > 1e-12 * squared_reach * w {
            0.5 * (wpn - wp.dot(wn) / w) / spread
        } else {
            0.0
        };
        let l = (wn - 2.0 * q * wp) / w;
        let c = -(l.dot(wp) + q * wpp) / w;
        // The nearer root along the gradient.
        let root = (l.length_squared() - 4.0 * c * q).max(0.0).sqrt();
        let slope = l.length() + root;
        if slope > 0.0 { 2.0 * c / slope } else { UNKNOWN }
    }
}
