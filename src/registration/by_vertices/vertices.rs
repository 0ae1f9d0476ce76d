//! Suspect vertices that are host vertices. They are found by their signatures. A consensus on a
//! similarity removes the wrong pairs, and the right ones grow over everything that is connected
//! alike.
//!
//! A crop that was moved, rotated, scaled, mirrored and renumbered is brought into the host's
//! coordinates exactly. Under a mark, noise, smoothing or quantisation the pairs stay the same, and
//! the displacements average out. On a surface that was tessellated anew, nothing is found.

use std::collections::VecDeque;
use std::sync::OnceLock;

use super::consensus::{Consensus, consensus, refine};
use super::one_rings::NONE;
use super::refinement::{Contact, polish};
use super::signatures::{Sense, Signature};
use crate::mesh::stop::{STEP, Stop, go_on, mapped, once};
use crate::registration::shape::{Kind, Landmark, Shape};
use crate::registration::similarity::{Pair, Similarity};

/// A pair joins the others if its distance is below this many of their medians.
const NEAR: f64 = 8.0;

/// A pair also joins if its distance is below this share of the host's diagonal. The median of
/// exact copies is zero, and they may have been written with six digits.
const NEARNESS: f64 = 1e-5;

/// Seeds that the consensus uses, and pairs that the last fit uses, at most. More change the centre
/// by less than a thousandth of a per cent, and take seconds on half a million vertices.
const SEEDS: usize = 20_000;
const POLISHED: usize = 60_000;

/// The host's landmarks of both kinds, made once per host.
#[derive(Debug, Clone)]
pub struct Landmarks {
    connectivity: Vec<Landmark>,
    metric: Vec<Landmark>,
}

impl Landmarks {
    /// Collects the landmarks; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new(host: &Shape, stop: Stop<'_>) -> Option<Self> {
        Some(Self {
            connectivity: host.landmarks(Kind::Connectivity, Sense::Along, stop)?,
            metric: host.landmarks(Kind::Metric, Sense::Along, stop)?,
        })
    }

    fn of(&self, kind: Kind) -> &[Landmark] {
        match kind {
            Kind::Connectivity => &self.connectivity,
            Kind::Metric => &self.metric,
        }
    }
}

/// The kinds and senses of a suspect's landmarks, in the order in which they are tried. Files whose
/// triangles wind the other way are rare, so they come last. The sense does not show whether the
/// suspect is a mirror image: its triangles may have been flipped or not.
const WAYS: [(Kind, Sense); 4] = [
    (Kind::Connectivity, Sense::Along),
    (Kind::Metric, Sense::Along),
    (Kind::Connectivity, Sense::Against),
    (Kind::Metric, Sense::Against),
];

/// A suspect's landmarks of each kind and sense, collected when first needed and kept for further
/// hosts.
#[derive(Debug, Clone, Default)]
pub struct Findable([OnceLock<Vec<Landmark>>; WAYS.len()]);

/// A suspect that shares vertices with its host.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedVertices {
    /// From the suspect shape's coordinates to the host shape's.
    pub similarity: Similarity,
    /// Pairs of carrier vertices that are the same vertex, the suspect's first. Ascending by the
    /// suspect's.
    pub pairs: Vec<[u32; 2]>,
    /// Median distance between the pairs, a share of the host's diagonal.
    pub median: f64,
}

/// Finds the vertices that suspect and host share. `None` if there are not enough of them, or once
/// `stop` returns `true`.
#[must_use]
pub fn shared_vertices(
    host: &Shape,
    landmarks: &Landmarks,
    suspect: &Shape,
    findable: &Findable,
    stop: Stop<'_>,
) -> Option<SharedVertices> {
    let mut best: Option<(Consensus, Vec<Seed>, Sense)> = None;
    for ((kind, sense), found) in WAYS.into_iter().zip(&findable.0) {
        let found = once(found, || suspect.landmarks(kind, sense, stop))?;
        let seeds = shared(found, landmarks.of(kind));
        let some = thinned(&seeds, SEEDS);
        let points: Vec<Pair> = some.map(|s| point_pair(host, suspect, s.pair)).collect();
        let either = [false, true].map(|mirrored| consensus(&points, mirrored, stop));
        // A part that is nearly flat agrees with its mirror image nearly as well.
        let Some(found) = either.into_iter().flatten().max_by_key(|c| c.inliers) else { continue };
        let certain = found.inliers * 2 > points.len();
        if best.as_ref().is_none_or(|(c, ..)| found.inliers > c.inliers) {
            best = Some((found, seeds, sense));
        }
        if certain {
            break;
        }
    }
    let (found, seeds, sense) = best?;
    go_on(stop)?;
    grown(host, suspect, &seeds, sense, &found, stop)
}

