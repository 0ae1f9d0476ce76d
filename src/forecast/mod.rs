//! Predicts what a mark will survive before it is made: the false-positive bound after each attack
//! of [`ATTACKS`], as a blind detector reads it in the suspect's own frame for one record. The
//! other detectors of a verification can only improve on it.
//!
//! If the mesh is not too large, a mark is rehearsed (`rehearsal`). A line fitted to runs of the
//! lab maps the rehearsed bound to the expected one. Another key, message and seed give another
//! bound, most of all where marks begin to fail.
//!
//! Otherwise, and for remeshing, the bound comes from a model of counts. A bin reads its bit right
//! with probability `p = Phi(f)`, where the signal-to-noise ratio `f` is `exp(theta . (1, ln
//! strength, ln vertices per bin, ln size in bins, variance))`. All bins are taken as alike, and
//! the bound is Chernoff's at an agreement of `2 p - 1`.
//!
//! Both were fitted by `benches/lab/forecast.py`, which also states the errors: root mean squares
//! over meshes that were left out of the fit.

mod rehearsal;
mod table;

use serde::Serialize;

use crate::attacks::Attack;
use crate::attacks::crop::Of;
use crate::marking::Inspection;
use crate::mesh::Mesh;
use crate::watermark::{EmbedParams, Modulation, log10_chernoff};

use rehearsal::rehearse;
use table::TABLE;

/// Largest number of carrier vertices with which a mark is rehearsed. With more, twenty attacks
/// would occupy a worker, and memory for four times as many carriers, for seconds.
const MOST_CARRIERS: usize = 200_000;

/// The same limit for triangles. A closed surface has twice as many triangles as carriers, but a
/// file may repeat triangles over few carriers.
const MOST_TRIANGLES: usize = 3 * MOST_CARRIERS;

/// Attacks of which something is said: at least one of most families, mostly where marks begin to fail.
pub const ATTACKS: [Attack; 20] = [
    Attack::None,
    Attack::Similarity,
    Attack::Reorder,
    Attack::RoundTrip,
    Attack::Noise(0.001),
    Attack::Noise(0.003),
    Attack::Noise(0.005),
    Attack::Smooth { lambda: 0.5, iterations: 1 },
    Attack::Smooth { lambda: 0.5, iterations: 5 },
    Attack::Quantise(10),
    Attack::Quantise(8),
    Attack::Simplify(0.5),
    Attack::Simplify(0.9),
    Attack::Remesh(0.6),
    Attack::Midpoint,
    Attack::Loop,
    Attack::Crop(0.1, Of::Vertices),
    Attack::Spikes { count: 1, height: 0.01 },
    Attack::Collude(2),
    Attack::ReMark,
];

/// The fit of one attack.
struct Coefficients {
    /// Its name.
    attack: &'static str,
    /// Coefficients of the model of counts.
    theta: [f64; 5],
    /// Root mean square error of the bound's logarithm.
    error: f64,
    /// The line from the rehearsed bound, if the attack is rehearsed.
    line: Option<Line>,
}

/// Maps the rehearsed bound to the expected one.
struct Line {
    start: f64,
    slope: f64,
    error: f64,
}

/// What is expected after an attack.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Expected {
    /// The name of the attack.
    pub attack: &'static str,
    /// Decimal logarithm of the false-positive bound, read blindly, for one record.
    pub log10_fp: f64,
    /// Root mean square error of that number, on meshes that the model was not fitted to.
    pub error: f64,
    /// The bound of the rehearsal, before the line is applied.
    pub rehearsed: Option<f64>,
}

/// The expected bound after each of [`ATTACKS`], in their order; empty for a mesh that
/// cannot be marked. Once `stop` returns `true`, rehearsals end and the prediction is less
/// accurate.
#[must_use]
pub fn expected(
    host: &Mesh,
    inspection: &Inspection,
    params: &EmbedParams,
    stop: &(dyn Fn() -> bool + Sync),
) -> Vec<Expected> {
    let Some(features) = features(inspection, params) else { return Vec::new() };
    let small = inspection.carriers <= MOST_CARRIERS && inspection.triangles <= MOST_TRIANGLES;
    let rehearsed = if small { rehearse(host, params, &ATTACKS, stop) } else { Vec::new() };
    let bins = vec![1.0; inspection.usable_bins];
    let after = |(place, fit): (usize, &Coefficients)| {
        let rehearsed = rehearsed.get(place).copied().flatten();
        if let (Some(bound), Some(line)) = (rehearsed, &fit.line) {
            let log10_fp = (line.start + line.slope * bound).clamp(inspection.best_log10_fp, 0.0);
            Expected { attack: fit.attack, log10_fp, error: line.error, rehearsed }
        } else {
            let log10_fp = log10_chernoff(&bins, agreement(fit, features) * bins.len() as f64);
            Expected { attack: fit.attack, log10_fp, error: fit.error, rehearsed }
        }
    };
    TABLE.iter().enumerate().map(after).collect()
}

