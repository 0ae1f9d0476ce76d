//! What a mark does to a surface: distances and turned normals between a surface and its moved twin,
//! which has the same triangles at other positions.
//!
//! Measures what [`distortion`](super::distortion) measures, from samples spread and weighted in the
//! same way. Vertex j of the surface is vertex j of the twin, so no search tree is needed. A sample is
//! compared with the twin's triangles around its nearest corner. While the nearest point lies on the
//! border of these triangles, the search continues around the corner of the border there.
//!
//! The result is an upper bound of the distance: the nearest point of the twin that is reached downhill
//! from the sample's own. It is the distance itself where the surface is not folded more tightly than
//! it was moved. A large result is searched for more widely. On dense meshes whose vertices slid over
//! many triangles (a dragon of 435,000 vertices, `qsp`) the maximum may still come out at twice its
//! value; the mean square stays within a few per cent.
//!
//! Must not know what moved the surface.

use glam::DVec3;
use rayon::prelude::*;

use super::adjacency::Adjacency;
use super::distortion::SAMPLES_PER_KIND;
use super::sampling::PLASTIC;
use super::surface::{Surface, doubled_area};
use super::turning::turning_until;
use crate::mesh::powers::squared;

/// Samples on edges and in triangles, each. They are weighted as if they were [`SAMPLES_PER_KIND`].
const SAMPLES: usize = 60_000;

/// Largest number of vertices from which the mean square of all is estimated. The maximum considers all
/// vertices.
const VERTICES: usize = 100_000;

/// Vertices or triangles per task: a constant, because sums are added block by block.
const BLOCK: usize = 4096;

/// Largest number of corners around which one sample searches. Marks need one or two; the limit keeps a
/// search after a large move from walking over the whole mesh.
const MOST_STEPS: usize = 16;

/// Share of the diagonal. A sample farther away than this, where vertices moved farther than the
/// distance found, is searched for more widely. These few samples decide the mean square and the
/// maximum. Without the wider search, a coarse gear with vertices that slid over several triangles came
/// out at 1.36 times its MRMS.
const FAR: f64 = 2e-4;

/// Largest number of vertices around which the wider search looks.
const MOST_SEARCHED: usize = 64;

/// Distances and turns between a surface and its moved twin. Lengths are shares of the diagonal of the
/// bounding box.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Quality {
    /// Larger of the two root mean square distances, as Metro measures it.
    pub mrms: f64,
    /// Largest distance of a sample.
    pub hausdorff: f64,
    /// Longest move of a vertex, along the surface or off it.
    pub max_displacement: f64,
    /// Mean angle by which the triangles' normals turned, weighted by area.
    pub normal_deviation_degrees: f64,
    /// Triangles that turned by more than 90 degrees.
    pub flipped: usize,
}

/// Measures a surface against itself with the carriers at `moved`.
///
/// Returns `None` when there is nothing to measure: no triangle, another number of positions than
/// carriers, or coordinates so large that their squares are not finite.
#[must_use]
pub fn quality(surface: &Surface, moved: &[DVec3]) -> Option<Quality> {
    quality_until(surface, moved, &|| false)
}

/// As [`quality`], calling `stop` before each few thousand samples; `None` once it answers `true`.
#[must_use]
pub fn quality_until(
    surface: &Surface,
    moved: &[DVec3],
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Quality> {
    measured(surface, moved, SAMPLES, SAMPLES_PER_KIND, stop)
}

/// As [`quality`], with `samples` per kind, weighted as if they were `weight`.
fn measured(
    surface: &Surface,
    moved: &[DVec3],
    samples: usize,
    weight: usize,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Quality> {
    let host = surface.positions.as_slice();
    // The number of corners must fit in 32 bits.
    u32::try_from(surface.triangles.len().checked_mul(3)?).ok()?;
    if host.len() != moved.len() || surface.triangles.is_empty() {
        return None;
    }
    let around = Adjacency::new_until(host.len(), &surface.triangles, stop)?;
    let (triangles, around) = (surface.triangles.as_slice(), &around);
    let diagonal = surface.diagonal();
    let far = squared(FAR * diagonal);
    let there =
        Side { triangles, around, from: moved, to: host, far, stop }.measure(samples, weight);
    let back =
        Side { triangles, around, from: host, to: moved, far, stop }.measure(samples, weight);
    if stop() {
        return None;
    }
    let farthest = host.iter().zip(moved).map(|(a, b)| a.distance_squared(*b)).fold(0.0, f64::max);
    let turned = turning_until(surface, moved, stop)?;
    let quality = Quality {
        mrms: there.0.max(back.0).sqrt() / diagonal,
        hausdorff: there.1.max(back.1).sqrt() / diagonal,
        max_displacement: farthest.sqrt() / diagonal,
        normal_deviation_degrees: turned.mean_degrees,
        flipped: turned.flipped,
    };
    let numbers = [
        there.0 + back.0,
        quality.mrms,
        quality.hausdorff,
        quality.max_displacement,
        quality.normal_deviation_degrees,
    ];
    numbers.iter().all(|number| number.is_finite()).then_some(quality)
}

/// Squared distances of samples.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    squares: f64,
    count: f64,
    largest: f64,
}

impl Sums {
    fn add(&mut self, squared: f64) {
        self.squares += squared;
        self.count += 1.0;
        self.largest = self.largest.max(squared);
    }

    fn and(self, other: Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            count: self.count + other.count,
            largest: self.largest.max(other.largest),
        }
    }

    fn mean(self) -> f64 {
        if self.count > 0.0 { self.squares / self.count } else { 0.0 }
    }
}

