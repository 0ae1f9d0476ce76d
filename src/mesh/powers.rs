//! Small powers as products. IEEE 754 makes sums, products, quotients and square roots the same on
//! every platform. `powi`, and functions that the standard library takes from the platform (`sin`,
//! `exp`, `ln` and so on), may differ. All other functions come from `libm`; `tests/architecture.rs`
//! checks this.

/// `x * x`.
#[must_use]
pub fn squared(x: f64) -> f64 {
    x * x
}

/// `x * x * x`.
#[must_use]
pub fn cubed(x: f64) -> f64 {
    x * x * x
}
