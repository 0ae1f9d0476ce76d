//! The search for the centre about which the norms look most like those of a marked mesh.
//!
//! A mark pushes the norms of every bin to one side of the bin, so that about the right centre the
//! density of the norms has steps at the scale of a bin. A centre that is off by a third of a bin width
//! or more mixes norms of different directions and blurs these steps. A centre is therefore judged by
//! the roughness of its histogram of norms at that scale, which needs no bin layout. A cut of 2 % moves
//! the centre by 0.4 to 1.6 % of the diagonal, one to three bin widths of 64 (measured on bunny, horse,
//! nefertiti and armadillo). A ball of that radius holds a few thousand centres.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::LayoutEffort;
use super::outliers::Body;
use crate::watermark::bins::norms;
use crate::watermark::{BitCount, Frame, Modulation};

/// Histogram cells per bin of the middle layout class.
const CELLS_PER_BIN: f64 = 8.0;

/// Width of a bin of the middle layout class, as a share of the radial extent over M.
const MIDDLE_BIN: f64 = 0.85;

/// Points per bin that are read in the coarse search over the ball and in the fine search about the
/// best centres.
const POINTS_PER_BIN: (usize, usize) = (64, 256);

/// Half the edge of a cell of the body-centred grid of centres, in bins. No centre is farther than 0.35
/// bins from a grid point, a distance at which half of the roughness is left.
const STEP: f64 = 0.313;

/// Centres that the fine search starts from, per requested centre.
const FINE_STARTS: usize = 4;

/// Points whose distances are computed together.
const BATCH: usize = 256;

/// Steps of the fine search, in bins.
const FINE_STEPS: [f64; 4] = [0.2, 0.1, 0.05, 0.025];

/// Largest number of moves of the fine search at one step length.
const MOST_MOVES: usize = 12;

/// The radius of a search is at most its share of the diagonal times this many bins: a third more than
/// the diagonal of a long shape has in bins of a 64-bit mark.
const BINS_PER_RADIUS: f64 = 300.0;

/// Largest number of points that are read.
const MOST_POINTS: usize = 32_768;

/// A histogram cell counts at most this much, in units of its own variance. A cylinder has all of its
/// norms in one cell, which is no evidence of a mark.
const CAP: f32 = 16.0;

/// The best centres other than the body's own, the best first.
pub fn search(
    body: &Body,
    bits: BitCount,
    modulation: Modulation,
    effort: &LayoutEffort,
    stop: &(dyn Fn() -> bool + Sync),
) -> Vec<DVec3> {
    let frame = Frame::spanning(body.centre, &norms(&body.positions, body.centre));
    let bin = MIDDLE_BIN * frame.radial_extent() / bits.get() as f64;
    // Round shapes and large numbers of bits have narrow bins. The second bound keeps the number of
    // centres from growing with them.
    let radius = (effort.radius * body.diagonal).min(BINS_PER_RADIUS * effort.radius * bin);
    if !(bin > 0.0 && effort.candidates > 0) {
        return Vec::new();
    }
    let view = |per_bin: usize| {
        SampledNorms::new(body, &frame, bin, radius, per_bin * bits.get(), modulation)
    };
    let around = view(POINTS_PER_BIN.0);
    let mut seen: Vec<(f32, Vec3)> = ball(single(radius / bin), single(STEP))
        .into_par_iter()
        .map_init(
            || around.cells(),
            |cells, at| (if stop() { 0.0 } else { around.roughness(at, cells) }, at),
        )
        .collect();
    seen.sort_by(|a, b| b.0.total_cmp(&a.0));
    // A neighbour of a better centre leads to the same maximum.
    let mut starts: Vec<Vec3> = vec![Vec3::ZERO];
    for (_, at) in seen {
        if starts.len() > FINE_STARTS * effort.candidates {
            break;
        }
        if starts.iter().skip(1).all(|other| other.distance(at) > 2.2 * single(STEP)) {
            starts.push(at);
        }
    }
    let close = view(POINTS_PER_BIN.1);
    let mut best: Vec<(f32, Vec3)> = starts
        .into_par_iter()
        .map_init(
            || close.cells(),
            |cells, start| {
                if stop() { (0.0, start) } else { close.climb(start, cells, stop) }
            },
        )
        .collect();
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut centres: Vec<Vec3> = Vec::new();
    for (_, at) in best {
        let new = centres.iter().all(|other| other.distance(at) > 0.1);
        if new && at.length() > 0.02 && centres.len() < effort.candidates {
            centres.push(at);
        }
    }
    centres.into_iter().map(|at| body.centre + bin * at.as_dvec3()).collect()
}

/// Rounds to single precision, which suffices for offsets and counts here.
fn single(x: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
    let x = x as f32;
    x
}