/// From the surface at one set of positions to its twin at the other.
struct Side<'a> {
    triangles: &'a [[u32; 3]],
    around: &'a Adjacency,
    from: &'a [DVec3],
    to: &'a [DVec3],
    /// Squared distance beyond which a sample is searched for more widely, see [`FAR`].
    far: f64,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl Side<'_> {
    /// Mean and largest squared distance.
    fn measure(&self, samples: usize, weight: usize) -> (f64, f64) {
        let vertices = self.at_vertices();
        let (edges, faces) = self.between(samples);
        let (ours, theirs) = (vertices.count, weight as f64);
        let mean = (ours * vertices.mean() + theirs * (edges.mean() + faces.mean()))
            / (ours + 2.0 * theirs);
        (mean, vertices.largest.max(edges.largest).max(faces.largest))
    }

    fn at_vertices(&self) -> Sums {
        let count = u32::try_from(self.from.len()).unwrap_or(u32::MAX);
        let stride = self.from.len().div_ceil(VERTICES).max(1);
        let starts: Vec<u32> = (0..count).step_by(BLOCK).collect();
        let vertices = |start: u32| (start..count).take(BLOCK);
        let distance = |vertex| self.distance([vertex; 3], self.from[vertex as usize], vertex);
        let block = |&start: &u32| {
            let mut sums = Sums::default();
            if (self.stop)() {
                return sums;
            }
            for vertex in vertices(start).step_by(stride) {
                sums.add(distance(vertex));
            }
            sums
        };
        let sums: Vec<Sums> = starts.par_iter().map(block).collect();
        let sums = sums.into_iter().fold(Sums::default(), Sums::and);
        if stride == 1 {
            return sums;
        }
        // No vertex is farther away than it was moved, so few of the other vertices can be the
        // farthest.
        let farthest = |&start: &u32| {
            if (self.stop)() {
                return 0.0;
            }
            vertices(start).fold(sums.largest, |largest, vertex| {
                if self.shift(vertex) > largest { largest.max(distance(vertex)) } else { largest }
            })
        };
        let largest = starts.par_iter().map(farthest).reduce(|| 0.0, f64::max);
        Sums { largest, count: f64::from(count), squares: sums.mean() * f64::from(count) }
    }

    /// Samples on the triangles' sides at equal steps of length, and in the triangles at equal steps of
    /// area. A side that two triangles share is passed twice. All edges of a closed surface therefore
    /// count alike, and edges at a border count half.
    fn between(&self, samples: usize) -> (Sums, Sums) {
        let size = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.from[i as usize]);
            let length = a.distance(b) + b.distance(c) + c.distance(a);
            (length, doubled_area(a, b, c).length())
        };
        let add = |(l, a): (f64, f64), (m, b): (f64, f64)| (l + m, a + b);
        let blocks: Vec<(f64, f64)> = self
            .triangles
            .par_chunks(BLOCK)
            .map(|block| {
                let none = (0.0, 0.0);
                if (self.stop)() { none } else { block.iter().map(size).fold(none, add) }
            })
            .collect();
        let mut total = (0.0, 0.0);
        let mut starts = Vec::with_capacity(blocks.len());
        for block in blocks {
            starts.push(total);
            total = add(total, block);
        }
        let steps = (total.0 / samples as f64, total.1 / samples as f64);
        if !(steps.0 > 0.0 && steps.1 > 0.0 && total.0.is_finite() && total.1.is_finite()) {
            return (Sums::default(), Sums::default());
        }
        let sums: Vec<(Sums, Sums)> = self
            .triangles
            .par_chunks(BLOCK)
            .zip(starts)
            .map(|(block, start)| {
                if (self.stop)() {
                    return (Sums::default(), Sums::default());
                }
                (self.on_sides(block, start.0, steps.0), self.inside(block, start.1, steps.1))
            })
            .collect();
        let none = (Sums::default(), Sums::default());
        sums.into_iter().fold(none, |(e, f), (edges, faces)| (e.and(edges), f.and(faces)))
    }

    fn on_sides(&self, block: &[[u32; 3]], start: f64, step: f64) -> Sums {
        let mut sums = Sums::default();
        let mut passed = start;
        let mut number = (start / step - 0.5).ceil().max(0.0);
        for &[a, b, c] in block {
            for [i, j] in [[a, b], [b, c], [c, a]] {
                let (p, q) = (self.from[i as usize], self.from[j as usize]);
                let length = p.distance(q);
                while (number + 0.5) * step < passed + length {
                    let within = ((number + 0.5) * step - passed) / length;
                    let nearest = if within < 0.5 { i } else { j };
                    sums.add(self.distance([i, j, i], p + (q - p) * within, nearest));
                    number += 1.0;
                }
                passed += length;
            }
        }
        sums
    }

    fn inside(&self, block: &[[u32; 3]], start: f64, step: f64) -> Sums {
        let mut sums = Sums::default();
        let mut passed = start;
        let mut number = (start / step - 0.5).ceil().max(0.0);
        for &corners in block {
            let [a, b, c] = corners.map(|i| self.from[i as usize]);
            let area = doubled_area(a, b, c).length();
            while (number + 0.5) * step < passed + area {
                let [mut u, mut v] = PLASTIC.map(|step| (number * step).fract());
                // The far half of the unit square is folded back onto the triangle.
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                let [i, j, k] = corners;
                let nearest = if u.max(v) < 1.0 - u - v {
                    i
                } else if u > v {
                    j
                } else {
                    k
                };
                sums.add(self.distance(corners, a + (b - a) * u + (c - a) * v, nearest));
                number += 1.0;
            }
            passed += area;
        }
        sums
    }

    /// Squared distance of a sample between `corners`; the search begins at the twin of `start`.
    fn distance(&self, corners: [u32; 3], sample: DVec3, start: u32) -> f64 {
        if corners.iter().all(|&i| self.from[i as usize] == self.to[i as usize]) {
            return 0.0;
        }
        let (mut at, mut best) = (start, f64::INFINITY);
        for _ in 0..MOST_STEPS {
            let mut nearest = None;
            for &triangle in self.around.around(at as usize) {
                let corners = self.triangles[triangle as usize];
                let (squared, feature) =
                    squared_distance(sample, corners.map(|i| self.to[i as usize]));
                if squared < best {
                    (best, nearest) = (squared, Some((corners, feature)));
                }
            }
            let Some((corners, feature)) = nearest else { break };
            // All triangles at the nearest feature meet at each of its corners. Once the triangles
            // around one of these corners were compared, nothing nearby is nearer.
            let on = |corner: &u32| corners.iter().zip(feature).any(|(c, f)| f && c == corner);
            if on(&at) {
                break;
            }
            let Some(next) = corners.iter().copied().find(|corner| on(corner)) else { break };
            at = next;
        }
        // A vertex that moved along the surface may have come to lie near another part of the twin.
        let shift = corners.map(|corner| self.shift(corner)).into_iter().fold(0.0, f64::max);
        if best > self.far && shift > 2.0 * best {
            best.min(self.wider_search(sample, start))
        } else {
            best
        }
    }

    /// Squared length of a vertex's move.
    fn shift(&self, vertex: u32) -> f64 {
        self.from[vertex as usize].distance_squared(self.to[vertex as usize])
    }

    /// Squared distance of a sample to part of the twin: the triangles around the first
    /// [`MOST_SEARCHED`] vertices that connect with `start` inside the ball about the sample through
    /// the twin of `start`.
    fn wider_search(&self, sample: DVec3, start: u32) -> f64 {
        let reach = self.to[start as usize].distance_squared(sample);
        let mut seen = [start; MOST_SEARCHED];
        let (mut next, mut count, mut best) = (0, 1, f64::INFINITY);
        while next < count {
            for &triangle in self.around.around(seen[next] as usize) {
                let corners = self.triangles[triangle as usize];
                let (squared, _) = squared_distance(sample, corners.map(|i| self.to[i as usize]));
                best = best.min(squared);
                for corner in corners {
                    if squared <= reach && count < seen.len() && !seen[..count].contains(&corner) {
                        seen[count] = corner;
                        count += 1;
                    }
                }
            }
            next += 1;
        }
        best
    }
}

