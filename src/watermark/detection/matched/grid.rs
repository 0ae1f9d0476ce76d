//! The grid that the coordinates of a quantised mesh lie on.
//!
//! Work is bounded by a sort, whatever the points are. Must not know marks or hosts.

use glam::DVec3;

use crate::mesh::stop::{Stop, sorted};

/// Levels of one axis: `origin + k step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levels {
    origin: f64,
    pub(super) step: f64,
}

/// A grid along three directions, each with its own levels. An axis along which all points have the
/// same coordinate has no levels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    pub(super) axes: [DVec3; 3],
    pub(super) levels: [Option<Levels>; 3],
}

/// A coordinate counts as a stray when no other is within this share of the range.
const SAME_LEVEL: f64 = 1e-6;

/// Share of the points that may be strays.
const STRAYS: f64 = 0.1;

/// Least average number of coordinates per level. Ordinary files have about as many levels as vertices,
/// or as their decimals allow; in the second case they lie on a grid.
const LEAST_PER_LEVEL: usize = 8;

/// Share of a step that a coordinate may be off its level, because of decimals, single precision or a
/// later move of the mesh. Coordinates on no grid are within it with twice this probability.
const TOLERANCE: f64 = 0.1;

/// Share of the coordinates that must be within [`TOLERANCE`] of a level.
const LEAST_SHARE: f64 = 0.95;

impl Grid {
    /// The grid that the points lie on, along these orthonormal axes; `None` when there is none, or
    /// once `stop` answers `true`.
    pub(super) fn of(
        points: &(impl Iterator<Item = DVec3> + Clone),
        axes: [DVec3; 3],
        stop: Stop<'_>,
    ) -> Option<Self> {
        let mut levels = [None; 3];
        let mut unsure = Vec::new();
        for (k, axis) in axes.into_iter().enumerate() {
            let all = points.clone().map(|p| p.dot(axis)).collect();
            let all = sorted(all, stop, f64::total_cmp)?;
            match Coordinates::new(&all, stop) {
                Coordinates::Same => {}
                Coordinates::Levels(found) => levels[k] = Some(found),
                // One axis without clear levels is decided below; two mean no grid.
                Coordinates::Free if unsure.is_empty() => unsure.push((k, all)),
                Coordinates::Free => return None,
            }
        }
        // A thin object has too few levels for their step to be estimated; the step of another axis is
        // taken.
        let step = levels.iter().flatten().next()?.step;
        for (k, all) in unsure {
            levels[k] = Some(Levels::of_step(&all, step)?);
        }
        Some(Self { axes, levels })
    }
}

impl Levels {
    /// Levels of a known step, if most of the sorted coordinates lie on them.
    fn of_step(all: &[f64], step: f64) -> Option<Self> {
        let levels = Self { origin: *all.get(all.len() / 2)?, step };
        levels.fits(all, all.len()).then_some(levels)
    }

    /// Whether at least the share [`LEAST_SHARE`] of `of` coordinates lies on these levels.
    fn fits(&self, all: &[f64], of: usize) -> bool {
        let on = all.iter().filter(|&&x| self.snapped(x).is_some()).count();
        on as f64 >= LEAST_SHARE * of as f64
    }

    /// The level that a coordinate lies on; `None` between levels.
    pub(super) fn snapped(&self, x: f64) -> Option<f64> {
        let k = ((x - self.origin) / self.step).round();
        let level = self.origin + k * self.step;
        ((x - level).abs() <= TOLERANCE * self.step).then_some(level)
    }
}

/// What the coordinates along an axis are.
#[derive(Debug, PartialEq)]
enum Coordinates {
    Same,
    Levels(Levels),
    Free,
}

impl Coordinates {
    /// Classifies sorted coordinates.
    fn new(all: &[f64], stop: Stop<'_>) -> Self {
        let (Some(&low), Some(&high)) = (all.first(), all.last()) else { return Self::Free };
        let range = high - low;
        if !range.is_finite() {
            return Self::Free;
        }
        if range <= 0.0 {
            return Self::Same;
        }
        let close = |k: usize| all.get(k..k + 2).is_some_and(|x| x[1] - x[0] <= SAME_LEVEL * range);
        let paired = |k: usize| close(k) || k.checked_sub(1).is_some_and(close);
        let kept: Vec<f64> =
            all.iter().enumerate().filter(|&(k, _)| paired(k)).map(|(_, &x)| x).collect();
        if (kept.len() as f64) < (1.0 - STRAYS) * all.len() as f64 {
            return Self::Free;
        }
        let Some(step) = typical_gap(&kept, stop) else { return Self::Free };
        let runs: Vec<&[f64]> = kept.chunk_by(|a, b| b - a <= 0.5 * step).collect();
        if runs.len() < 2 || LEAST_PER_LEVEL * runs.len() > kept.len() {
            return Self::Free;
        }
        let Some(levels) = fitted(&runs, step) else { return Self::Free };
        if levels.fits(all, kept.len()) { Self::Levels(levels) } else { Self::Free }
    }
}

/// The gap size at which the gaps at least as large cover half of the range.
fn typical_gap(along: &[f64], stop: Stop<'_>) -> Option<f64> {
    let gaps = along.windows(2).map(|x| x[1] - x[0]).collect();
    let gaps = sorted(gaps, stop, |a, b| b.total_cmp(a))?;
    let half = 0.5 * gaps.iter().sum::<f64>();
    let mut covered = 0.0;
    let gap = gaps.into_iter().find(|gap| {
        covered += gap;
        covered >= half
    })?;
    (gap > 0.0).then_some(gap)
}