/// Two vertices with the same signature, and the positions in their one-rings at which it begins.
#[derive(Debug, Clone, Copy)]
struct Seed {
    pair: [u32; 2],
    begins: [u8; 2],
}

fn point_pair(host: &Shape, suspect: &Shape, [s, h]: [u32; 2]) -> Pair {
    let (from, to) = (suspect.positions[s as usize], host.positions[h as usize]);
    Pair { from, to, weight: 1.0 }
}

/// Joins two lists that ascend by hash.
fn shared(suspect: &[Landmark], host: &[Landmark]) -> Vec<Seed> {
    let mut rest = host;
    let mut seeds = Vec::new();
    for mark in suspect {
        let passed = rest.iter().take_while(|l| l.code.hash < mark.code.hash).count();
        rest = &rest[passed..];
        if let Some(twin) = rest.first().filter(|l| l.code.hash == mark.code.hash) {
            let begins = [mark.code.begin, twin.code.begin];
            seeds.push(Seed { pair: [mark.vertex, twin.vertex], begins });
        }
    }
    seeds
}

/// Grows the pairs and fits the similarity to all of them.
fn grown(
    host: &Shape,
    suspect: &Shape,
    seeds: &[Seed],
    sense: Sense,
    found: &Consensus,
    stop: Stop<'_>,
) -> Option<SharedVertices> {
    let mut growth = Growth::new(host, suspect, sense, found, stop)?;
    for step in seeds.chunks(STEP) {
        go_on(stop)?;
        for &seed in step {
            growth.sow(seed);
        }
    }
    growth.spread(stop)?;
    let mut pairs = growth.pairs();
    let some: Vec<[u32; 2]> = thinned(&pairs, POLISHED).copied().collect();
    let points: Vec<Pair> = some.iter().map(|&p| point_pair(host, suspect, p)).collect();
    go_on(stop)?;
    let better = refine(&points, found.similarity, stop).unwrap_or(*found);
    let similarity = polish(&contacts(host, suspect, &some), better.similarity, stop);
    go_on(stop)?;
    // A pair that grew under the first similarity may be too far apart under the better one.
    let limit = near(better.median);
    pairs.retain(|&pair| {
        let Pair { from, to, .. } = point_pair(host, suspect, pair);
        similarity.apply(from).distance(to) < limit
    });
    Some(SharedVertices { similarity, pairs, median: better.median })
}

/// The pairs with the host's normals, without those where the host has none.
fn contacts(host: &Shape, suspect: &Shape, pairs: &[[u32; 2]]) -> Vec<Contact> {
    let contact = |&pair: &[u32; 2]| {
        let Pair { from, to, .. } = point_pair(host, suspect, pair);
        let normal = host.normals[pair[1] as usize];
        normal.is_normalized().then_some(Contact { from, to, normal })
    };
    pairs.iter().filter_map(contact).collect()
}

/// About `most` of the items, evenly spread.
fn thinned<T>(items: &[T], most: usize) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(most).max(1))
}

fn near(median: f64) -> f64 {
    (NEAR * median).max(NEARNESS)
}

/// Pairs that spread from vertex to vertex as long as both meshes are connected alike.
struct Growth<'a> {
    host: &'a Shape,
    suspect: &'a Shape,
    sense: Sense,
    /// The suspect's carriers in the host's coordinates.
    placed: Vec<glam::DVec3>,
    limit: f64,
    host_of: Vec<u32>,
    suspect_of: Vec<u32>,
    /// Paired vertices, and corresponding darts that leave them.
    queue: VecDeque<([u32; 2], [usize; 2])>,
}

