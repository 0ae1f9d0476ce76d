//! Small powers as products. Sums, products, quotients and square roots are the same on every
//! platform, as IEEE 754 wants them; `powi`, and what the standard library takes from the platform
//! (`sin`, `exp`, `ln` and so on), need not be. Everything else goes through `libm`, which
//! `tests/architecture.rs` holds.

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
