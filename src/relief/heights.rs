//! Heights of a suspect above its host: signed distances along the host's normals, of the suspect's
//! vertices and of points spread over its triangles.

use glam::DVec3;
use rayon::prelude::*;

use super::field::vertex_normals;
use super::host::ReliefHost;
use crate::mesh::sampling::in_triangles;
use crate::mesh::stop::Stop;
use crate::mesh::surface::{Surface, doubled_area};

/// Least cosine between the normals of a suspect and of its host at one point.
const ALIKE: f64 = 0.3;

/// Largest distance between suspect and host, as a share of the diagonal.
const REACH: f64 = 0.012;

/// A point of a suspect above its host.
#[derive(Debug, Clone, Copy)]
pub(super) struct Height {
    /// Triangle of the host.
    pub(super) triangle: u32,
    /// Barycentric coordinates in that triangle.
    pub(super) at: [f64; 3],
    /// The closest point of the host, in the host's coordinates.
    pub(super) foot: DVec3,
    /// The host's normal there.
    pub(super) normal: DVec3,
    /// Height along the normal, as a share of the diagonal.
    pub(super) above: f64,
}

/// Heights of one kind of points.
pub(super) struct Heights {
    pub(super) all: Vec<Height>,
    /// Number of distinct triangles per point, at most 1: of many points in one triangle each adds
    /// less.
    pub(super) distinct: f64,
}

/// The budget of a reading in tests of the search tree; a test visits a box or a triangle. Counted
/// tests bound the time on any surface, and the result is the same on any number of threads.
pub struct Work<'a> {
    all: u64,
    spent: u64,
    pub(super) stop: Stop<'a>,
}

impl<'a> Work<'a> {
    /// A budget of `tests`; `stop` is called between blocks of points.
    #[must_use]
    pub fn new(tests: u64, stop: Stop<'a>) -> Self {
        Self { all: tests, spent: 0, stop }
    }

    /// Number of tests that were made.
    #[must_use]
    pub fn spent(&self) -> u64 {
        self.spent
    }

    fn left(&self) -> u64 {
        self.all.saturating_sub(self.spent)
    }
}

/// The height of a point with a normal; `None` where the host is not near or faces another way. Adds
/// the tests of the search to `tests`.
fn height(host: &ReliefHost, p: DVec3, normal: DVec3, tests: &mut u64) -> Option<Height> {
    let diagonal = host.field.diagonal();
    let (number, foot) = host.tree.closest(p, REACH * diagonal, tests)?;
    let corners = host.tree.triangles().get(number)?;
    let [a, b, c] = corners.map(|v| host.tree.points()[v as usize]);
    let area = doubled_area(a, b, c);
    let across = area.normalize_or_zero();
    let off = p - foot;
    let near = off.length() <= REACH * diagonal;
    // Barycentric coordinates are the area shares of the parts opposite to each corner.
    let share = |p: DVec3, q: DVec3| doubled_area(foot, p, q).dot(area) / area.length_squared();
    (near && across.dot(normal) > ALIKE).then(|| Height {
        triangle: u32::try_from(number).unwrap_or(u32::MAX),
        at: [share(b, c), share(c, a), share(a, b)],
        foot,
        normal: across,
        above: off.dot(across) / diagonal,
    })
}

/// Points of a suspect with the normals of its surface, in the host's coordinates.
pub(super) struct Points {
    pub(super) all: Vec<(DVec3, DVec3)>,
    distinct: f64,
}

impl Points {
    /// The carriers, at regular steps where there are more than [`MOST`].
    fn at_vertices(suspect: &Surface, positions: &[DVec3], mirrored: bool) -> Self {
        let side = if mirrored { -1.0 } else { 1.0 };
        let normals = vertex_normals(positions, &suspect.triangles);
        let step = positions.len().div_ceil(MOST).max(1);
        let all = positions.iter().zip(&normals).step_by(step);
        Self { all: all.map(|(p, n)| (*p, side * *n)).collect(), distinct: 1.0 }
    }

