//! Attacks of most families, with few strengths each. Meshes are marked and read as the service
//! does it by default: within a distortion limit, with a relief that is read against the host, and
//! with a blind reading beside it.

use super::{Choices, Experiment, Setting, or, settings};
use crate::attacks::Attack;
use crate::attacks::crop::Of;
use crate::marking::{Layers, MaxDistortion};
use crate::watermark::{BitCount, Method, Strength};

/// Most families, mostly at strengths where marks begin to fail. Families with a strength mostly
/// have three.
const ATTACKS: [Attack; 40] = [
    Attack::None,
    Attack::Similarity,
    Attack::Reorder,
    Attack::RoundTrip,
    Attack::Noise(0.001),
    Attack::Noise(0.003),
    Attack::Noise(0.005),
    Attack::Smooth { lambda: 0.5, iterations: 1 },
    Attack::Smooth { lambda: 0.5, iterations: 5 },
    Attack::Smooth { lambda: 0.5, iterations: 20 },
    Attack::Taubin(50),
    Attack::Cotangent { lambda: 0.5, iterations: 10 },
    Attack::Quantise(10),
    Attack::Quantise(8),
    Attack::Quantise(7),
    Attack::Simplify(0.5),
    Attack::Simplify(0.75),
    Attack::Simplify(0.9),
    Attack::Simplify(0.95),
    Attack::Remesh(1.0),
    Attack::Remesh(0.6),
    Attack::Remesh(0.25),
    Attack::Voxel(0.005),
    Attack::Voxel(0.01),
    Attack::Scan(0.0005),
    Attack::Midpoint,
    Attack::Loop,
    Attack::Crop(0.1, Of::Vertices),
    Attack::Crop(0.5, Of::Vertices),
    Attack::Crop(0.8, Of::Vertices),
    Attack::Fragment(0.1),
    Attack::Fragment(0.05),
    Attack::Fragment(0.02),
    Attack::Spikes { count: 1, height: 0.01 },
    Attack::Collude(3),
    Attack::Collude(10),
    Attack::Collude(30),
    Attack::ReMark,
    Attack::Pipeline(0),
    Attack::Pipeline(1),
];

pub fn experiments(choices: &Choices) -> Vec<Experiment> {
    let choices = Choices {
        methods: or(&choices.methods, &[Method::default()]),
        strengths: or(&choices.strengths, &[Strength::BESIDE_A_RELIEF]),
        bits: or(&choices.bits, &[BitCount::default()]),
    };
    let limit = MaxDistortion::USUAL.get();
    let with_relief = |setting| Setting { layers: Layers::Both, ..setting };
    vec![Experiment {
        name: "quick",
        settings: settings(&choices, true, Some(limit)).into_iter().map(with_relief).collect(),
        attacks: ATTACKS.to_vec(),
        first_mesh_only: false,
    }]
}
