//! The experiments of Luo and Bors 2009, section 5, on the paper's axes.
//!
//! The curves of the figures are not in the text that this grid was made from. Axes are as the text
//! gives them: noise 0.1 to 1 %, lambda 0.5 with 1 to 20 iterations, simplification 5 to 95 %,
//! remeshing 100 to 20 %. Where the text gives none (bits of quantisation, strengths and sizes of
//! figures 10 and 11), they are ranges around the values that it names.

use super::{Choices, Experiment, bit_counts, or, settings, strengths};
use crate::attacks::Attack;
use crate::watermark::{BitCount, Method};

const METHODS: [Method; 4] = [Method::QspMean, Method::QspVar, Method::ChoMean, Method::ChoVar];
/// The watermark strength factor of section 5, unless stated otherwise. Not this service's default.
const STRENGTH: f64 = 0.1;
const STRENGTHS: [f64; 6] = [0.02, 0.05, 0.08, 0.1, 0.15, 0.2];
const BITS: [u32; 6] = [16, 32, 64, 96, 128, 192];
const NOISE: [f64; 6] = [0.001, 0.002, 0.004, 0.006, 0.008, 0.01];
const ITERATIONS: [u32; 6] = [1, 2, 5, 10, 15, 20];
const SIMPLIFIED: [f64; 7] = [0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95];
const QUANTISED: [u32; 6] = [12, 11, 10, 9, 8, 7];
const REMESHED: [f64; 5] = [1.0, 0.8, 0.6, 0.4, 0.2];

fn attacks() -> Vec<Attack> {
    let smooth = |iterations| Attack::Smooth { lambda: 0.5, iterations };
    let mut all = vec![Attack::None, Attack::Similarity, Attack::Reorder];
    all.extend(NOISE.map(Attack::Noise));
    all.extend(ITERATIONS.map(smooth));
    all.extend(SIMPLIFIED.map(Attack::Simplify));
    all.extend(QUANTISED.map(Attack::Quantise));
    all.extend(REMESHED.map(Attack::Remesh));
    all.extend([Attack::Butterfly, Attack::Loop, Attack::Midpoint]);
    all
}

/// Distortion is measured on marks of the paper's single pass. Robustness is measured on marks of
/// the closed loop, which have no wrong bit before the attack. After a single pass, some bits are
/// misread.
pub fn experiments(choices: &Choices) -> Vec<Experiment> {
    let methods = or(&choices.methods, &METHODS);
    let usual = Choices {
        methods: methods.clone(),
        strengths: or(&choices.strengths, &strengths(&[STRENGTH])),
        bits: or(&choices.bits, &[BitCount::default()]),
    };
    let stronger = Choices { strengths: strengths(&STRENGTHS), ..usual.clone() };
    let longer = Choices { bits: bit_counts(&BITS), ..usual.clone() };
    // The paper shows its own two methods here.
    let own: Vec<Method> = methods
        .iter()
        .copied()
        .filter(|m| !choices.methods.is_empty() || matches!(m, Method::QspMean | Method::QspVar))
        .collect();
    let longer_own = Choices { methods: own, ..longer.clone() };
    let experiment = |name, settings, attacks, first_mesh_only| Experiment {
        name,
        settings,
        attacks,
        first_mesh_only,
    };
    let none = || vec![Attack::None];
    let noise = std::iter::once(Attack::None).chain(NOISE.map(Attack::Noise)).collect();
    vec![
        experiment("table 1", settings(&usual, false, None), none(), false),
        experiment("figures 5-9, table 2", settings(&usual, true, None), attacks(), false),
        experiment("figure 10a", settings(&stronger, false, None), none(), true),
        experiment("figure 10b", settings(&longer, false, None), none(), true),
        experiment("figure 11", settings(&longer_own, true, None), noise, true),
    ]
}