    /// Points on triangles, evenly by area, at most `most`. A part of a surface gets as many points as
    /// it would have within the whole.
    pub(super) fn in_triangles(
        host: &ReliefHost,
        suspect: &Surface,
        positions: &[DVec3],
        mirrored: bool,
        most: usize,
    ) -> Self {
        let side = if mirrored { -1.0 } else { 1.0 };
        let triangles = &suspect.triangles;
        let count = count_in_triangles(host, positions, triangles).min(most);
        let mut all = Vec::with_capacity(count);
        in_triangles(positions, triangles, count, |t, p| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            all.push((p, side * doubled_area(a, b, c).normalize_or_zero()));
        });
        let distinct = triangles.len().min(all.len()) as f64 / all.len().max(1) as f64;
        Self { all, distinct }
    }
}

/// Heights of points, as many as the remaining work allows. Points where the host is not near, or faces
/// another way, have no height. `None` when stopped.
pub(super) fn heights_of(
    host: &ReliefHost,
    points: &[(DVec3, DVec3)],
    work: &mut Work<'_>,
) -> Option<Vec<Height>> {
    /// Points between two calls of `stop`.
    const BLOCK: usize = 4096;
    /// Points from which the cost of a search is estimated.
    const PROBES: usize = 64;
    let stop = work.stop;
    let of = |block: &[&(DVec3, DVec3)]| {
        let mut tests = 0;
        let of = |&&(p, normal): &&(DVec3, DVec3)| height(host, p, normal, &mut tests);
        let heights: Vec<Height> = block.iter().filter_map(of).collect();
        (!stop()).then_some((heights, tests))
    };
    let every = |step: usize| points.iter().step_by(step.max(1)).collect::<Vec<_>>();
    let (_, probed) = of(&every(points.len().div_ceil(PROBES)))?;
    work.spent = work.spent.saturating_add(probed);
    let cost = probed.div_ceil(PROBES as u64).max(1);
    let affordable = usize::try_from(work.left() / cost).unwrap_or(usize::MAX);
    if affordable == 0 {
        return Some(Vec::new());
    }
    let points = every(points.len().div_ceil(affordable));
    let blocks: Option<Vec<(Vec<Height>, u64)>> = points.par_chunks(BLOCK).map(of).collect();
    let blocks = blocks?;
    let spent: u64 = blocks.iter().map(|(_, tests)| tests).sum();
    work.spent = work.spent.saturating_add(spent);
    Some(blocks.into_iter().flat_map(|(heights, _)| heights).collect())
}

/// Largest number of points of each kind.
const MOST: usize = 150_000;

/// Points on triangles per area of a cell's face, and at most this many per triangle: more points add
/// no information.
const PER_CELL: f64 = 12.0;
const PER_TRIANGLE: f64 = 64.0;

/// Number of points to spread over triangles, by area: the same for a part as it would be within the
/// whole.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to MOST")]
fn count_in_triangles(host: &ReliefHost, positions: &[DVec3], triangles: &[[u32; 3]]) -> usize {
    let area: f64 = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            0.5 * doubled_area(a, b, c).length()
        })
        .sum();
    let side = host.field.cells().side();
    let most = (PER_TRIANGLE * triangles.len() as f64).min(MOST as f64);
    (PER_CELL * area / (side * side)).clamp(0.0, most) as usize
}

/// Heights of the vertices of a suspect and of points on its triangles. Its carriers are at
/// `positions`, in the host's coordinates. `mirrored` says whether the move to these coordinates turned
/// the surface inside out. `None` when stopped.
pub(super) fn heights(
    host: &ReliefHost,
    suspect: &Surface,
    positions: &[DVec3],
    mirrored: bool,
    work: &mut Work<'_>,
) -> Option<[Heights; 2]> {
    let vertices = Points::at_vertices(suspect, positions, mirrored);
    let inside = Points::in_triangles(host, suspect, positions, mirrored, MOST);
    let mut of = |points: Points| {
        let all = heights_of(host, &points.all, work)?;
        Some(Heights { all, distinct: points.distinct })
    };
    Some([of(vertices)?, of(inside)?])
}
