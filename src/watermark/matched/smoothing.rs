//! The smoothing that a suspect may have been through, on the host's vertices, and its adjoint.
//!
//! Must not know marks.

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::adjacency::Adjacency;
use crate::mesh::surface::Surface;

/// Weight of each neighbour's mean per round of smoothing.
pub(super) const HALF: f64 = 0.5;

/// A neighbour, and how many triangles it shares with the vertex.
#[derive(Debug, Clone, Copy)]
struct Link {
    to: u32,
    times: f32,
}

/// `S`, umbrella smoothing with `lambda` 0.5, on a surface.
#[derive(Debug, Clone)]
pub(super) struct Smoothing {
    /// Where each vertex's links start, and where the last ones end.
    starts: Vec<usize>,
    links: Vec<Link>,
    /// Per vertex one over the sum of its links' `times`; 0 without links.
    shares: Vec<f64>,
}

impl Smoothing {
    /// On this surface.
    pub(super) fn new(surface: &Surface) -> Self {
        let count = surface.positions.len();
        let adjacency = Adjacency::new(count, &surface.triangles);
        let mut starts = vec![0];
        let (mut links, mut shares): (Vec<Link>, Vec<f64>) = Default::default();
        let mut around = Vec::new();
        for vertex in 0..count {
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
        Self { starts, links, shares }
    }

    /// Bytes that it takes in memory, about.
    pub(super) fn bytes(&self) -> usize {
        self.links.len() * size_of::<Link>()
            + self.shares.len() * (size_of::<usize>() + size_of::<f64>())
    }

    /// `S`: rounds of going half-way to the mean of the neighbours (each triangle counts its
    /// corners).
    pub(super) fn smoothed(&self, mut field: Vec<DVec3>, rounds: usize) -> Vec<DVec3> {
        let mut next = field.clone();
        for _ in 0..rounds {
            self.round_of(&field, &mut next, |vertex, sum| {
                let own = field[vertex];
                let share = self.shares[vertex];
                if share > 0.0 { own.lerp(sum * share, HALF) } else { own }
            });
            std::mem::swap(&mut field, &mut next);
        }
        field
    }

    /// `S*`: the same, the other way round.
    pub(super) fn adjoint(&self, mut field: Vec<DVec3>, rounds: usize) -> Vec<DVec3> {
        let mut shared = field.clone();
        let mut next = field.clone();
        for _ in 0..rounds {
            let give = |((to, own), share): ((&mut DVec3, &DVec3), &f64)| *to = *own * *share;
            let all = shared.par_iter_mut().zip(&field).zip(&self.shares);
            all.with_min_len(4096).for_each(give);
            self.round_of(&shared, &mut next, |vertex, sum| field[vertex].lerp(sum, HALF));
            std::mem::swap(&mut field, &mut next);
        }
        field
    }

    /// Per vertex what `of` makes of it and the sum over its neighbours.
    fn round_of(
        &self,
        field: &[DVec3],
        next: &mut [DVec3],
        of: impl Fn(usize, DVec3) -> DVec3 + Sync,
    ) {
        let around = |(vertex, next): (usize, &mut DVec3)| {
            let links = &self.links[self.starts[vertex]..self.starts[vertex + 1]];
            let add = |sum, link: &Link| sum + f64::from(link.times) * field[link.to as usize];
            *next = of(vertex, links.iter().fold(DVec3::ZERO, add));
        };
        next.par_iter_mut().enumerate().with_min_len(1024).for_each(around);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;

    #[test]
    fn the_adjoint_is_the_adjoint_and_what_is_even_stays() {
        for sample in Sample::ALL {
            let surface = Surface::new(&sample.mesh(2000).unwrap());
            let smoothing = Smoothing::new(&surface);
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
            let forth = dot(&smoothing.smoothed(a.clone(), 3), &b);
            let back = dot(&a, &smoothing.adjoint(b.clone(), 3));
            assert!((forth - back).abs() <= 1e-9 * forth.abs(), "{sample}: {forth} {back}");
            let even = vec![DVec3::ONE; a.len()];
            let off = |p: &DVec3| p.distance(DVec3::ONE);
            assert!(smoothing.smoothed(even, 5).iter().map(off).fold(0.0, f64::max) < 1e-12);
        }
    }
}
