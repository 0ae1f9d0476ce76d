//! The pose hypotheses of a suspect at a host, one after the other.

use std::ops::ControlFlow;

use glam::DVec3;

use super::model::{HostModel, SuspectModel};
use crate::mesh::powers::squared;
use crate::mesh::stop::{self, Stop, changed, chosen};
use crate::mesh::surface::Surface;
use crate::registration::similarity::{Pair, fit};
use crate::registration::{
    Alignment, Effort, PreparedHost, Similarity, WorkLimits, by_surface, by_vertices, in_place,
    suffices,
};
use crate::watermark::{Correspondence, Frame};

/// What a pose hypothesis assumes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseKind {
    /// The suspect kept the host's coordinates. Vertices correspond if the file also kept their
    /// number and order.
    InPlace,
    /// The file kept the host's number of vertices and their order.
    SameOrder,
    /// The suspect was registered, by shared vertices or by the surface; the number is the rank of
    /// the alignment.
    Registered(usize),
    /// The suspect was registered by shared vertices, too few of them to make a search by the
    /// surface needless.
    FewVertices,
    /// The suspect kept the host's coordinates, and vertices that lie on vertices correspond.
    Near,
    /// The suspect was registered and then rotated by one of the host's symmetries; the number says
    /// how many of them there are.
    Symmetric(usize),
}

/// Error shares: the part of a host's error probability that a pose hypothesis of each kind may
/// spend. They add up to 1.
impl PoseKind {
    /// The error share of this kind.
    #[must_use]
    pub fn share(self) -> f64 {
        match self {
            // Parts are found by these two kinds, in place or moved, and have few bins to spare.
            Self::InPlace => 0.3,
            Self::Registered(0) => 0.35,
            Self::SameOrder => 0.1,
            Self::Registered(1) => 0.05,
            Self::Registered(_) => 0.03,
            Self::FewVertices => 0.01,
            Self::Near => 0.12,
            Self::Symmetric(turns) => 0.04 / turns.max(1) as f64,
        }
    }
}

/// Alignments by the surface that are tried, at the most.
const MOST_BY_SURFACE: usize = 3;

/// Rounds of reweighting when vertices are paired by their order.
const ROUNDS: usize = 4;

/// Largest median distance of vertices that are paired by their order, a share of the host's
/// diagonal. Beyond it, the order is not the host's.
const SAME: f64 = 0.05;

/// An assumption about where a suspect lies.
#[derive(Debug, Clone)]
pub struct PoseHypothesis {
    /// What it assumes.
    pub kind: PoseKind,
    /// From the suspect's coordinates to the host's.
    pub similarity: Similarity,
    /// Carrier vertices of the host with their positions in the suspect, in the host's coordinates;
    /// empty when only the frame is assumed.
    pub correspondences: Vec<Correspondence>,
}

impl PoseHypothesis {
    /// Whether it says where the suspect's surface lies. [`PoseKind::InPlace`] without
    /// correspondences does not: it only assumes that nothing was moved, and [`PoseKind::Near`]
    /// follows where that is so.
    #[must_use]
    pub fn is_placed(&self) -> bool {
        self.kind != PoseKind::InPlace || !self.correspondences.is_empty()
    }

    /// The suspect's carrier vertices in the host's coordinates, and whether the surface is
    /// mirrored.
    pub(super) fn placed(&self, suspect: &Surface) -> (Vec<DVec3>, bool) {
        let place = |p: &DVec3| self.similarity.apply(*p);
        (suspect.positions.iter().map(place).collect(), self.similarity.scale < 0.0)
    }

    /// The host's frame in the suspect's coordinates.
    #[must_use]
    pub fn frame_of(&self, host: &Frame) -> Frame {
        let size = self.similarity.scale.abs();
        Frame {
            centre: self.similarity.inverse().apply(host.centre),
            rho_min: host.rho_min / size,
            rho_max: host.rho_max / size,
        }
    }
}

