//! Marks of the blind layer alone under the attacks that are forecast: what `benches/lab/forecast.py` fits
//! its models to.

use super::{Choices, Experiment, or, settings};
use crate::forecast::ATTACKS;
use crate::watermark::{BitCount, Method, Strength};

pub fn experiments(choices: &Choices) -> Vec<Experiment> {
    let choices = Choices {
        methods: or(&choices.methods, &[Method::default()]),
        strengths: or(&choices.strengths, &[Strength::default()]),
        bits: or(&choices.bits, &[BitCount::default()]),
    };
    vec![Experiment {
        name: "blind",
        settings: settings(&choices, true, None),
        attacks: ATTACKS.to_vec(),
        first_mesh_only: false,
    }]
}
