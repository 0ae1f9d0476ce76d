//! The relief of one mark, read from a suspect wherever a pose hypothesis has it.

use super::model::{HostModel, SuspectModel};
use super::pose::{PoseHypothesis, PoseKind, poses_until};
use crate::registration::{Effort, Within};
use crate::relief::{Amplitude, ReliefReading, Signs, Work};
use crate::watermark::MarkKey;

/// What one relief says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReliefFound {
    /// log10 of the bound on the probability that a fresh key reads so well, all pose hypotheses counted.
    pub log10_fp: f64,
    /// Cells that were read.
    pub read: usize,
    /// Those of them whose sign agrees.
    pub agreeing: usize,
}

/// What a reading takes for each test that it makes: the estimate takes as long as the searches.
const PER_TEST: u64 = 2;

/// Tests of a reading of one of several turns: on a gear of 459,040 triangles some twenty thousand heights
/// after its refinement, which say little of each cell, but enough of all.
const TURNED: u64 = 6_000_000;

/// What a suspect's surface says of the signs of a host, at a pose hypothesis; `None` where it is nowhere near, the
/// pose hypothesis does not say where it is, or once the job is stopped.
///
/// A reading is charged to the budget: it makes as many tests as sizes explain and are left, a quarter of
/// them in any case, but for one of several turns.
#[must_use]
pub fn relief_at(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    pose: &PoseHypothesis,
    amplitude: Amplitude,
    within: Within<'_>,
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
        PoseKind::Turned(_) => most.min(TURNED).min(left),
        _ => most.min(left.max(most / 4)),
    };
    let mut work = Work::new(tests, within.stop);
    let placed = (positions.as_slice(), mirrored);
    let reading = ReliefReading::within(host, suspect, placed, amplitude.get(), &mut work);
    within.budget.spend(PER_TEST * work.spent());
    reading
}

/// The best that the relief of a key reads with.
#[must_use]
pub fn relief_of(
    host_model: &HostModel,
    suspect_model: &SuspectModel<'_>,
    key: &MarkKey,
    amplitude: Amplitude,
    within: Within<'_>,
) -> Option<ReliefFound> {
    /// A bound that needs no other pose hypothesis.
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

    /// A smooth, nearly round surface, a tenth of which hardly says how it is turned.
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
            let within = Within { budget: &budget, stop: &|| false };
            let found = relief_of(&host_model, &suspect_model, &mark, amplitude, within);
            bounds.push(found.map_or(0.0, |found| found.log10_fp));
        }
        assert!(bounds.iter().all(|bound| *bound < -12.0), "{bounds:.1?}");
    }
}
