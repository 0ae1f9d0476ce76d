//! Rows combined over trials.

use std::collections::BTreeMap;

use serde::Serialize;

use super::row::Row;

/// All trials of one attack on one kind of mark of one mesh. Means are over trials with a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// Name of the experiment.
    pub experiment: String,
    /// The host's name.
    pub mesh: String,
    /// The requested method.
    pub method: String,
    /// The requested strength.
    pub strength: f64,
    /// Bits of the mark.
    pub bits: usize,
    /// Whether the closed loop was used.
    pub closed_loop: bool,
    /// Largest allowed MRMS of the mark.
    pub budget: Option<f64>,
    /// The attack.
    pub attack: String,
    /// Its family.
    pub family: String,
    /// Its amount.
    pub amount: Option<f64>,
    /// Trials with a result.
    pub trials: usize,
    /// Trials without a result: the mark was refused, or nothing was left.
    pub failed: usize,
    /// Why the first of these failed.
    pub error: Option<String>,
    /// Mean share of bits read right, blindly.
    pub detection_ratio: f64,
    /// Standard deviation of that share over trials.
    pub detection_ratio_deviation: f64,
    /// Mean share of bits read wrong; one that is not read counts half, as a guess would.
    pub bit_error_rate: f64,
    /// Mean decimal logarithm of the blind bound.
    pub log10_bound: f64,
    /// The worst decimal logarithm of the blind bound.
    pub log10_bound_worst: f64,
    /// Share of trials whose blind bound is below the threshold.
    pub matches: f64,
    /// Mean decimal logarithm of the bound in the host's frame.
    pub log10_bound_in_place: f64,
    /// Share of trials that match blind or in the host's frame, two hypotheses counted.
    pub matches_in_place: f64,
    /// Mean decimal logarithm of the bound of the relief; `None` if no mark has one.
    pub log10_bound_relief: Option<f64>,
    /// Share of trials that match blind, in the host's frame or by the relief, three hypotheses counted.
    pub matches_with_host: f64,
    /// Vertices of the host.
    pub vertices: usize,
    /// Bounding-box diagonal of the host.
    pub diagonal: f64,
    /// Mean strength used.
    pub strength_used: f64,
    /// Trials whose positions were chosen by another method than the requested one.
    pub fell_back: usize,
    /// Mean MRMS of the mark, a share of the diagonal.
    pub mark_mrms: f64,
    /// Standard deviation of that MRMS over trials.
    pub mark_mrms_deviation: f64,
    /// Mean Hausdorff distance of the mark.
    pub mark_hausdorff: f64,
    /// Mean angle by which the mark turned normals, in degrees.
    pub mark_normal_deviation: f64,
    /// Mean share of triangles that the mark flipped.
    pub mark_flipped: f64,
    /// How visible the mark of the first trial is.
    pub mark_perceived: Option<f64>,
    /// MRMS of the attacked mesh of the first trial.
    pub attacked_mrms: Option<f64>,
    /// Hausdorff distance of the attacked mesh of the first trial.
    pub attacked_hausdorff: Option<f64>,
}

/// Groups rows by all but the trial, in the order of first appearance.
#[must_use]
pub fn groups(rows: &[Row], threshold: f64) -> Vec<Group> {
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut together: Vec<Vec<&Row>> = Vec::new();
    for row in rows {
        let key = format!("{}|{}", row.mark(), row.attack);
        let place = *places.entry(key).or_insert(together.len());
        if place == together.len() {
            together.push(Vec::new());
        }
        if let Some(group) = together.get_mut(place) {
            group.push(row);
        }
    }
    together.iter().filter_map(|rows| group(rows, threshold)).collect()
}

fn group(rows: &[&Row], threshold: f64) -> Option<Group> {
    let first = *rows.first()?;
    let made: Vec<&Row> = rows.iter().copied().filter(|row| row.error.is_none()).collect();
    let mean = |value: &dyn Fn(&Row) -> Option<f64>| {
        let values: Vec<f64> = made.iter().filter_map(|row| value(row)).collect();
        values.iter().sum::<f64>() / values.len().max(1) as f64
    };
    let share = |holds: &dyn Fn(&Row) -> bool| mean(&|row| Some(f64::from(u8::from(holds(row)))));
    let detection_ratio = mean(&|row| row.detection_ratio);
    let variance = mean(&|row| row.detection_ratio.map(|r| (r - detection_ratio).powi(2)));
    let mark_mrms = mean(&|row| row.mark_mrms);
    let mrms_variance = mean(&|row| row.mark_mrms.map(|mrms| (mrms - mark_mrms).powi(2)));
    let read_wrong = |row: &Row| {
        Some((row.bits_wrong? as f64 + 0.5 * row.bits_erased? as f64) / row.bits as f64)
    };
    let below = |bound: Option<f64>, threshold: f64| bound.is_some_and(|bound| bound < threshold);
    // Two readings, blind and in the host's frame: each bound is multiplied by two.
    let stricter = threshold - std::f64::consts::LOG10_2;
    let strictest = threshold - 3.0_f64.log10();
    let bounds = |row: &Row| [row.log10_bound, row.log10_bound_in_place, row.log10_bound_relief];
    // A surface that is nowhere near the host gives no evidence: a bound of 1.
    let has_relief = made.iter().any(|row| row.log10_bound_relief.is_some());
    Some(Group {
        experiment: first.experiment.clone(),
        mesh: first.mesh.clone(),
        method: first.method.clone(),
        strength: first.strength,
        bits: first.bits,
        closed_loop: first.closed_loop,
        budget: first.budget,
        attack: first.attack.clone(),
        family: first.family.clone(),
        amount: first.amount,
        trials: made.len(),
        failed: rows.len() - made.len(),
        error: rows.iter().find_map(|row| row.error.clone()),
        detection_ratio,
        detection_ratio_deviation: variance.sqrt(),
        bit_error_rate: mean(&read_wrong),
        log10_bound: mean(&|row| row.log10_bound),
        log10_bound_worst: made
            .iter()
            .filter_map(|row| row.log10_bound)
            .fold(f64::NEG_INFINITY, f64::max)
            .min(0.0),
        matches: share(&|row| below(row.log10_bound, threshold)),
        log10_bound_in_place: mean(&|row| row.log10_bound_in_place),
        matches_in_place: share(&|row| {
            below(row.log10_bound, stricter) || below(row.log10_bound_in_place, stricter)
        }),
        log10_bound_relief: has_relief
            .then(|| mean(&|row| Some(row.log10_bound_relief.unwrap_or(0.0)))),
        matches_with_host: share(&|row| bounds(row).iter().any(|&bound| below(bound, strictest))),
        vertices: first.vertices,
        diagonal: first.diagonal,
        strength_used: mean(&|row| row.strength_used),
        fell_back: made.iter().filter(|row| row.method_used.as_ref() != Some(&row.method)).count(),
        mark_mrms,
        mark_mrms_deviation: mrms_variance.sqrt(),
        mark_hausdorff: mean(&|row| row.mark_hausdorff),
        mark_normal_deviation: mean(&|row| row.mark_normal_deviation),
        mark_flipped: mean(&|row| row.mark_flipped.map(|n| n as f64 / row.triangles as f64)),
        mark_perceived: rows.iter().find_map(|row| row.mark_perceived),
        attacked_mrms: rows.iter().find_map(|row| row.attacked_mrms),
        attacked_hausdorff: rows.iter().find_map(|row| row.attacked_hausdorff),
    })
}
