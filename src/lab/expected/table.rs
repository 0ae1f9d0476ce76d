//! Fitted by `benches/lab/expected.py`; do not edit.

use super::Coefficients;

/// In the order of the quick grid.
pub const TABLE: [Coefficients; 1] =
    [Coefficients { attack: "no attack", theta: [3.0, 1.0, 0.5, 0.0, 0.0], error: 1.0 }];
