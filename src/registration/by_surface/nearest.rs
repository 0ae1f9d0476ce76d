//! Vertices of an aligned suspect that lie on vertices of its host.

use glam::DVec3;
use rayon::prelude::*;

use super::icp::IcpTarget;
use crate::registration::budget::WorkLimits;
use crate::registration::by_vertices::one_rings::NONE;
use crate::registration::shape::Shape;
use crate::registration::similarity::Similarity;

/// Largest distance of a pair, a share of the shortest edge between the host's vertex and the other
/// corners of its triangle. A vertex farther away may correspond to any of them.
const OWN: f64 = 0.5;

/// Pairs of carrier vertices, the suspect's and the host's, that are nearest to each other when `s`
/// places the suspect. Ascending by the suspect's vertex, and none farther apart than `reach`.
/// Empty when stopped.
#[must_use]
pub fn mutual(
    host: &Shape,
    target: &IcpTarget,
    suspect: &Shape,
    s: &Similarity,
    reach: f64,
    within: WorkLimits<'_>,
) -> Vec<[u32; 2]> {
    let corner = |p: &DVec3, tests: &mut u64| -> Option<(u32, f64)> {
        if (within.stop)() {
            return None;
        }
        let placed = s.apply(*p);
        let (triangle, _) = target.closest(placed, reach, tests)?;
        let corners = host.triangles.get(triangle)?;
        let at = |v: u32| host.positions[v as usize];
        let distances = corners.map(|v| (v, at(v).distance(placed)));
        let best = distances.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let others = corners.iter().filter(|&&v| v != best.0);
        let edge = others.map(|&v| at(v).distance(at(best.0))).fold(f64::INFINITY, f64::min);
        (best.1 < OWN * edge).then_some(best)
    };
    let counted = |p: &DVec3| {
        let mut tests = 0;
        (corner(p, &mut tests), tests)
    };
    let counted: Vec<(Option<(u32, f64)>, u64)> =
        suspect.positions.par_iter().with_min_len(1024).map(counted).collect();
    if (within.stop)() {
        return Vec::new();
    }
    within.budget.spend(counted.iter().map(|(_, tests)| tests).sum());
    let nearest: Vec<Option<(u32, f64)>> = counted.into_iter().map(|(corner, _)| corner).collect();
    if (within.stop)() {
        return Vec::new();
    }
    let mut suspect_of = vec![(NONE, f64::INFINITY); host.positions.len()];
    for (vertex, found) in (0..).zip(&nearest) {
        if let Some((corner, distance)) = *found {
            let holder = &mut suspect_of[corner as usize];
            if distance < holder.1 {
                *holder = (vertex, distance);
            }
        }
    }
    if (within.stop)() {
        return Vec::new();
    }
    let holds = |(vertex, found): (u32, &Option<(u32, f64)>)| {
        let (corner, _) = (*found)?;
        (suspect_of[corner as usize].0 == vertex).then_some([vertex, corner])
    };
    (0..).zip(&nearest).filter_map(holds).collect()
}
