//! Fitted by `benches/lab/forecast.py` to 136 marks of 17 meshes; do not edit.

use super::{Coefficients, Line};

/// In the order of the attacks.
pub const TABLE: [Coefficients; 20] = [
    Coefficients {
        attack: "no attack",
        theta: [1.4407, 0.9830, 0.5286, 0.0275, 0.0031],
        error: 0.14,
        line: Some(Line { start: 0.0000, slope: 1.0000, error: 0.14 }),
    },
    Coefficients {
        attack: "moved, turned, scaled",
        theta: [1.4407, 0.9830, 0.5286, 0.0275, 0.0031],
        error: 0.14,
        line: None,
    },
    Coefficients {
        attack: "reordered",
        theta: [1.4407, 0.9830, 0.5286, 0.0275, 0.0031],
        error: 0.14,
        line: None,
    },
    Coefficients {
        attack: "GLB and OBJ round trip",
        theta: [1.4407, 0.9830, 0.5286, 0.0275, 0.0031],
        error: 0.14,
        line: None,
    },
    Coefficients {
        attack: "noise 0.1 %",
        theta: [-1.3140, 0.1596, -0.0174, 0.6183, -0.0527],
        error: 3.59,
        line: Some(Line { start: -1.3657, slope: 1.0813, error: 1.85 }),
    },
    Coefficients {
        attack: "noise 0.3 %",
        theta: [3.9607, 0.3858, -0.0930, -0.5256, -0.1891],
        error: 6.97,
        line: Some(Line { start: -0.6173, slope: 0.8496, error: 3.27 }),
    },
    Coefficients {
        attack: "noise 0.5 %",
        theta: [3.9662, 0.5440, -0.0245, -0.6336, -0.6727],
        error: 3.81,
        line: Some(Line { start: -0.2046, slope: 0.8342, error: 2.41 }),
    },
    Coefficients {
        attack: "smoothing 0.5 x 1",
        theta: [-4.2560, 0.4143, 0.5919, 0.4888, -0.1147],
        error: 5.87,
        line: Some(Line { start: 0.4636, slope: 0.9733, error: 2.72 }),
    },
    Coefficients {
        attack: "smoothing 0.5 x 5",
        theta: [-2.5385, 0.8583, 0.6883, -0.1118, -0.5335],
        error: 1.27,
        line: None,
    },
    Coefficients {
        attack: "quantised to 10 bits",
        theta: [1.0747, 0.9873, 0.5309, 0.0318, 0.0167],
        error: 1.18,
        line: Some(Line { start: -0.4614, slope: 0.9704, error: 1.16 }),
    },
    Coefficients {
        attack: "quantised to 8 bits",
        theta: [4.1185, 0.4176, -0.0891, -0.5681, -0.2345],
        error: 7.01,
        line: Some(Line { start: 0.5720, slope: 0.9053, error: 2.91 }),
    },
    Coefficients {
        attack: "simplified by 50 %",
        theta: [-0.5632, 0.4253, 0.3021, 0.1101, 0.1059],
        error: 5.23,
        line: Some(Line { start: 1.9143, slope: 1.0576, error: 3.05 }),
    },
    Coefficients {
        attack: "simplified by 90 %",
        theta: [-3.2548, 0.8358, 0.8586, -0.1214, 0.0834],
        error: 2.32,
        line: Some(Line { start: 0.6106, slope: 0.8007, error: 1.90 }),
    },
    Coefficients {
        attack: "remeshed to 60 %",
        theta: [2.1445, 0.8069, 0.2686, -0.5732, 0.2537],
        error: 4.56,
        line: None,
    },
    Coefficients {
        attack: "subdivided, midpoint",
        theta: [0.1298, 0.6400, 0.3660, 0.0069, 0.1037],
        error: 2.13,
        line: None,
    },
    Coefficients {
        attack: "subdivided, Loop",
        theta: [-4.6638, 0.4285, 0.7170, 0.3894, -0.0508],
        error: 4.85,
        line: Some(Line { start: 1.7945, slope: 1.0258, error: 2.80 }),
    },
    Coefficients {
        attack: "cropped by 10 %",
        theta: [-2.3051, 1.0145, 0.4324, -0.0450, -0.0002],
        error: 0.40,
        line: None,
    },
    Coefficients {
        attack: "1 spike of 1 %",
        theta: [-2.5901, 1.0208, 0.4265, -0.0505, -0.0077],
        error: 0.17,
        line: Some(Line { start: -0.0363, slope: 1.0000, error: 0.16 }),
    },
    Coefficients {
        attack: "mean of 2 copies",
        theta: [-0.2266, -0.0076, 0.0532, 0.0135, 0.2170],
        error: 3.75,
        line: None,
    },
    Coefficients {
        attack: "marked again",
        theta: [-1.5996, -0.1355, 0.1481, 0.0118, 0.1755],
        error: 3.19,
        line: None,
    },
];
