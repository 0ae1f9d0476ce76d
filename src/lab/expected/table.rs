//! Fitted by `benches/lab/expected.py` to 60 marks of 15 meshes; do not edit.

use super::{Coefficients, Line};

/// In the order of the quick grid.
pub const TABLE: [Coefficients; 20] = [
    Coefficients {
        attack: "no attack",
        theta: [1.4676, 0.9827, 0.5291, 0.0280, 0.0032],
        error: 0.19,
        line: None,
    },
    Coefficients {
        attack: "moved, turned, scaled",
        theta: [1.4676, 0.9827, 0.5291, 0.0280, 0.0032],
        error: 0.19,
        line: None,
    },
    Coefficients {
        attack: "reordered",
        theta: [1.4676, 0.9827, 0.5291, 0.0280, 0.0032],
        error: 0.19,
        line: None,
    },
    Coefficients {
        attack: "GLB and OBJ round trip",
        theta: [1.4676, 0.9827, 0.5291, 0.0280, 0.0032],
        error: 0.19,
        line: None,
    },
    Coefficients {
        attack: "noise 0.1 %",
        theta: [-1.4093, 0.1179, -0.1530, 0.7882, -0.1744],
        error: 4.63,
        line: Some(Line { start: -1.0725, slope: 0.9242, error: 3.06 }),
    },
    Coefficients {
        attack: "noise 0.3 %",
        theta: [3.0308, 0.3443, 0.0257, -0.5036, -0.1603],
        error: 7.66,
        line: Some(Line { start: 1.3708, slope: 0.8984, error: 3.68 }),
    },
    Coefficients {
        attack: "noise 0.5 %",
        theta: [3.7435, 0.5096, 0.0071, -0.6464, -0.6102],
        error: 3.81,
        line: Some(Line { start: 0.1761, slope: 0.8182, error: 2.23 }),
    },
    Coefficients {
        attack: "smoothing 0.5 x 1",
        theta: [-3.9089, 0.4159, 0.5304, 0.4775, -0.0881],
        error: 6.16,
        line: Some(Line { start: 0.2944, slope: 0.9132, error: 3.08 }),
    },
    Coefficients {
        attack: "smoothing 0.5 x 5",
        theta: [-1.1601, 0.9395, 0.4009, 0.0029, -0.4216],
        error: 1.38,
        line: Some(Line { start: 0.4368, slope: 0.9780, error: 0.93 }),
    },
    Coefficients {
        attack: "quantised to 10 bits",
        theta: [1.0667, 0.9874, 0.5671, -0.0165, -0.0422],
        error: 1.21,
        line: Some(Line { start: -0.2911, slope: 0.9736, error: 1.15 }),
    },
    Coefficients {
        attack: "quantised to 8 bits",
        theta: [2.6383, 0.3898, -0.0703, -0.2667, -0.2831],
        error: 7.55,
        line: Some(Line { start: 0.9250, slope: 0.9352, error: 3.17 }),
    },
    Coefficients {
        attack: "simplified by 50 %",
        theta: [-0.1760, 0.4814, 0.3562, -0.0075, 0.0795],
        error: 5.08,
        line: Some(Line { start: -1.4890, slope: 0.8475, error: 4.32 }),
    },
    Coefficients {
        attack: "simplified by 90 %",
        theta: [-4.1393, 0.7000, 0.9136, -0.0628, 0.2494],
        error: 2.97,
        line: Some(Line { start: 0.5561, slope: 0.8553, error: 2.27 }),
    },
    Coefficients {
        attack: "remeshed to 60 %",
        theta: [0.4163, 0.6758, 0.3930, -0.4085, 0.2580],
        error: 4.59,
        line: None,
    },
    Coefficients {
        attack: "subdivided, midpoint",
        theta: [0.3199, 0.6433, 0.3154, 0.0091, 0.2098],
        error: 2.09,
        line: None,
    },
    Coefficients {
        attack: "subdivided, Loop",
        theta: [-4.3209, 0.4431, 0.6059, 0.4548, -0.0405],
        error: 4.98,
        line: Some(Line { start: 1.2107, slope: 0.9254, error: 2.68 }),
    },
    Coefficients {
        attack: "cropped by 10 %",
        theta: [-2.3622, 1.0183, 0.4201, -0.0470, -0.0086],
        error: 0.37,
        line: None,
    },
    Coefficients {
        attack: "1 spike of 1 %",
        theta: [-2.5172, 1.0205, 0.4275, -0.0489, -0.0071],
        error: 0.17,
        line: Some(Line { start: -0.0512, slope: 1.0001, error: 0.15 }),
    },
    Coefficients {
        attack: "mean of 2 copies",
        theta: [-0.6299, 0.0351, 0.1467, 0.0079, 0.1744],
        error: 4.93,
        line: None,
    },
    Coefficients {
        attack: "marked again",
        theta: [-0.1548, -0.1554, -0.0180, -0.1361, 0.1697],
        error: 2.57,
        line: None,
    },
];