/// The points of a body-centred cubic grid within `radius` of zero, in a fixed order. It covers a ball
/// with half the points of a cubic grid.
fn ball(radius: f32, step: f32) -> Vec<Vec3> {
    #[expect(clippy::cast_possible_truncation, reason = "a few dozen at most")]
    let reach = (radius / step).clamp(0.0, 100.0) as i16;
    let line = || -reach..=reach;
    let plane = line().flat_map(|x| line().map(move |y| (x, y)));
    let all = plane.flat_map(|(x, y)| line().map(move |z| [x, y, z]));
    let alike = |[x, y, z]: &[i16; 3]| (x ^ y) & 1 == 0 && (y ^ z) & 1 == 0;
    let points = all.filter(alike).map(|at| step * Vec3::from_array(at.map(f32::from)));
    points.filter(|at| at.length() <= radius).collect()
}

/// A sample of the body's points, relative to its centre, in units of a bin width.
struct SampledNorms {
    /// Coordinates, axis by axis: four distances are computed at a time.
    points: [Vec<f32>; 3],
    /// Smallest norm of the histogram, in cells.
    first: f32,
    count: usize,
    /// Half the width of the Haar wavelet, in cells. For the mean it is half a bin, because norms crowd
    /// in one half of a bin. For the variance it is a quarter, because norms crowd in the middle or at
    /// the ends of a bin.
    half: usize,
}

impl SampledNorms {
    fn new(
        body: &Body,
        frame: &Frame,
        bin: f64,
        radius: f64,
        points: usize,
        modulation: Modulation,
    ) -> Self {
        let all = body.positions.len();
        let points = points.min(all).min(MOST_POINTS);
        let chosen = (0..points).map(|k| body.positions[k * all / points.max(1)]);
        let chosen: Vec<Vec3> = chosen.map(|p| ((p - body.centre) / bin).as_vec3()).collect();
        let points = std::array::from_fn(|axis| chosen.iter().map(|p| p[axis]).collect());
        let cells = |length: f64| length / bin * CELLS_PER_BIN;
        let first = single(cells(frame.rho_min - radius) - 1.0);
        // Bounded: a radius is a few bins, an extent 300 bins at most.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "see above")]
        let count = cells(frame.radial_extent() + 2.0 * radius).clamp(1.0, 1e5) as usize + 3;
        let half = match modulation {
            Modulation::Mean => 4,
            Modulation::Variance => 2,
        };
        Self { points, first, count, half }
    }

    fn cells(&self) -> Vec<f32> {
        vec![0.0; self.count]
    }

    /// The roughness of the norms about `centre` (in bins) at the scale of the wavelet: the sum over
    /// the histogram of the squared difference of neighbouring half wavelets, each over its variance.
    fn roughness(&self, centre: Vec3, cells: &mut [f32]) -> f32 {
        cells.fill(0.0);
        let scale = single(CELLS_PER_BIN);
        let [xs, ys, zs] = &self.points;
        let mut places = [0_u32; BATCH];
        for ((xs, ys), zs) in xs.chunks(BATCH).zip(ys.chunks(BATCH)).zip(zs.chunks(BATCH)) {
            for (((place, x), y), z) in places.iter_mut().zip(xs).zip(ys).zip(zs) {
                let (x, y, z) = (x - centre.x, y - centre.y, z - centre.z);
                let cell = (x * x + y * y + z * z).sqrt() * scale - self.first;
                #[expect(clippy::cast_possible_truncation, reason = "cells are few; saturates")]
                let cell = cell as i32;
                *place = cell.cast_unsigned();
            }
            for &place in places.iter().take(xs.len()) {
                if let Some(cell) = cells.get_mut(place as usize) {
                    *cell += 1.0;
                }
            }
        }
        // Counts are below 2^24, so these sums are exact.
        let mut sum = 0.0;
        for cell in cells.iter_mut() {
            sum += *cell;
            *cell = sum;
        }
        let triples =
            cells.iter().zip(cells.iter().skip(self.half)).zip(cells.iter().skip(2 * self.half));
        triples
            .map(|((a, b), c)| {
                let difference = c - b - (b - a);
                (difference * difference / (c - a + 1.0)).min(CAP)
            })
            .sum()
    }

    /// Hill climbing from `start`, in ever smaller steps, until `stop` answers `true`.
    fn climb(
        &self,
        start: Vec3,
        cells: &mut [f32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (f32, Vec3) {
        let mut best = (self.roughness(start, cells), start);
        for step in FINE_STEPS.map(single) {
            for _ in 0..MOST_MOVES {
                if stop() {
                    break;
                }
                let here = best.1;
                for axis in Vec3::AXES {
                    for to in [here + step * axis, here - step * axis] {
                        let rough = self.roughness(to, cells);
                        if rough > best.0 {
                            best = (rough, to);
                        }
                    }
                }
                if best.1 == here {
                    break;
                }
            }
        }
        best
    }
}
