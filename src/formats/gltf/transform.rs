//! Conversion between the file's 32-bit local coordinates and world space.
//!
//! Reader, rounding and writer share this arithmetic, so that what is written reads back to the
//! bit.

use glam::{DAffine3, DVec3};

/// A world matrix and its inverse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Transform {
    to_world: DAffine3,
    to_local: DAffine3,
}

impl Transform {
    /// `None` when the matrix is not finite or flattens space.
    pub(super) fn new(to_world: DAffine3) -> Option<Self> {
        if !to_world.is_finite() || to_world.matrix3.determinant() == 0.0 {
            return None;
        }
        let to_local = to_world.inverse();
        to_local.is_finite().then_some(Self { to_world, to_local })
    }

    /// The world position of a vertex of the file. Adding zero turns -0 into 0: the sign of a zero
    /// in the file, which the writer keeps, must not show in the result.
    pub(super) fn forward(&self, local: [f32; 3]) -> DVec3 {
        self.to_world.transform_point3(DVec3::from_array(local.map(f64::from))) + DVec3::ZERO
    }

    fn backward(&self, world: DVec3) -> Option<[f32; 3]> {
        let local = self.to_local.transform_point3(world).to_array().map(narrow);
        local.iter().all(|c| c.is_finite()).then_some(local)
    }

    /// The nearest position that the file can hold: its local coordinates and its world position.
    ///
    /// The result is a fixed point: settling it again gives the same. With a badly conditioned
    /// matrix, as of a tiny mesh far from the origin, one rounding is not enough for that, so
    /// rounding is repeated. `None` when it does not come to rest, or overflows.
    pub(super) fn settle(&self, world: DVec3) -> Option<([f32; 3], DVec3)> {
        let mut local = self.backward(world)?;
        let mut settled = self.forward(local);
        for _ in 0..8 {
            local = self.backward(settled)?;
            let again = self.forward(local);
            if same(again, settled) {
                return settled.is_finite().then_some((local, settled));
            }
            settled = again;
        }
        None
    }
}

/// Whether two positions are the same bit for bit.
pub(super) fn same(a: DVec3, b: DVec3) -> bool {
    a.to_array().map(f64::to_bits) == b.to_array().map(f64::to_bits)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding to the file's precision is the point"
)]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DQuat};
    use proptest::prelude::*;

    #[test]
    fn flat_and_infinite_matrices_are_refused() {
        for scale in [DVec3::new(1.0, 0.0, 1.0), DVec3::splat(f64::NAN), DVec3::splat(1e-320)] {
            assert_eq!(Transform::new(DAffine3::from_scale(scale)), None, "{scale}");
        }
        assert!(Transform::new(DAffine3::IDENTITY).is_some());
    }

    proptest! {
        #[test]
        fn settling_is_idempotent(
            angle in -3.2..3.2, scale in 1e-3..1e3, shift in -1e9..1e9, x in -1e3..1e3, y in -1.0..1.0
        ) {
            let matrix = DMat3::from_quat(DQuat::from_rotation_y(angle)) * scale;
            let world = DAffine3::from_mat3_translation(matrix, DVec3::new(shift, -shift, 0.0));
            let transform = Transform::new(world).unwrap();
            if let Some((local, settled)) = transform.settle(DVec3::new(x, y, shift + y)) {
                prop_assert!(same(transform.forward(local), settled));
                let (_, again) = transform.settle(settled).unwrap();
                prop_assert!(same(again, settled));
            }
        }

        #[test]
        fn the_identity_rounds_to_the_nearest(x in -1e6..1e6) {
            let transform = Transform::new(DAffine3::IDENTITY).unwrap();
            let (local, _) = transform.settle(DVec3::new(x, 0.0, -0.0)).unwrap();
            prop_assert_eq!(local[0].to_bits(), narrow(x).to_bits());
        }
    }
}
