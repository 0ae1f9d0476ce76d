//! Reads the relief of one mark from a suspect, at each pose hypothesis.

use super::model::{HostModel, SuspectModel};
use super::pose::{PoseHypothesis, PoseKind, poses_until};
use crate::registration::{Effort, WorkLimits};
use crate::relief::{Amplitude, ReliefReading, Signs, Work};
use crate::watermark::MarkKey;

/// The reading of one relief.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReliefFound {
    /// False-positive bound, log10: bounds the probability that a fresh key reads so well, with all
    /// pose hypotheses counted.
    pub log10_fp: f64,
    /// Cells that were read.
    pub read: usize,
    /// Cells among them whose sign agrees with the key's.
    pub agreeing: usize,
}

/// Tests charged per test of a reading: the estimate takes as long as the searches.
const PER_TEST: u64 = 2;

/// Most tests of a reading at one of several symmetric poses. On a gear of 459,040 triangles this
/// gives some twenty thousand heights after the refinement: little for each cell, but enough for
/// all of them.
const TURNED: u64 = 6_000_000;

/// Reads the signs of a host from a suspect's surface at a pose hypothesis. `None` where the
/// suspect does not lie on the host, where the pose hypothesis does not say where the suspect lies,
/// or once the job is stopped.
///
/// The reading is charged to the budget. It makes as many tests as the sizes call for and the
/// budget has left. It makes at least a quarter of the former, except at one of several symmetric
/// poses.
#[must_use]
pub fn relief_at(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    pose: &PoseHypothesis,
    amplitude: Amplitude,
    within: WorkLimits<'_>,
) -> Option<ReliefReading> {
    if !pose.is_placed() {
        return None;
    }
    let host = host_model.relief(within.stop)?;
    let suspect = suspect_model.surface(host_model);
    let (positions, mirrored) = pose.placed(suspect);
    let most = ReliefReading::most_tests(host, suspect);
    let left = within.budget.left() / PER_TEST;
    let tests = match pose.kind {
        PoseKind::Symmetric(_) => most.min(TURNED).min(left),
        _ => most.min(left.max(most / 4)),
    };
    let mut work = Work::new(tests, within.stop);
    let placed = (positions.as_slice(), mirrored);
    let reading = ReliefReading::within(host, suspect, placed, amplitude.get(), &mut work);
    within.budget.spend(PER_TEST * work.spent());
    reading
}

/// The best reading of a key's relief over all pose hypotheses; `None` where there is none.
#[must_use]
pub fn relief_of(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    key: &MarkKey,
    amplitude: Amplitude,
    within: WorkLimits<'_>,
) -> Option<ReliefFound> {
    /// Below this bound, no other pose hypothesis is tried.
    const CERTAIN: f64 = -15.0;
    let mut best: Option<ReliefFound> = None;
    let _ = poses_until(host_model, suspect_model, Effort::Whole, within, &mut |pose| {
        if let Some(reading) = relief_at(host_model, suspect_model, pose, amplitude, within) {
            let signs = Signs::new(key, reading.signed_weights().len());
            let log10_bound = reading.log10_bound(reading.score(&signs));
            let log10_fp = (log10_bound - libm::log10(pose.kind.share())).min(0.0);
            let (read, agreeing) = reading.agreeing(&signs);
            if best.is_none_or(|best| log10_fp < best.log10_fp) {
                best = Some(ReliefFound { log10_fp, read, agreeing });
            }
        }
        best.is_some_and(|best| best.log10_fp < CERTAIN)
    });
    best
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::registration::Budget;
    use crate::registration::similarity::Similarity;
    use crate::sample::Sample;

    /// A smooth, nearly round surface: a tenth of it hardly shows its rotation.
    #[test]
    fn a_moved_part_of_a_round_host_is_read_with_every_key() {
        let mesh = Sample::Blob.mesh(10_000).unwrap();
        let host_model = HostModel::new(mesh.clone());
        let plain = host_model.surface();
        let field = host_model.relief(&|| false).unwrap().field();
        let place = Similarity {
            scale: 0.3,
            rotation: glam::DQuat::from_rotation_y(1.1) * glam::DQuat::from_rotation_x(0.4),
            translation: DVec3::new(4.0, -2.0, 9.0),
        };
        let mut bounds = Vec::new();
        for key in 1..=12_u8 {
            let mark = MarkKey::from_bytes([key; 32]);
            let signs = Signs::new(&mark, field.signs());
            let amplitude = Amplitude::default();
            let marked = field.marked(plain, &signs, amplitude.get(), &[]);
            let towards =
                DVec3::new(f64::from(key) - 6.0, 3.0, f64::from(key % 5) - 2.0).normalize();
            let mut along: Vec<f64> = marked.iter().map(|p| p.dot(towards)).collect();
            let middle = along.len() * 9 / 10;
            let least = *along.clone().select_nth_unstable_by(middle, f64::total_cmp).1;
            for x in &mut along {
                *x -= least;
            }
            let inside = |t: &&[u32; 3]| t.iter().all(|&v| along[v as usize] >= 0.0);
            let kept: Vec<[u32; 3]> = plain.triangles.iter().filter(inside).copied().collect();
            let single = |p: &DVec3| place.apply(*p).as_vec3().as_dvec3();
            let part = Mesh::new(marked.iter().map(single).collect(), kept).unwrap();
            let surface = Surface::new(&part);
            let suspect_model = SuspectModel::new(&part, &surface);
            let budget = Budget::new(u64::MAX);
            let within = WorkLimits { budget: &budget, stop: &|| false };
            let found = relief_of(&host_model, &suspect_model, &mark, amplitude, within);
            bounds.push(found.map_or(0.0, |found| found.log10_fp));
        }
        assert!(bounds.iter().all(|bound| *bound < -12.0), "{bounds:.1?}");
    }
}