/// Squared distance of a point to a triangle, by the region of the triangle's plane that the point
/// projects to (Ericson, Real-Time Collision Detection, 5.1.5), and the corners that span the nearest
/// feature: a corner, a side or the whole triangle.
fn squared_distance(p: DVec3, triangle: [DVec3; 3]) -> (f64, [bool; 3]) {
    let found = off_triangle(p, triangle);
    // Only a triangle without area, to which rounding can shrink a tiny triangle, has no such region.
    if found.0.is_finite() { found } else { off_sides(p, triangle) }
}

/// As [`squared_distance`] for a triangle whose corners lie on one line: the nearest of its sides.
fn off_sides(p: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, [bool; 3]) {
    let side = |from: DVec3, to: DVec3| {
        let along = to - from;
        let share = along.dot(p - from) / along.length_squared();
        let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
        (from + along * share).distance_squared(p)
    };
    let sides = [
        (side(a, b), [true, true, false]),
        (side(b, c), [false, true, true]),
        (side(a, c), [true, false, true]),
    ];
    sides.into_iter().fold(
        (f64::INFINITY, [true; 3]),
        |best, side| {
            if side.0 < best.0 { side } else { best }
        },
    )
}

fn off_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, [bool; 3]) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (ap.length_squared(), [true, false, false]);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (bp.length_squared(), [false, true, false]);
    }
    if d1 * d4 - d3 * d2 <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return ((ap - ab * (d1 / (d1 - d3))).length_squared(), [true, true, false]);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (cp.length_squared(), [false, false, true]);
    }
    if d5 * d2 - d1 * d6 <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return ((ap - ac * (d2 / (d2 - d6))).length_squared(), [true, false, true]);
    }
    let (from_b, from_c) = (d4 - d3, d5 - d6);
    if d3 * d6 - d5 * d4 <= 0.0 && from_b >= 0.0 && from_c >= 0.0 {
        let along = (c - b) * (from_b / (from_b + from_c));
        return ((bp - along).length_squared(), [false, true, true]);
    }
    let normal = ab.cross(ac);
    (squared(ap.dot(normal)) / normal.length_squared(), [true, true, true])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::distortion::distortion;
    use crate::sample::Sample;
    use crate::watermark::{
        Codeword, EmbedParams, Host, MarkKey, Message, Method, Strength, embed,
    };

    fn plate(n: u32) -> Surface {
        let places = (0..=n).flat_map(|i| (0..=n).map(move |j| (f64::from(i), f64::from(j))));
        let at = |i: u32, j: u32| i * (n + 1) + j;
        let quads = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let triangles = quads.flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        });
        let positions = places.map(|(x, y)| DVec3::new(x, y, 0.0)).collect();
        Surface::new(&Mesh::new(positions, triangles.collect()).unwrap())
    }

    #[test]
    fn triangles_that_lost_their_area_are_measured_all_the_same() {
        let plate = plate(4);
        let count = u32::try_from(plate.positions.len()).unwrap();
        let tiny = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| DVec3::splat(9.0) + 0.01 * p);
        let positions = [plate.positions, tiny.to_vec()].concat();
        let triangles = [plate.triangles, vec![[count, count + 1, count + 2]]].concat();
        let surface = Surface::new(&Mesh::new(positions, triangles).unwrap());
        let at = |places: [DVec3; 3]| {
            let mut moved = surface.positions.clone();
            let from = moved.len() - 3;
            moved[from..].copy_from_slice(&places);
            moved
        };
        let [a, b, _] = tiny;
        // A line, two corners on one point, all on one point.
        for places in [[a, b, a.midpoint(b)], [a, b, b], [a, a, b], [a, b, a], [a, a, a]] {
            let measured = quality(&surface, &at(places)).unwrap();
            assert!(measured.mrms > 0.0 && measured.hausdorff < 0.0151 / surface.diagonal());
        }
    }

    #[test]
    fn what_did_not_move_is_at_no_distance() {
        let surface = plate(6);
        let found = quality(&surface, &surface.positions).unwrap();
        let Quality { mrms, hausdorff, max_displacement, normal_deviation_degrees, flipped } =
            found;
        let all = [mrms, hausdorff, max_displacement, normal_deviation_degrees];
        assert!(all.iter().all(|&number| number == 0.0) && flipped == 0, "{found:?}");
    }

    #[test]
    fn a_plate_lifted_off_itself_is_its_gap_away() {
        let surface = plate(6);
        let lifted: Vec<DVec3> = surface.positions.iter().map(|&p| p + DVec3::Z * 0.3).collect();
        let found = quality(&surface, &lifted).unwrap();
        let gap = 0.3 / surface.diagonal();
        for length in [found.mrms, found.hausdorff, found.max_displacement] {
            assert!((length - gap).abs() < 1e-12, "{found:?}");
        }
        assert!(found.normal_deviation_degrees < 1e-12 && found.flipped == 0);
    }

    #[test]
    fn a_move_within_the_plane_is_no_distance_but_a_displacement() {
        let surface = plate(6);
        let inner = |p: DVec3| p.x > 0.5 && p.x < 5.5 && p.y > 0.5 && p.y < 5.5;
        let slide = |&p: &DVec3| if inner(p) { p + DVec3::X * 0.4 } else { p };
        let moved: Vec<DVec3> = surface.positions.iter().map(slide).collect();
        let found = quality(&surface, &moved).unwrap();
        assert!(found.mrms < 1e-12 && found.hausdorff < 1e-12, "{found:?}");
        assert!((found.max_displacement - 0.4 / surface.diagonal()).abs() < 1e-12);
    }

    #[test]
    fn flipped_triangles_are_counted() {
        let surface = plate(6);
        let mut moved = surface.positions.clone();
        // One inner vertex moves beyond the opposite sides of the triangles around it.
        let vertex = surface.positions.iter().position(|p| *p == DVec3::new(3.0, 3.0, 0.0));
        moved[vertex.unwrap()] += DVec3::new(1.5, 0.0, 0.0);
        let found = quality(&surface, &moved).unwrap();
        assert_eq!(found.flipped, super::super::turning::flipped_triangles(&surface, &moved).len());
        assert!(found.flipped > 0 && found.normal_deviation_degrees > 1.0, "{found:?}");
    }

    #[test]
    fn it_is_the_same_on_one_and_on_many_threads() {
        let surface = Surface::new(&Sample::Knot.mesh(20_000).unwrap());
        let moved: Vec<DVec3> =
            surface.positions.iter().map(|&p| p + 0.01 * DVec3::new(p.y, p.z, p.x)).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| quality(&surface, &moved)).unwrap()
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn it_agrees_with_metro_on_marks() {
        for sample in Sample::ALL {
            let mesh = sample.mesh(8_000).unwrap();
            let surface = Surface::new(&mesh);
            for method in [Method::QspMean, Method::ExactMean, Method::ChoMean] {
                let strength = Strength::new(0.1).unwrap();
                let params = EmbedParams { method, strength, ..EmbedParams::default() };
                let message = Message::from_bytes(&[0xa7; 8], params.bits).unwrap();
                let codeword = Codeword::new(&MarkKey::from_bytes([4; 32]), &message);
                let host = Host {
                    mesh: &mesh,
                    surface: &surface,
                    pinned: &[],
                    round: &|_| (),
                    original: None,
                };
                let marked = embed(host, &codeword, &params, &|| false).unwrap().positions;
                let moved: Vec<DVec3> =
                    surface.first_vertex.iter().map(|&v| marked[v as usize]).collect();
                let ours = measured(&surface, &moved, 60_000, 60_000, &|| false).unwrap();
                let twin = Surface { positions: moved, ..surface.clone() };
                let metro = distortion(&surface, &twin, 60_000).unwrap();
                let near = |of: f64, other: f64, tolerance: f64| {
                    let ratio = of * surface.diagonal() / other;
                    assert!(
                        (ratio - 1.0).abs() < tolerance,
                        "{sample} {method}: {ratio} {ours:?} {metro:?}"
                    );
                };
                near(ours.mrms, metro.mrms, 0.05);
                // A maximum depends on the choice of samples.
                near(ours.hausdorff, metro.hausdorff, 0.2);
            }
        }
    }
}
