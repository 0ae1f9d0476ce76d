//! A few of everything, within minutes.

use super::{Choices, Experiment, or, settings};
use crate::lab::attacks::Attack;
use crate::lab::attacks::crop::Of;
use crate::watermark::{BitCount, Method, Strength};

/// At least one of each family, mostly where marks begin to fail.
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

pub fn experiments(choices: &Choices) -> Vec<Experiment> {
    let choices = Choices {
        methods: or(&choices.methods, &[Method::default()]),
        strengths: or(&choices.strengths, &[Strength::default()]),
        bits: or(&choices.bits, &[BitCount::default()]),
    };
    vec![Experiment {
        name: "quick",
        settings: settings(&choices, true, None),
        attacks: ATTACKS.to_vec(),
        first_mesh_only: false,
    }]
}