impl<'a> Growth<'a> {
    fn new(
        host: &'a Shape,
        suspect: &'a Shape,
        sense: Sense,
        found: &Consensus,
        stop: Stop<'_>,
    ) -> Option<Self> {
        Some(Self {
            host,
            suspect,
            sense,
            placed: mapped(&suspect.positions, stop, |_, &p| found.similarity.apply(p))?,
            limit: near(found.median),
            host_of: vec![NONE; suspect.positions.len()],
            suspect_of: vec![NONE; host.positions.len()],
            queue: VecDeque::new(),
        })
    }

    /// Pairs two vertices unless one is taken or they are too far apart; returns whether it did.
    fn pair(&mut self, [s, h]: [u32; 2]) -> bool {
        let (i, j) = (s as usize, h as usize);
        let free = self.host_of[i] == NONE && self.suspect_of[j] == NONE;
        let fits = free && self.placed[i].distance(self.host.positions[j]) < self.limit;
        if fits {
            self.host_of[i] = h;
            self.suspect_of[j] = s;
        }
        fits
    }

    fn sow(&mut self, Seed { pair: [s, h], begins }: Seed) {
        if self.pair([s, h]) && !begins.contains(&Signature::ANY) {
            let [i, j] = begins.map(usize::from);
            let darts = [self.suspect.rings.darts(s).start + i, self.host.rings.darts(h).start + j];
            self.queue.push_back(([s, h], darts));
        }
    }

    fn spread(&mut self, stop: Stop<'_>) -> Option<()> {
        let mut number = 0_usize;
        while let Some(([s, h], [i, j])) = self.queue.pop_front() {
            number += 1;
            if number.is_multiple_of(STEP) {
                go_on(stop)?;
            }
            let (ours, theirs) = (self.suspect.rings.darts(s), self.host.rings.darts(h));
            let valence = ours.len();
            if valence != theirs.len() {
                continue;
            }
            for step in 0..valence {
                let signed = if self.sense == Sense::Along { step } else { valence - step };
                let dart = ours.start + (i - ours.start + signed) % valence;
                let twin = theirs.start + (j - theirs.start + step) % valence;
                let next = [self.suspect.rings.heads()[dart], self.host.rings.heads()[twin]];
                let backs = [self.suspect.rings.backs()[dart], self.host.rings.backs()[twin]];
                if self.pair(next) && !backs.contains(&NONE) {
                    self.queue.push_back((next, backs.map(|b| b as usize)));
                }
            }
        }
        Some(())
    }

