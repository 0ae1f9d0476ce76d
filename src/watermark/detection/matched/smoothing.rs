//! The smoothing that a suspect may have been through, as an operator on the host's vertices, and its
//! adjoint.
//!
//! Must not know marks.

use glam::DVec3;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::stop::{STEP, Stop, changed, go_on};
use crate::mesh::surface::Surface;

/// Weight of the neighbours' mean per round of smoothing.
pub(super) const LAMBDA: f64 = 0.5;

/// A neighbour, and the number of triangles that it shares with the vertex.
#[derive(Debug, Clone, Copy)]
struct Link {
    to: u32,
    times: f32,
}

/// `S`, umbrella smoothing with `lambda` 0.5, on a surface.
#[derive(Debug, Clone)]
pub(super) struct Smoothing {
    /// Where each vertex's links start; the last entry is the end of all links.
    starts: Vec<usize>,
    links: Vec<Link>,
    /// Per vertex the reciprocal of the sum of its links' `times`; 0 without links.
    shares: Vec<f64>,
}

impl Smoothing {
    /// The smoothing of this surface; `None` once `stop` answers `true`.
    pub(super) fn new_until(surface: &Surface, stop: Stop<'_>) -> Option<Self> {
        let count = surface.positions.len();
        let adjacency = Adjacency::new_until(count, &surface.triangles, stop)?;
        let mut starts = vec![0];
        let (mut links, mut shares): (Vec<Link>, Vec<f64>) = Default::default();
        let mut around = Vec::new();
        for vertex in 0..count {
            if vertex % STEP == 0 {
                go_on(stop)?;
            }
            let triangles = adjacency.around(vertex).iter();
            let corners = triangles.flat_map(|&t| surface.triangles[t as usize]);
            around.clear();
            around.extend(corners.filter(|&corner| corner as usize != vertex));
            around.sort_unstable();
            for same in around.chunk_by(|a, b| a == b) {
                links.extend(same.first().map(|&to| Link { to, times: same.len() as f32 }));
            }
            shares.push(if around.is_empty() { 0.0 } else { (around.len() as f64).recip() });
            starts.push(links.len());
        }
        Some(Self { starts, links, shares })
    }

    /// Approximate size in memory, in bytes.
    pub(super) fn bytes(&self) -> usize {
        self.links.len() * size_of::<Link>()
            + self.shares.len() * (size_of::<usize>() + size_of::<f64>())
    }

    /// `S`: each round moves every vertex half-way to the mean of its neighbours, where each triangle
    /// counts its corners. The result must be discarded once `stop` answers `true`.
    pub(super) fn smoothed_until(
        &self,
        mut field: Vec<DVec3>,
        rounds: usize,
        stop: Stop<'_>,
    ) -> Vec<DVec3> {
        if rounds == 0 {
            return field;
        }
        let mut next = field.clone();
        for _ in 0..rounds {
            let of = |vertex: usize, sum| {
                let own = field[vertex];
                let share = self.shares[vertex];
                if share > 0.0 { own.lerp(sum * share, LAMBDA) } else { own }
            };
            if self.round_of(&field, &mut next, stop, of).is_none() {
                break;
            }
            std::mem::swap(&mut field, &mut next);
        }
        field
    }

    /// `S*`: the adjoint of the same number of rounds. The result must be discarded once `stop` answers
    /// `true`.
    pub(super) fn adjoint_until(
        &self,
        mut field: Vec<DVec3>,
        rounds: usize,
        stop: Stop<'_>,
    ) -> Vec<DVec3> {
        if rounds == 0 {
            return field;
        }
        let mut shared = field.clone();
        let mut next = field.clone();
        for _ in 0..rounds {
            let give = |k: usize, to: &mut DVec3| *to = field[k] * self.shares[k];
            let of = |vertex: usize, sum| field[vertex].lerp(sum, LAMBDA);
            let given = changed(&mut shared, stop, give);
            if given.and_then(|()| self.round_of(&shared, &mut next, stop, of)).is_none() {
                break;
            }
            std::mem::swap(&mut field, &mut next);
        }
        field
    }

    /// Sets each vertex to the value of `of` for the vertex and the sum over its neighbours.
    fn round_of(
        &self,
        field: &[DVec3],
        next: &mut [DVec3],
        stop: Stop<'_>,
        of: impl Fn(usize, DVec3) -> DVec3 + Sync,
    ) -> Option<()> {
        changed(next, stop, |vertex, next| {
            let links = &self.links[self.starts[vertex]..self.starts[vertex + 1]];
            let add = |sum, link: &Link| sum + f64::from(link.times) * field[link.to as usize];
            *next = of(vertex, links.iter().fold(DVec3::ZERO, add));
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::stop::never;
    use crate::sample::Sample;

    #[test]
    fn the_adjoint_is_the_adjoint_and_what_is_even_stays() {
        for sample in Sample::ALL {
            let surface = Surface::new(&sample.mesh(2000).unwrap());
            let smoothing = Smoothing::new_until(&surface, &never).unwrap();
            let field = |k: f64| -> Vec<DVec3> {
                surface
                    .positions
                    .iter()
                    .map(|p| DVec3::new((k * p.x).sin(), p.y * k, p.z))
                    .collect()
            };
            let dot =
                |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
            let (a, b) = (field(3.0), field(-7.0));
            let forth = dot(&smoothing.smoothed_until(a.clone(), 3, &never), &b);
            let back = dot(&a, &smoothing.adjoint_until(b.clone(), 3, &never));
            assert!((forth - back).abs() <= 1e-9 * forth.abs(), "{sample}: {forth} {back}");
            let even = vec![DVec3::ONE; a.len()];
            let off = |p: &DVec3| p.distance(DVec3::ONE);
            assert!(
                smoothing.smoothed_until(even, 5, &never).iter().map(off).fold(0.0, f64::max)
                    < 1e-12
            );
        }
    }
}
