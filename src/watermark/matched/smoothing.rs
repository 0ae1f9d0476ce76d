//! The smoothing that a suspect may have been through, on the host's vertices, and its adjoint.
//!
//! Must not know marks.

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::surface::Surface;

/// Weight of each neighbour's mean per round of smoothing.
pub(super) const HALF: f64 = 0.5;

/// `S`, umbrella smoothing with `lambda` 0.5, on a surface.
#[derive(Clone, Copy)]
pub(super) struct Smoothing<'a> {
    pub(super) surface: &'a Surface,
    pub(super) adjacency: &'a Adjacency,
}

impl Smoothing<'_> {
    /// `S`: rounds of going half-way to the mean of the neighbours (each triangle counts its
    /// corners).
    pub(super) fn smoothed(&self, mut field: Vec<DVec3>, rounds: usize) -> Vec<DVec3> {
        for _ in 0..rounds {
            field =
                self.round_of(
                    &field,
                    |(sum, count), own| {
                        if count > 0.0 { own.lerp(sum / count, HALF) } else { own }
                    },
                );
        }
        field
    }

    /// `S*`: the same, the other way round.
    pub(super) fn adjoint(&self, mut field: Vec<DVec3>, rounds: usize) -> Vec<DVec3> {
        for _ in 0..rounds {
            let share = |(vertex, own): (usize, &DVec3)| {
                let count = 2.0 * self.adjacency.around(vertex).len() as f64;
                if count > 0.0 { *own / count } else { DVec3::ZERO }
            };
            let shares: Vec<DVec3> =
                field.par_iter().enumerate().with_min_len(4096).map(share).collect();
            let passed = self.round_of(&shares, |(sum, _), _| sum);
            field = field.iter().zip(passed).map(|(own, passed)| own.lerp(passed, HALF)).collect();
        }
        field
    }

    /// Per carrier what `of` makes of the sum over its neighbours, their number and its own value.
    fn round_of(
        &self,
        field: &[DVec3],
        of: impl Fn((DVec3, f64), DVec3) -> DVec3 + Sync,
    ) -> Vec<DVec3> {
        let around = |(vertex, &own): (usize, &DVec3)| {
            let (mut sum, mut count) = (DVec3::ZERO, 0.0);
            for &t in self.adjacency.around(vertex) {
                for corner in self.surface.triangles[t as usize] {
                    let corner = corner as usize;
                    if corner != vertex {
                        sum += field[corner];
                        count += 1.0;
                    }
                }
            }
            of((sum, count), own)
        };
        field.par_iter().enumerate().with_min_len(1024).map(around).collect()
    }
}
