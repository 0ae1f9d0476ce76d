//! Fitted by `benches/lab/expected.py`; do not edit.

use super::Coefficients;

/// In the order of the quick grid.
pub const TABLE: [Coefficients; 20] = [
    Coefficients {
        attack: "no attack",
        theta: [1.5390, 0.9822, 0.5287, 0.0297, 0.0033],
        error: 0.20,
    },
    Coefficients {
        attack: "moved, turned, scaled",
        theta: [1.5390, 0.9822, 0.5287, 0.0297, 0.0033],
        error: 0.20,
    },
    Coefficients {
        attack: "reordered",
        theta: [1.5390, 0.9822, 0.5287, 0.0297, 0.0033],
        error: 0.20,
    },
    Coefficients {
        attack: "GLB and OBJ round trip",
        theta: [1.5390, 0.9822, 0.5287, 0.0297, 0.0033],
        error: 0.20,
    },
    Coefficients {
        attack: "noise 0.1 %",
        theta: [-0.9616, 0.0157, -0.0520, 0.4682, 0.0730],
        error: 4.77,
    },
    Coefficients {
        attack: "noise 0.3 %",
        theta: [3.8521, 0.2980, -0.1399, -0.4989, -0.0638],
        error: 7.14,
    },
    Coefficients {
        attack: "noise 0.5 %",
        theta: [2.5731, 0.4149, -0.0713, -0.3368, -0.6093],
        error: 4.11,
    },
    Coefficients {
        attack: "smoothing 0.5 x 1",
        theta: [-5.0844, 0.2876, 0.5098, 0.7081, -0.0092],
        error: 5.90,
    },
    Coefficients {
        attack: "smoothing 0.5 x 5",
        theta: [-3.5242, 0.8077, 0.7017, 0.0706, -0.4870],
        error: 1.56,
    },
    Coefficients {
        attack: "quantised to 10 bits",
        theta: [2.7163, 0.9679, 0.0940, 0.0689, 0.0246],
        error: 1.95,
    },
    Coefficients {
        attack: "quantised to 8 bits",
        theta: [3.6237, 0.3036, -0.0711, -0.5257, -0.1747],
        error: 6.81,
    },
    Coefficients {
        attack: "simplified by 50 %",
        theta: [-0.6256, 0.3399, 0.2956, 0.1008, 0.0336],
        error: 5.44,
    },
    Coefficients {
        attack: "simplified by 90 %",
        theta: [-3.7201, 0.6340, 0.9318, -0.1993, 0.0406],
        error: 2.43,
    },
    Coefficients {
        attack: "remeshed to 60 %",
        theta: [2.5405, 0.7504, 0.1940, -0.5481, 0.0716],
        error: 4.49,
    },
    Coefficients {
        attack: "subdivided, midpoint",
        theta: [0.2495, 0.5928, 0.3603, 0.0112, -0.1183],
        error: 1.78,
    },
    Coefficients {
        attack: "subdivided, Loop",
        theta: [-4.3575, 0.2930, 0.5498, 0.4882, -0.0690],
        error: 4.86,
    },
    Coefficients {
        attack: "cropped by 10 %",
        theta: [-2.2637, 1.0144, 0.4339, -0.0422, -0.0022],
        error: 0.35,
    },
    Coefficients {
        attack: "1 spike of 1 %",
        theta: [-2.6405, 1.0226, 0.4259, -0.0511, -0.0055],
        error: 0.08,
    },
    Coefficients {
        attack: "mean of 2 copies",
        theta: [0.2175, -0.0557, 0.0173, -0.0376, 0.1411],
        error: 3.31,
    },
    Coefficients {
        attack: "marked again",
        theta: [-1.2744, -0.1847, 0.0170, 0.1050, 0.1437],
        error: 2.73,
    },
];
// 152 marks of 19 meshes; all attacks together: 3.74