/// Levels fitted by least squares to the means of runs, whose distances are about multiples of `step`.
fn fitted(runs: &[&[f64]], step: f64) -> Option<Levels> {
    let mean = |run: &[f64]| run.iter().sum::<f64>() / run.len() as f64;
    let first = mean(runs.first()?);
    let (mut k, mut last) = (0.0, first);
    let [mut count, mut ks, mut xs, mut kk, mut kx] = [0.0; 5];
    for run in runs {
        let x = mean(run);
        k += ((x - last) / step).round();
        last = x;
        let (n, x) = (run.len() as f64, x - first);
        count += n;
        ks += n * k;
        xs += n * x;
        kk += n * k * k;
        kx += n * k * x;
    }
    let step = (count * kx - ks * xs) / (count * kk - ks * ks);
    let origin = first + (xs - step * ks) / count;
    (step.is_normal() && step > 0.0 && origin.is_finite()).then_some(Levels { origin, step })
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::sample::Sample;

    fn grid(points: &[DVec3], axes: [DVec3; 3]) -> Option<Grid> {
        Grid::of(&points.iter().copied(), axes, &crate::mesh::stop::never)
    }

    /// A mesh on a grid of this step, at some origin.
    fn snapped(sample: Sample, step: f64) -> Vec<DVec3> {
        let mesh = sample.mesh(12_000).unwrap();
        let origin = DVec3::new(0.3, -7.1, 0.02);
        mesh.positions().iter().map(|p| (p / step).round() * step + origin).collect()
    }

    fn size(points: &[DVec3]) -> f64 {
        let low = points.iter().copied().reduce(DVec3::min).unwrap();
        let high = points.iter().copied().reduce(DVec3::max).unwrap();
        (high - low).max_element()
    }

    #[test]
    fn a_grid_is_found_through_rounding_turns_and_strays() {
        let turned = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.3, -0.8);
        for sample in Sample::ALL {
            let whole = size(sample.mesh(12_000).unwrap().positions());
            for steps in [7.0, 31.0, 127.0, 511.0] {
                let step = whole / steps;
                let exact = snapped(sample, step);
                let single = exact.iter().map(|p| p.as_vec3().as_dvec3()).collect();
                let decimals = exact.iter().map(|p| (p / step * 50.0).round() * step / 50.0);
                let stray = |(k, p): (usize, &DVec3)| {
                    let away = 1.0 + (k as f64).sin() / 50.0;
                    if k % 50 == 0 { *p * away } else { *p }
                };
                let strays = exact.iter().enumerate().map(stray).collect();
                let table: [(&str, Vec<DVec3>); 3] =
                    [("single", single), ("decimals", decimals.collect()), ("strays", strays)];
                for (name, points) in table {
                    let found = grid(&points, DVec3::AXES);
                    let Some(found) = found else { panic!("{sample} {steps} {name}: none") };
                    for levels in found.levels {
                        let off = (levels.map_or(step, |levels| levels.step) / step - 1.0).abs();
                        assert!(off < 1e-3, "{sample} {steps} {name}: {off}");
                    }
                }
                let axes = DVec3::AXES.map(|axis| turned * axis);
                let away: Vec<DVec3> = exact.iter().map(|&p| turned * p).collect();
                assert!(grid(&away, axes).is_some(), "{sample} {steps}, turned");
                assert_eq!(grid(&away, DVec3::AXES), None, "{sample} {steps}, turned away");
            }
        }
    }

    #[test]
    fn points_on_no_grid_have_none() {
        type Coordinate = fn(f64) -> f64;
        let axes = DVec3::AXES;
        for sample in Sample::ALL {
            let mesh = sample.mesh(12_000).unwrap();
            assert_eq!(grid(mesh.positions(), axes), None, "{sample}");
            let step = 1e-5 * size(mesh.positions());
            assert_eq!(grid(&snapped(sample, step), axes), None, "{sample}, decimals");
        }
        let line = |x: Coordinate| -> Vec<DVec3> {
            (0..4000).map(|k| DVec3::splat(x(f64::from(k)))).collect()
        };
        let table: [(&str, Coordinate); 6] = [
            ("one point", |_| 3.0),
            ("two far apart", |k| if k > 0.0 { f64::MAX } else { -f64::MAX }),
            ("levels that grow", |k| libm::exp2((k % 100.0) * 0.1)),
            ("levels of no order", |k| ((k % 100.0) * 12.9898).sin()),
            ("half on a grid", |k| if k % 2.0 < 1.0 { (k % 100.0).floor() } else { k.sin() }),
            ("not a number", |k| if k % 2.0 < 1.0 { f64::NAN } else { k % 16.0 }),
        ];
        for (name, x) in table {
            assert_eq!(grid(&line(x), axes), None, "{name}");
        }
        assert_eq!(grid(&[], axes), None);
    }

    #[test]
    fn an_axis_on_which_all_points_agree_says_nothing() {
        let points: Vec<DVec3> = (0..4000)
            .map(|k| DVec3::new(f64::from(k % 16), f64::from(k % 25) * 0.5, 2.0))
            .collect();
        let [x, y, z] = grid(&points, DVec3::AXES).unwrap().levels;
        assert!((x.unwrap().step - 1.0).abs() < 1e-12 && (y.unwrap().step - 0.5).abs() < 1e-12);
        assert_eq!(z, None);
    }
}
