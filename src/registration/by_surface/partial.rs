//! Rough similarities for a suspect that is a part and was tessellated anew, from pairs of key
//! points that look alike.
//!
//! A key point is a surface point with its normal and its spin images. Two matches of key points
//! fix a similarity. They also show at once whether they can both be right: the distance between
//! the points must fit the ratio of the radii at which they look alike, and the normals must form
//! like angles. Therefore all pairs of matches can be tried instead of random ones.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::samples::Point;
use super::spin::{Spin, spins};
use crate::mesh::powers::squared;
use crate::registration::budget::Stop;
use crate::registration::similarity::Similarity;

/// Key points of the host and of the suspect that are compared.
const HOST_KEYS: usize = 1000;
const SUSPECT_KEYS: usize = 220;

/// Points of the surface that spin images are made from.
const SPIN_POINTS: usize = 6000;

/// Radii of the suspect's spin images, shares of its diagonal, descending.
const SUSPECT_RADII: [f64; 2] = [0.21, 0.13];

/// Radii of the host's spin images, shares of its diagonal: the least, the ratio between
/// neighbours, and their number. Images still match when the radii differ by half a step. Scales
/// from 0.15 to 2 are covered.
const LEAST_RADIUS: f64 = 0.03;
const RADIUS_RATIO: f64 = 1.19;
const RADII: i32 = 13;

/// How far the scale of two matches may differ from that of their radii, as a ratio, and how far
/// the cosines may differ between suspect and host: the cosines between normals, and between
/// normals and the line between the points.
const SCALE_OFF: f64 = 0.15;
const COSINE_OFF: f64 = 0.25;

/// Least distance of two key points, a share of the suspect's diagonal. Closer ones fix no
/// rotation.
const LEAST_DISTANCE: f64 = 0.15;

/// Best matches that are used per pair of radii: half of the suspect's key points. (With all, 55
/// instead of 50 of 70 fragments of 5 %, simplified by 75 %, were found, in twice the time.)
const MOST_MATCHES: usize = 110;

/// Hypotheses that are kept per pair of radii.
const KEPT: usize = 4;

/// Tests that a search for a part is charged: they take as long as it does on a host without spin
/// images yet, 0.12 s.
pub const PRICE: u64 = 8_000_000;

/// A host's key points with spin images at all radii; made once per host.
pub struct HostSpinImages(Vec<Vec<Spin>>);

/// A suspect's key points with spin images at few radii; made once per suspect.
pub struct SuspectSpinImages(Vec<Vec<Spin>>);

impl HostSpinImages {
    /// Makes the spin images of a host from points spread evenly; `None` once `stop` returns
    /// `true`.
    #[must_use]
    pub fn new(points: &[Point], stop: Stop) -> Option<Self> {
        let radii: Vec<f64> = (0..RADII).rev().map(host_radius).collect();
        let seen = spins(&keys(points, HOST_KEYS), &keys(points, SPIN_POINTS), &radii, stop);
        (!stop()).then_some(Self(seen))
    }
}

impl SuspectSpinImages {
    /// Makes the spin images of a suspect, as [`HostSpinImages::new`] does of a host.
    #[must_use]
    pub fn new(points: &[Point], stop: Stop) -> Option<Self> {
        let seen =
            spins(&keys(points, SUSPECT_KEYS), &keys(points, SPIN_POINTS), &SUSPECT_RADII, stop);
        (!stop()).then_some(Self(seen))
    }
}

fn host_radius(step: i32) -> f64 {
    LEAST_RADIUS * (0..step).fold(1.0, |power, _| power * RADIUS_RATIO)
}

/// A match of two key points that look alike: point and normal of the suspect's, and of the host's.
struct SpinMatch {
    from: [DVec3; 2],
    to: [DVec3; 2],
    likeness: f32,
}

fn keys(points: &[Point], count: usize) -> Vec<Point> {
    points.iter().step_by((points.len() / count).max(1)).copied().collect()
}

/// Similarities under which parts of the suspect look like parts of the host, the best of each
/// scale.
#[must_use]
pub fn by_parts(host: &HostSpinImages, suspect: &SuspectSpinImages, stop: Stop) -> Vec<Similarity> {
    let steps: Vec<i32> = (0..RADII).rev().collect();
    let at = |(step, hosts): (i32, &Vec<Spin>)| -> Vec<Similarity> {
        let radius = host_radius(step);
        let all = SUSPECT_RADII.iter().zip(&suspect.0);
        all.flat_map(|(own, spins)| best(spins, hosts, radius / own, radius, stop)).collect()
    };
    let found: Vec<Vec<Similarity>> = steps.into_par_iter().zip(&host.0).map(at).collect();
    found.into_iter().rev().flatten().collect()
}