/// For bins that are all alike, the share read right minus the share read wrong: 2 Phi(f) - 1.
fn agreement(fit: &Coefficients, features: [f64; 5]) -> f64 {
    let dot: f64 = fit.theta.iter().zip(features).map(|(t, x)| t * x).sum();
    // As in the fit, the signal is at most exp(5) standard deviations.
    let signal = libm::exp(dot.clamp(-20.0, 5.0));
    libm::erf(signal / std::f64::consts::SQRT_2)
}

fn features(seen: &Inspection, params: &EmbedParams) -> Option<[f64; 5]> {
    let width = (seen.rho_max - seen.rho_min) / seen.bits as f64;
    let variance = params.method.modulation() == Modulation::Variance;
    let features = [
        1.0,
        libm::log(params.strength.get()),
        libm::log(seen.median_count.max(1) as f64),
        libm::log(seen.rho_max / width),
        f64::from(u8::from(variance)),
    ];
    (seen.markable && features.iter().all(|x| x.is_finite())).then_some(features)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{Asset, Limits};
    use crate::marking::inspect_asset;
    use crate::sample::{Sample, to_obj};
    use crate::watermark::Strength;

    fn of(vertices: u32, strength: f64) -> Vec<Expected> {
        let asset = Asset::read(&to_obj(&Sample::Blob.mesh(vertices).unwrap()), &Limits::default())
            .unwrap();
        let strength = Strength::new(strength).unwrap();
        let params = EmbedParams { strength, ..EmbedParams::default() };
        let seen = inspect_asset(&asset, &params).unwrap();
        expected(asset.mesh(), &seen, &params, &|| false)
    }

    #[test]
    fn it_foretells_each_attack() {
        let names = ATTACKS.map(|attack| attack.to_string());
        let foretold = of(6000, 0.1);
        assert_eq!(names.as_slice(), foretold.iter().map(|e| e.attack).collect::<Vec<_>>());
        for expected in &foretold {
            let fit = TABLE.iter().find(|fit| fit.attack == expected.attack).unwrap();
            assert!(expected.rehearsed.is_some() || fit.line.is_none(), "{expected:?}");
        }
        assert!(foretold == of(6000, 0.1), "it repeats");
    }

    /// Rehearsals of one mesh differ from a real mark of it by key, message and seed alone.
    #[test]
    fn what_fades_in_the_rehearsal_is_expected_to_fade() {
        let foretold = of(12_000, 0.1);
        let of = |name: &str| foretold.iter().find(|e| e.attack == name).unwrap().log10_fp;
        assert!(of("noise 0.1 %") <= of("noise 0.3 %") && of("noise 0.3 %") < of("noise 0.5 %"));
        assert!(of("smoothing 0.5 x 1") < of("smoothing 0.5 x 5"));
        assert!(of("quantised to 10 bits") < of("quantised to 8 bits"));
        assert!(of("cropped by 10 %") > -6.0);
    }

    #[test]
    fn nothing_done_nothing_lost_and_stronger_marks_last() {
        let [weak, strong] = [0.05, 0.2].map(|strength| of(12_000, strength));
        assert!((strong[0].log10_fp + 64.0 * std::f64::consts::LOG10_2).abs() < 0.5, "{strong:?}");
        let sum = |list: &[Expected]| list.iter().map(|e| e.log10_fp).sum::<f64>();
        assert!(sum(&strong) < sum(&weak) - 5.0);
        assert!(strong.iter().all(|e| e.log10_fp <= 0.0 && e.error > 0.0 && e.error < 8.0));
    }

    #[test]
    fn a_mesh_that_cannot_be_marked_has_nothing_to_expect() {
        assert!(of(300, 0.1).is_empty());
    }
}