/// Passes one pose hypothesis after the other to `visit`, the inexpensive ones first, until `visit`
/// breaks, there are no more, or `within.stop` returns `true`.
pub fn poses(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    effort: Effort,
    within: WorkLimits<'_>,
    visit: &mut dyn FnMut(PoseHypothesis) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let go_on = || if (within.stop)() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let still = Similarity::IDENTITY;
    let ordered = in_order(host_model, suspect_model, within.stop).unwrap_or_default();
    go_on()?;
    let unmoved = is_same(host_model, median_off(&ordered, &still));
    go_on()?;
    let correspondences = if unmoved { correspondences(&ordered, &still) } else { Vec::new() };
    visit(PoseHypothesis { kind: PoseKind::InPlace, similarity: still, correspondences })?;
    go_on()?;
    if let Some(pose) = same_order(host_model, ordered, within.stop) {
        visit(pose)?;
    }
    let (Some(host), Some(suspect)) =
        (host_model.prepared(within.stop), suspect_model.prepared(host_model, within.stop))
    else {
        return ControlFlow::Continue(());
    };
    if let Some(shared) = by_vertices(host, suspect, within.stop) {
        let enough = suffices(host, suspect, &shared, within);
        let kind = if enough { PoseKind::Registered(0) } else { PoseKind::FewVertices };
        let similarity = shared.similarity;
        visit(from_alignment(host_model, suspect_model, shared, kind))?;
        if enough {
            // On a symmetric host, every vertex may have correspondences in several places.
            return symmetric_poses(host, &similarity, within.stop, visit);
        }
    }
    let near = in_place(host, suspect, within);
    let known: Vec<Alignment> = near.into_iter().collect();
    for alignment in &known {
        go_on()?;
        visit(from_alignment(host_model, suspect_model, alignment.clone(), PoseKind::Near))?;
    }
    let found = by_surface(host, suspect, effort, &known, within);
    let best = found.first().or(known.first()).map(|best| best.similarity);
    for (rank, alignment) in found.into_iter().take(MOST_BY_SURFACE).enumerate() {
        go_on()?;
        visit(from_alignment(host_model, suspect_model, alignment, PoseKind::Registered(rank)))?;
    }
    best.map_or(ControlFlow::Continue(()), |best| symmetric_poses(host, &best, within.stop, visit))
}

/// Further pose hypotheses at a symmetric host, after one under which the suspect lies on it. The
/// suspect's shape does not show which of them is right.
fn symmetric_poses(
    host: &PreparedHost,
    similarity: &Similarity,
    stop: Stop<'_>,
    visit: &mut dyn FnMut(PoseHypothesis) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let turns = host.symmetries(stop).unwrap_or_default();
    for turn in turns {
        if stop() {
            return ControlFlow::Break(());
        }
        let kind = PoseKind::Symmetric(turns.len());
        visit(PoseHypothesis {
            kind,
            similarity: similarity.then(turn),
            correspondences: Vec::new(),
        })?;
    }
    ControlFlow::Continue(())
}