/// Per key point of the suspect the most similar one of the host, the most similar matches first.
fn best_matches(suspect: &[Spin], host: &[Spin]) -> Vec<SpinMatch> {
    let most = |s: &Spin| {
        let (likeness, h) =
            host.iter().map(|h| (s.likeness(h), h)).max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(SpinMatch { from: [s.position, s.normal], to: [h.position, h.normal], likeness })
    };
    let mut all: Vec<SpinMatch> = suspect.iter().filter_map(most).collect();
    all.sort_by(|a, b| b.likeness.total_cmp(&a.likeness));
    all.truncate(MOST_MATCHES);
    all
}

/// The hypotheses that most matches agree with.
fn best(suspect: &[Spin], host: &[Spin], scale: f64, radius: f64, stop: Stop) -> Vec<Similarity> {
    let best_matches = best_matches(suspect, host);
    let tolerance = squared((0.2 * radius).max(0.03));
    let agreeing = |s: &Similarity| {
        let agrees = |a: &&SpinMatch| {
            s.apply(a.from[0]).distance_squared(a.to[0]) < tolerance
                && s.turn(a.from[1]).dot(a.to[1]) > 0.7
        };
        best_matches.iter().filter(agrees).count()
    };
    let twos = (1..best_matches.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let guesses = twos
        .filter_map(|(i, j)| two(&best_matches[i], &best_matches[j], scale))
        .take_while(|_| !stop());
    let mut counted: Vec<(usize, Similarity)> = guesses.map(|s| (agreeing(&s), s)).collect();
    counted.sort_by_key(|c| std::cmp::Reverse(c.0));
    let mut kept: Vec<Similarity> = Vec::new();
    for (_, s) in counted {
        let known = |k: &Similarity| {
            (k.rotation * s.rotation.inverse()).w.abs() > 0.985
                && k.translation.distance(s.translation) < 0.1
        };
        if kept.len() < KEPT && !kept.iter().any(known) {
            kept.push(s);
        }
    }
    kept
}

/// The similarity that two matches fix; `None` where they cannot both be right.
fn two(a: &SpinMatch, b: &SpinMatch, scale: f64) -> Option<Similarity> {
    let (from, to) = (b.from[0] - a.from[0], b.to[0] - a.to[0]);
    let apart = from.length();
    let ratio = to.length() / (scale * apart);
    if apart < LEAST_DISTANCE || (ratio - 1.0).abs() > SCALE_OFF {
        return None;
    }
    let (d, e) = (from / apart, to.try_normalize()?);
    let cosines = |a: DVec3, b: DVec3, d: DVec3| [a.dot(d), b.dot(d), a.dot(b)];
    let here = cosines(a.from[1], b.from[1], d);
    let there = cosines(a.to[1], b.to[1], e);
    if here.iter().zip(there).any(|(x, y)| (x - y).abs() > COSINE_OFF) {
        return None;
    }
    let frame = |d: DVec3, n: DVec3| {
        let v = d.cross(n).try_normalize()?;
        Some(DMat3::from_cols(d, v, d.cross(v)))
    };
    let turn = frame(e, a.to[1] + b.to[1])? * frame(d, a.from[1] + b.from[1])?.transpose();
    let (rotation, scale) = (DQuat::from_mat3(&turn).normalize(), scale * ratio);
    let middle = 0.5 * (a.from[0] + b.from[0]);
    let translation = 0.5 * (a.to[0] + b.to[0]) - rotation * middle * scale;
    Some(Similarity { scale, rotation, translation }).filter(Similarity::is_valid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::surface::Surface;
    use crate::registration::by_surface::samples::scatter;
    use crate::registration::shape::Shape;
    use crate::sample::Sample;

    #[test]
    fn a_part_with_another_tessellation_is_about_where_it_belongs() {
        let host = Shape::new(Surface::new(&Sample::Blob.mesh(8000).unwrap())).unwrap();
        let mut part = Surface::new(&Sample::Blob.mesh(5000).unwrap());
        let plane = part.centre().x;
        let at = part.positions.clone();
        part.triangles.retain(|t| t.iter().all(|&v| at[v as usize].x > plane));
        let part = Shape::new(crate::mesh::surface::Surface::new(
            &crate::mesh::Mesh::new(part.positions, part.triangles).unwrap(),
        ))
        .unwrap();
        let places = HostSpinImages::new(&scatter(&host, SPIN_POINTS), &|| false).unwrap();
        let own = SuspectSpinImages::new(&scatter(&part, SPIN_POINTS), &|| false).unwrap();
        let found = by_parts(&places, &own, &|| false);
        let truth = part.unit.inverse().then(&host.unit);
        let error = |s: &Similarity| {
            DVec3::AXES
                .iter()
                .map(|&p| s.apply(0.5 * p).distance(truth.apply(0.5 * p)))
                .fold(0.0, f64::max)
        };
        let best = found.iter().map(error).fold(f64::INFINITY, f64::min);
        assert!(best < 0.1, "{best}");
    }
}
