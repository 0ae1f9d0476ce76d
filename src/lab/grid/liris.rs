//! The protocol of the LIRIS benchmark: K. Wang, G. Lavoué, F. Denis, A. Baskurt and X. He, *A
//! benchmark for 3D mesh watermarking*, SMI 2010.
//!
//! Marks are as strong as a distortion budget allows. Attacks are in the order of the benchmark's
//! tables.

use super::{Choices, Experiment, or, settings};
use crate::attacks::Attack;
use crate::attacks::crop::Of;
use crate::watermark::{BitCount, Method, Strength};

/// MRMS of the perceptual-quality-oriented protocol, as a share of the diagonal.
pub const PERCEPTUAL_BUDGET: f64 = 8e-4;
/// MRMS of the geometric-quality-oriented protocol.
pub const GEOMETRIC_BUDGET: f64 = 2e-4;

fn attacks() -> Vec<Attack> {
    let smooth = |iterations| Attack::Smooth { lambda: 0.1, iterations };
    let mut all = vec![Attack::None, Attack::Reorder, Attack::Similarity];
    all.extend([0.0005, 0.001, 0.003, 0.005].map(Attack::UniformNoise));
    all.extend([5, 10, 30, 50].map(smooth));
    all.extend([11, 10, 9, 8, 7].map(Attack::Quantise));
    all.extend([0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.975].map(Attack::Simplify));
    all.extend([Attack::Midpoint, Attack::Sqrt3, Attack::Loop]);
    all.extend([0.1, 0.3, 0.5].map(|share| Attack::Crop(share, Of::Vertices)));
    all
}

pub fn experiments(choices: &Choices) -> Vec<Experiment> {
    let choices = Choices {
        methods: or(&choices.methods, &Method::ALL),
        strengths: or(&choices.strengths, &[Strength::MAX]),
        bits: or(&choices.bits, &[BitCount::default()]),
    };
    let budgets =
        [("perceptual budget", PERCEPTUAL_BUDGET), ("geometric budget", GEOMETRIC_BUDGET)];
    budgets
        .into_iter()
        .map(|(name, budget)| Experiment {
            name,
            settings: settings(&choices, true, Some(budget)),
            attacks: attacks(),
            first_mesh_only: false,
        })
        .collect()
}