/// Like [`poses`], with a `visit` that returns whether to end.
pub(super) fn poses_until(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    effort: Effort,
    within: WorkLimits<'_>,
    visit: &mut dyn FnMut(&PoseHypothesis) -> bool,
) -> ControlFlow<()> {
    poses(host_model, suspect_model, effort, within, &mut |pose| {
        if visit(&pose) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
}

fn from_alignment(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    alignment: Alignment,
    kind: PoseKind,
) -> PoseHypothesis {
    let Alignment { similarity, pairs, .. } = alignment;
    let correspondence = |&[suspect, carrier]: &[u32; 2]| {
        let at = suspect_model.surface(host_model).positions.get(suspect as usize)?;
        Some(Correspondence { carrier, at: similarity.apply(*at) })
    };
    PoseHypothesis {
        kind,
        similarity,
        correspondences: pairs.iter().filter_map(correspondence).collect(),
    }
}

/// Vertices paired by their number, where host and suspect have equally many; `None` once `stop`
/// returns `true`.
fn in_order(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    stop: Stop<'_>,
) -> Option<Vec<Pair>> {
    let (host, suspect) = (host_model.mesh().positions(), suspect_model.mesh().positions());
    if host.len() != suspect.len() {
        return None;
    }
    let carriers = &host_model.surface().positions;
    let pair = |carrier: usize, &vertex: &u32| {
        let from = suspect.get(vertex as usize).copied();
        from.map(|from| Pair { from, to: carriers[carrier], weight: 1.0 })
    };
    let pairs = chosen(&host_model.surface().first_vertex, stop, pair)?;
    (pairs.len() == carriers.len()).then_some(pairs)
}

/// The correspondences of the pairs under a similarity.
fn correspondences(pairs: &[Pair], similarity: &Similarity) -> Vec<Correspondence> {
    let at = |p: &Pair| similarity.apply(p.from);
    (0..).zip(pairs).map(|(carrier, p)| Correspondence { carrier, at: at(p) }).collect()
}

/// The median distance of the pairs; infinite without pairs.
fn median_off(pairs: &[Pair], similarity: &Similarity) -> f64 {
    let off = |p: &Pair| similarity.apply(p.from).distance(p.to);
    let mut all: Vec<f64> = pairs.iter().map(off).collect();
    if all.is_empty() {
        return f64::INFINITY;
    }
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn is_same(host_model: &HostModel, median: f64) -> bool {
    median <= SAME * host_model.surface().diagonal()
}

/// The pose of a suspect that was moved, by the order of its vertices; `None` where the order is
/// not the host's, and once `stop` returns `true`.
fn same_order(
    host_model: &HostModel,
    mut pairs: Vec<Pair>,
    stop: Stop<'_>,
) -> Option<PoseHypothesis> {
    let mut similarity = fit(&pairs, false)?;
    let mut median = f64::INFINITY;
    for _ in 0..ROUNDS {
        stop::go_on(stop)?;
        median = median_off(&pairs, &similarity);
        stop::go_on(stop)?;
        if median <= 0.0 {
            break;
        }
        changed(&mut pairs, stop, |_, p| {
            let off = similarity.apply(p.from).distance(p.to);
            p.weight = 1.0 / (1.0 + squared(off / (2.0 * median)));
        })?;
        stop::go_on(stop)?;
        similarity = fit(&pairs, false)?;
    }
    stop::go_on(stop)?;
    let correspondences = correspondences(&pairs, &similarity);
    is_same(host_model, median).then_some(PoseHypothesis {
        kind: PoseKind::SameOrder,
        similarity,
        correspondences,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::Budget;
    use crate::registration::by_surface::symmetry::tests::crown;
    use crate::sample::Sample;
    use glam::{DQuat, DVec3};

    fn all(host_model: &HostModel, suspect: &Mesh) -> Vec<PoseHypothesis> {
        let surface = Surface::new(suspect);
        let mut seen = Vec::new();
        let budget = Budget::new(u64::MAX);
        let within = WorkLimits { budget: &budget, stop: &|| false };
        let suspect_model = SuspectModel::new(suspect, &surface);
        let _ = poses(host_model, &suspect_model, Effort::Whole, within, &mut |pose| {
            seen.push(pose);
            ControlFlow::Continue(())
        });
        seen
    }

    #[test]
    fn the_shares_of_all_poses_add_up_to_at_most_one() {
        let registered: f64 = (0..MOST_BY_SURFACE).map(|k| PoseKind::Registered(k).share()).sum();
        let rest = [
            PoseKind::FewVertices,
            PoseKind::InPlace,
            PoseKind::SameOrder,
            PoseKind::Near,
            PoseKind::Symmetric(1),
        ];
        let rest = rest.map(PoseKind::share);
        assert!(registered + rest.iter().sum::<f64>() <= 1.0 + 1e-12);
    }

    #[test]
    fn a_copy_that_kept_its_place_and_order_is_compared_vertex_by_vertex_where_it_lies() {
        let mesh = Sample::Blob.mesh(3000).unwrap();
        let host_model = HostModel::new(mesh.clone());
        // Shrunk a little, as smoothing does: a fit would undo it.
        let shrunk: Vec<DVec3> = mesh.positions().iter().map(|p| 0.99 * p).collect();
        let suspect = Mesh::new(shrunk.clone(), mesh.triangles().to_vec()).unwrap();
        let seen = all(&host_model, &suspect);
        assert_eq!(seen[0].kind, PoseKind::InPlace);
        assert_eq!(seen[0].correspondences.len(), host_model.surface().positions.len());
        for s in &seen[0].correspondences {
            let vertex = host_model.surface().first_vertex[s.carrier as usize];
            assert_eq!(s.at, shrunk[vertex as usize]);
        }
        let moved = shrunk.iter().map(|p| p + DVec3::ONE).collect();
        let moved = Mesh::new(moved, mesh.triangles().to_vec()).unwrap();
        assert!(all(&host_model, &moved)[0].correspondences.is_empty());
    }

    #[test]
    fn a_moved_copy_is_seen_at_home_by_its_order_and_by_its_vertices() {
        let mesh = Sample::Blob.mesh(6000).unwrap();
        let host_model = HostModel::new(mesh.clone());
        let place = Similarity {
            scale: 0.3,
            rotation: DQuat::from_rotation_y(1.1),
            translation: DVec3::new(4.0, -2.0, 9.0),
        };
        let moved: Vec<DVec3> = mesh.positions().iter().map(|&p| place.apply(p)).collect();
        let copy = Mesh::new(moved.clone(), mesh.triangles().to_vec()).unwrap();
        let seen = all(&host_model, &copy);
        let kinds: Vec<PoseKind> = seen.iter().map(|pose| pose.kind).collect();
        assert_eq!(kinds, [PoseKind::InPlace, PoseKind::SameOrder, PoseKind::Registered(0)]);
        for pose in &seen[1..] {
            assert!(pose.correspondences.len() > 4000, "{:?}", pose.kind);
            for s in &pose.correspondences {
                let own = host_model.surface().positions[s.carrier as usize];
                assert!(own.distance(s.at) < 1e-5, "{:?}", pose.kind);
            }
            let frame = Frame { centre: DVec3::ONE, rho_min: 0.1, rho_max: 1.0 };
            let there = pose.frame_of(&frame);
            assert!(there.centre.distance(place.apply(DVec3::ONE)) < 1e-5);
            assert!((there.radial_extent() - 0.3 * 0.9).abs() < 1e-6);
        }
        // A part has another number of vertices.
        let kept: Vec<[u32; 3]> =
            mesh.triangles().iter().copied().filter(|t| moved[t[0] as usize].x > 4.0).collect();
        let part = Mesh::new([moved, vec![DVec3::ZERO]].concat(), kept).unwrap();
        let kinds: Vec<PoseKind> = all(&host_model, &part).iter().map(|pose| pose.kind).collect();
        assert_eq!(kinds, [PoseKind::InPlace, PoseKind::Registered(0)]);
    }

    /// The shape does not show which of the five poses is right, so each has to be among the pose
    /// hypotheses.
    #[test]
    fn a_new_tessellation_of_a_symmetric_host_is_seen_in_every_pose() {
        let host = crown(5, [240, 40]);
        let host_model = HostModel::new(host.clone());
        let anew = crown(5, [170, 30]);
        let away = Similarity {
            scale: 0.3,
            rotation: DQuat::from_rotation_y(1.1) * DQuat::from_rotation_x(0.4),
            translation: DVec3::new(4.0, -2.0, 9.0),
        };
        for pose in 0..5_u32 {
            let turn = DQuat::from_rotation_z(f64::from(pose) * std::f64::consts::TAU / 5.0);
            let place = |p: &DVec3| away.apply(turn * *p);
            let positions: Vec<DVec3> = anew.positions().iter().map(place).collect();
            let suspect = Mesh::new(positions, anew.triangles().to_vec()).unwrap();
            let off = |pose: &PoseHypothesis| {
                let off = |p: &DVec3| pose.similarity.apply(place(p)).distance(*p);
                anew.positions().iter().map(off).fold(0.0, f64::max)
            };
            let least = all(&host_model, &suspect).iter().map(off).fold(f64::INFINITY, f64::min);
            assert!(least < 5e-3 * host_model.surface().diagonal(), "{pose}: {least}");
        }
    }

    #[test]
    fn a_copy_whose_triangles_were_turned_over_is_seen_where_it_lies() {
        let host = Sample::Blob.mesh(6000).unwrap();
        let host_model = HostModel::new(host.clone());
        let flipped = |mesh: &Mesh| mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]).collect();
        let place = |p: &DVec3| DQuat::from_rotation_x(0.7) * *p * 3.0 + DVec3::ONE;
        for copy in [host, Sample::Blob.mesh(4000).unwrap()] {
            let moved = copy.positions().iter().map(place).collect();
            let suspect = Mesh::new(moved, flipped(&copy)).unwrap();
            let off = |pose: &PoseHypothesis| {
                let off = |p: &DVec3| pose.similarity.apply(place(p)).distance(*p);
                copy.positions().iter().map(off).fold(0.0, f64::max)
            };
            let placed = all(&host_model, &suspect).into_iter();
            let registered = placed.filter(|pose| pose.kind == PoseKind::Registered(0));
            let least = registered.map(|pose| off(&pose)).fold(f64::INFINITY, f64::min);
            assert!(least < 2e-3 * host_model.surface().diagonal(), "{least}");
        }
    }

    #[test]
    fn a_new_tessellation_in_place_is_seen_there_first_and_not_twice() {
        let mesh = Sample::Knot.mesh(6000).unwrap();
        let host_model = HostModel::new(mesh.clone());
        let seen = all(&host_model, &Sample::Knot.mesh(4000).unwrap());
        let kinds: Vec<PoseKind> = seen.iter().map(|pose| pose.kind).collect();
        assert_eq!(kinds[..2], [PoseKind::InPlace, PoseKind::Near]);
        for pose in &seen[2..] {
            let off = |&p: &DVec3| pose.similarity.apply(p).distance(p);
            let most = mesh.positions().iter().map(off).fold(0.0, f64::max);
            assert!(most > 5e-3 * host_model.surface().diagonal(), "{:?}", pose.kind);
        }
    }
}