    fn pairs(&self) -> Vec<[u32; 2]> {
        let all = (0..).zip(&self.host_of).filter(|(_, h)| **h != NONE);
        all.map(|(s, &h)| [s, h]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::stop::never;
    use crate::mesh::surface::Surface;
    use crate::registration::by_vertices::signatures::mix;
    use crate::registration::similarity::tests::awkward;
    use crate::sample::Sample;
    use glam::DVec3;

    fn landmarks(host: &Shape) -> Landmarks {
        Landmarks::new(host, &never).unwrap()
    }

    fn shape(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Shape {
        Shape::new(Surface::new(&Mesh::new(positions, triangles).unwrap())).unwrap()
    }

    /// Flips edges at random, so that valences vary as on a scan.
    fn irregular(sample: Sample, vertices: u32) -> Mesh {
        let mesh = sample.mesh(vertices).unwrap();
        let mut triangles = mesh.triangles().to_vec();
        // Quads come as [a, b, c], [a, c, d].
        for (k, quad) in (0..).zip(triangles.chunks_exact_mut(2)) {
            if let [[a, b, c], [_, _, d]] = *quad
                && mix(k, 1) & 1 == 1
            {
                quad.copy_from_slice(&[[a, b, d], [b, c, d]]);
            }
        }
        Mesh::new(mesh.positions().to_vec(), triangles).unwrap()
    }

    /// Keeps what lies beyond a plane, renumbered and moved.
    fn cropped(mesh: &Mesh, share: usize, place: &Similarity) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let normal = DVec3::new(0.3, -0.8, 0.5);
        let mut heights: Vec<f64> = mesh.positions().iter().map(|p| p.dot(normal)).collect();
        heights.sort_unstable_by(f64::total_cmp);
        let plane = heights[heights.len() * share / 100];
        let n = u32::try_from(mesh.positions().len()).unwrap();
        let renumbered = |v: u32| n - 1 - v;
        let keeps =
            |t: &&[u32; 3]| t.iter().all(|&v| mesh.positions()[v as usize].dot(normal) >= plane);
        let kept = mesh.triangles().iter().rev().filter(keeps);
        let triangles = kept.map(|&[a, b, c]| [b, c, a].map(renumbered)).collect();
        (mesh.positions().iter().rev().map(|&p| place.apply(p)).collect(), triangles)
    }

    fn centre_error(
        host: &Shape,
        suspect: &Shape,
        found: &SharedVertices,
        place: &Similarity,
    ) -> f64 {
        let there = place.apply(host.unit.inverse().apply(DVec3::ZERO));
        found.similarity.apply(suspect.unit.apply(there)).length()
    }

    #[test]
    fn fragments_come_home_exactly() {
        let place = awkward(0.37);
        let meshes = [Sample::Blob.mesh(6000).unwrap(), irregular(Sample::Knot, 6000)];
        for mesh in meshes {
            let host = shape(mesh.positions().to_vec(), mesh.triangles().to_vec());
            for share in [10, 50, 80, 93] {
                for mirrored in [false, true] {
                    let place = Similarity { scale: if mirrored { -0.37 } else { 0.37 }, ..place };
                    let (positions, triangles) = cropped(&mesh, share, &place);
                    let suspect = shape(positions, triangles);
                    let found = shared_vertices(
                        &host,
                        &landmarks(&host),
                        &suspect,
                        &Findable::default(),
                        &never,
                    )
                    .unwrap();
                    let error = centre_error(&host, &suspect, &found, &place);
                    assert!(error < 1e-9, "{share}: {error:e}");
                    assert!(found.pairs.len() * 100 > suspect.positions.len() * 95);
                }
            }
        }
    }

    #[test]
    fn noise_and_turned_triangles_do_not_matter_where_connectivity_speaks() {
        let mesh = irregular(Sample::Knot, 10_000);
        let host = shape(mesh.positions().to_vec(), mesh.triangles().to_vec());
        let place = awkward(5.0);
        let (mut positions, mut triangles) = cropped(&mesh, 50, &place);
        // 0.25 % of the diagonal in each coordinate.
        let amount = 0.005 * place.scale / host.unit.scale;
        for (i, p) in (0..).zip(&mut positions) {
            let word = |k: u64| (mix(3 * i + k, 7) >> 40) as f64 / f64::from(1 << 24) - 0.5;
            *p += amount * DVec3::new(word(0), word(1), word(2));
        }
        for t in &mut triangles {
            t.swap(0, 1);
        }
        let suspect = shape(positions, triangles);
        let found =
            shared_vertices(&host, &landmarks(&host), &suspect, &Findable::default(), &never)
                .unwrap();
        let error = centre_error(&host, &suspect, &found, &place);
        assert!(error < 1e-4, "{error:e}");
        assert!(found.pairs.len() * 10 > suspect.positions.len() * 9, "{}", found.pairs.len());
    }

    #[test]
    fn another_shape_has_no_twins() {
        let host = irregular(Sample::Knot, 6000);
        let host = shape(host.positions().to_vec(), host.triangles().to_vec());
        let other = irregular(Sample::Blob, 6000);
        let other = shape(other.positions().to_vec(), other.triangles().to_vec());
        assert_eq!(
            shared_vertices(&host, &landmarks(&host), &other, &Findable::default(), &never),
            None
        );
    }
}
