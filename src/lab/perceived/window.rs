//! One window: the curvatures around a vertex, and the curvatures of their matches.

use glam::DVec3;

use super::curvature::{Inside, Shape, walk};
use super::{Match, STRUCTURE};

/// All windows of one scale.
pub struct Window<'a> {
    pub shape: &'a Shape<'a>,
    /// Curvature of the own vertices, times the longest side.
    pub own: &'a [f64],
    pub matches: &'a [Match],
    pub radius: f64,
}

/// Memory that is reused from window to window.
#[derive(Default)]
pub struct Scratch {
    inside: Inside,
    samples: Vec<Sample>,
}

/// A point in the window: its curvatures, and weights by the distances from the centre.
#[derive(Clone, Copy)]
struct Sample {
    own: f64,
    other: f64,
    own_weight: f64,
    other_weight: f64,
}

impl Window<'_> {
    /// How different the two surfaces are around a vertex; 0 if not at all.
    pub fn difference(&self, vertex: usize, scratch: &mut Scratch) -> f64 {
        let Scratch { inside, samples } = scratch;
        samples.clear();
        let (centre, centre_match) =
            (self.shape.surface.positions[vertex], self.matches[vertex].place);
        let sample = |place: DVec3, matched: DVec3, own: f64, other: f64| Sample {
            own,
            other,
            own_weight: self.weight(place - centre),
            other_weight: self.weight(matched - centre_match),
        };
        // Samples at the vertices inside, and where edges leave the window.
        walk(self.shape, vertex, self.radius, inside, |from, spoke, share| {
            if share < 1.0 {
                let [from, to] = [from, spoke.to].map(|v| v as usize);
                let blend = |a: f64, b: f64| a + share * (b - a);
                let places = &self.shape.surface.positions;
                samples.push(sample(
                    places[from].lerp(places[to], share),
                    self.matches[from].place.lerp(self.matches[to].place, share),
                    blend(self.own[from], self.own[to]),
                    blend(self.matches[from].curvature, self.matches[to].curvature),
                ));
            }
        });
        for &v in &inside.list {
            let v = v as usize;
            let &Match { place, curvature } = &self.matches[v];
            samples.push(sample(self.shape.surface.positions[v], place, self.own[v], curvature));
        }
        compared(samples)
    }

    /// A Gaussian with a standard deviation of half the window's radius.
    fn weight(&self, offset: DVec3) -> f64 {
        let sigma = self.radius / 2.0;
        libm::exp(-offset.length_squared() / (2.0 * sigma * sigma))
    }
}

/// The three terms of MSDM2: means, deviations and covariance.
fn compared(samples: &[Sample]) -> f64 {
    let weighted = |value: &dyn Fn(&Sample) -> f64, weight: &dyn Fn(&Sample) -> f64| {
        let sums = samples
            .iter()
            .fold((0.0, 0.0), |(sum, total), s| (sum + weight(s) * value(s), total + weight(s)));
        // Not 0: the centre has weight 1.
        sums.0 / sums.1
    };
    let (own, other) = (|s: &Sample| s.own_weight, |s: &Sample| s.other_weight);
    let (mean_1, mean_2) = (weighted(&|s| s.own, &own), weighted(&|s| s.other, &other));
    let deviation_1 = weighted(&|s| (s.own - mean_1).powi(2), &own).sqrt();
    let deviation_2 = weighted(&|s| (s.other - mean_2).powi(2), &other).sqrt();
    // Weighted by one surface and divided by the weights of the other, as in the published program.
    let total = |weight: &dyn Fn(&Sample) -> f64| samples.iter().map(weight).sum::<f64>();
    let common = weighted(&|s| (s.own - mean_1) * (s.other - mean_2), &other)
        * (total(&other) / total(&own));
    // The 1 keeps flat windows, where nothing is visible, from counting much.
    let means = (mean_1 - mean_2).abs() / (mean_1.max(mean_2) + 1.0);
    let deviations = (deviation_1 - deviation_2).abs() / (deviation_1.max(deviation_2) + 1.0);
    let structure = (deviation_1 * deviation_2 - common).abs() / (deviation_1 * deviation_2 + 1.0);
    (means + deviations + STRUCTURE * structure) / (2.0 + STRUCTURE)
}
