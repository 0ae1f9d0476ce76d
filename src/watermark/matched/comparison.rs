//! A suspect seen through the filter of one lattice class: the bits of one mark, alone or beside
//! others.
//!
//! The mean of the copies of several recipients stands, up to noise, at
//! `sum_b a_b E_b + a (m + sum_i c_i D_i / 2)`, with `E_b` where recipient `b`'s mark puts the
//! carriers and shares `a` that nobody knows. Where two marks say the opposite they cancel, and no
//! detector that looks for one of them alone can tell it from chance. But the other codewords are
//! known: with `q_b = E_b - m`, the shares and the bits `x_i` are solved for together,
//! `[G B; B' Q] [x; a] = [t; u]`, where `B_ib = <T_i, q_b>`, `Q_bc = <q_b, q_c>`, `u_b = <r, q_b>`;
//! a ridge on `x` alone makes it unique. What is left of the bits is this mark's.
//!
//! The codewords of the others are independent of the one that is read, so that the bound is as exact
//! as without them; nothing here may depend on that one.

use glam::{DQuat, DVec3};

use super::alike::Alike;
use super::estimate::Normal;
use super::{HostFilter, Sighting, grid_of};
use crate::mesh::stop::Stop;
use crate::watermark::SoftBits;

/// A suspect, made ready to be read.
#[derive(Debug)]
pub struct Comparison<'a> {
    filter: &'a HostFilter,
    rounds: usize,
    /// Per carrier its weight, zero where it was not seen.
    seen: Vec<f64>,
    /// Per carrier where the suspect has it, from the middle; zero where it was not seen.
    rest: Vec<DVec3>,
    normal: Normal,
    /// `t`.
    along: Vec<f64>,
    /// What the cells say, of a suspect on a coarse grid.
    cells: Option<SoftBits>,
}

impl<'a> Comparison<'a> {
    pub(super) fn new(
        filter: &'a HostFilter,
        sightings: &[Sighting],
        turned: Option<DQuat>,
        stop: Stop<'_>,
    ) -> Self {
        let Alike { rounds, middle, nudge } = filter.alike(sightings, turned.is_some(), stop);
        if rounds > 0 {
            let at = |s: &Sighting| Sighting { at: nudge.apply(s.at), ..*s };
            let sightings: Vec<Sighting> = sightings.iter().map(at).collect();
            return Self::after(filter, &sightings, rounds, &middle, stop);
        }
        let grid = grid_of(sightings, turned.unwrap_or_default(), stop);
        let cells = grid.and_then(|grid| filter.by_cells(sightings, &grid, stop));
        Self { cells, ..Self::after(filter, sightings, rounds, &middle, stop) }
    }

    /// Of a suspect that was smoothed in so many rounds, which took the filter's middle to `middle`.
    /// Worth nothing once `stop` answers `true`.
    pub(super) fn after(
        filter: &'a HostFilter,
        sightings: &[Sighting],
        rounds: usize,
        middle: &[DVec3],
        stop: Stop<'_>,
    ) -> Self {
        // (Nothing is paired with no weights.)
        let weights = filter.weights(sightings, rounds, middle, stop).unwrap_or_default();
        let mut rest = vec![DVec3::ZERO; middle.len()];
        let mut seen = vec![0.0; middle.len()];
        for (Sighting { carrier, at }, weight) in sightings.iter().zip(&weights) {
            let carrier = *carrier as usize;
            rest[carrier] = *at - middle[carrier];
            seen[carrier] = *weight;
        }
        let seen = if stop() { Vec::new() } else { seen };
        let weighted: Vec<DVec3> = rest.iter().zip(&seen).map(|(r, w)| *w * *r).collect();
        let noise = weighted.iter().map(|rest| rest.length_squared()).sum::<f64>();
        let noise = noise / (3.0 * seen.iter().sum::<f64>().max(1.0));
        let along = filter.along(&filter.smoothing().adjoint_until(weighted, rounds, stop));
        let gram = filter.gram(&seen, rounds, filter.apart(rounds), stop);
        let normal = Normal::new(gram, along.len(), noise);
        Self { filter, rounds, seen, rest, normal, along, cells: None }
    }

    /// How many rounds of smoothing the suspect seems to have been through.
    #[must_use]
    pub fn rounds(&self) -> usize {
        self.rounds
    }

    /// The bits, if there is one mark only.
    #[must_use]
    pub fn alone(&self) -> SoftBits {
        match &self.cells {
            Some(soft) => soft.clone(),
            None => SoftBits::weighted(self.normal.solve(&self.along)),
        }
    }

    /// The bits beside `others`: where their marks put the carriers ([`HostFilter::expected`], of
    /// whatever class).
    #[must_use]
    pub fn beside(&self, others: &[&[DVec3]]) -> SoftBits {
        let others: Vec<Vec<DVec3>> = others.iter().map(|at| self.off_middle(at)).collect();
        let dot = |a: &[DVec3], b: &[DVec3]| -> f64 {
            let products = a.iter().zip(b).zip(&self.seen);
            products.map(|((a, b), weight)| weight * a.dot(*b)).sum()
        };
        let weighted = |q: &Vec<DVec3>| q.iter().zip(&self.seen).map(|(q, w)| *w * *q).collect();
        let smoothing = self.filter.smoothing();
        let along = |q| self.filter.along(&smoothing.adjoint(weighted(q), self.rounds));
        let cross: Vec<Vec<f64>> = others.iter().map(along).collect();
        let among: Vec<Vec<f64>> =
            others.iter().map(|a| others.iter().map(|b| dot(a, b)).collect()).collect();
        let seen: Vec<f64> = others.iter().map(|q| dot(q, &self.rest)).collect();
        SoftBits::weighted(self.normal.solve_beside(&self.along, &cross, &among, &seen))
    }

    /// The bits below a later mark of another lattice, whose filter (on the same host) is `over`;
    /// `None` of a smoothed suspect, in which bins run into each other.
    ///
    /// The later mark has moved the statistics of its own bins wherever it wanted, so whatever lies
    /// in the span of its differences says nothing of the earlier one: one further unknown for each
    /// of its bins takes that away, whatever its codeword is. Where the bins of the two lattices
    /// overlap in part, the profile of moves within them remains.
    #[must_use]
    pub fn under(&self, over: &HostFilter) -> Option<SoftBits> {
        if self.rounds > 0 || over.difference.len() != self.rest.len() {
            return None;
        }
        let (n, m) = (self.along.len(), over.bits.get());
        // The last unknown is the difference of the two middles.
        let mut cross = vec![vec![0.0; n]; m + 1];
        let mut among = vec![vec![0.0; m + 1]; m + 1];
        let mut seen = vec![0.0; m + 1];
        for (j, (&weight, rest)) in self.seen.iter().zip(&self.rest).enumerate() {
            let middles = weight * (over.middle[j] - self.filter.middle[j]);
            let (theirs, ours) = (weight * over.difference[j], self.filter.difference[j]);
            let (k, i) = (usize::from(over.bins[j]), usize::from(self.filter.bins[j]));
            if let Some(cross) = cross[m].get_mut(i) {
                *cross += middles.dot(ours);
            }
            among[m][m] += middles.dot(over.middle[j] - self.filter.middle[j]);
            seen[m] += middles.dot(*rest);
            if k >= m {
                continue;
            }
            if let Some(cross) = cross[k].get_mut(i) {
                *cross += theirs.dot(ours);
            }
            among[k][k] += theirs.dot(over.difference[j]);
            among[k][m] += middles.dot(over.difference[j]);
            seen[k] += theirs.dot(*rest);
        }
        let last: Vec<f64> = among.iter().map(|row| row[m]).collect();
        among[m] = last;
        Some(SoftBits::weighted(self.normal.solve_beside(&self.along, &cross, &among, &seen)))
    }

    /// `q_b`, smoothed alike.
    fn off_middle(&self, at: &[DVec3]) -> Vec<DVec3> {
        let off = at.iter().zip(&self.filter.middle).map(|(at, middle)| *at - *middle).collect();
        self.filter.smoothing().smoothed(off, self.rounds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::sample::Sample;
    use crate::watermark::pass::Host;
    use crate::watermark::{BitCount, Codeword, EmbedParams, MarkKey, Message, Method, embed};

    fn codeword(recipient: u8) -> Codeword {
        // (Whitened with the key.)
        let message = Message::from_bits(vec![true; 64]).unwrap();
        Codeword::new(&MarkKey::from_bytes([recipient; 32]), &message)
    }

    /// Log10 of the bound of each of `count` recipients whose copies were averaged, alone and beside
    /// the others; then of one who is not among them.
    fn averaged(sample: Sample, method: Method, count: u8) -> Vec<[f64; 2]> {
        let host = sample.mesh(12_000).unwrap();
        let surface = Surface::new(&host);
        let params = EmbedParams { method, bits: BitCount::default(), ..EmbedParams::default() };
        let seen =
            Host { mesh: &host, surface: &surface, pinned: &[], round: &|_| {}, original: None };
        let codewords: Vec<Codeword> = (1..=count + 1).map(codeword).collect();
        let of = |c: &Codeword| HostFilter::new(&host, c.lattice_class(), &params).unwrap();
        let filters: Vec<HostFilter> = codewords.iter().map(of).collect();
        let mut mean = vec![DVec3::ZERO; host.positions().len()];
        for codeword in &codewords[..usize::from(count)] {
            let copy = embed(seen, codeword, &params, &|| false).unwrap().positions;
            mean.iter_mut().zip(copy).for_each(|(mean, at)| *mean += at / f64::from(count));
        }
        let at = |(carrier, &v): (u32, &u32)| Sighting { carrier, at: mean[v as usize] };
        let sightings: Vec<Sighting> = (0..).zip(&surface.first_vertex).map(at).collect();
        let expected: Vec<Vec<DVec3>> =
            filters.iter().zip(&codewords).map(|(filter, c)| filter.expected(c)).collect();
        let bounds = |k: usize| {
            let others: Vec<&[DVec3]> =
                (0..expected.len()).filter(|b| *b != k).map(|b| expected[b].as_slice()).collect();
            let reading = filters[k].compare(&sightings, None);
            [reading.alone(), reading.beside(&others)]
                .map(|soft| soft.log10_bound(soft.score(&codewords[k]).t))
        };
        (0..codewords.len()).map(bounds).collect()
    }

    #[test]
    fn recipients_who_average_their_copies_are_each_read_beside_the_others() {
        for (sample, method) in [(Sample::Blob, Method::ExactMean), (Sample::Knot, Method::QspMean)]
        {
            for count in [2, 3, 5] {
                let bounds = averaged(sample, method, count);
                let (others, innocent) = bounds.split_at(usize::from(count));
                for [alone, beside] in others {
                    assert!(*beside < -14.0 && beside <= alone, "{sample} {count}: {bounds:?}");
                }
                assert!(innocent[0][1] > -4.0, "{sample} {count}: {bounds:?}");
            }
        }
    }

    #[test]
    fn the_only_mark_is_read_as_well_beside_others() {
        let bounds = averaged(Sample::Blob, Method::ExactMean, 1);
        assert!(bounds[0].iter().all(|bound| *bound < -17.0), "{bounds:?}");
        assert!(bounds[1].iter().all(|bound| *bound > -4.0), "{bounds:?}");
    }

    #[test]
    fn a_mark_is_read_below_a_later_one() {
        for (sample, method) in [(Sample::Blob, Method::ExactMean), (Sample::Knot, Method::QspMean)]
        {
            let host = sample.mesh(20_000).unwrap();
            let params = EmbedParams { method, ..EmbedParams::default() };
            let (earlier, later) = (codeword(3), codeword(4));
            let mut now = host.clone();
            for codeword in [&earlier, &later] {
                let surface = Surface::new(&now);
                let seen = Host {
                    mesh: &now,
                    surface: &surface,
                    pinned: &[],
                    round: &|_| {},
                    original: None,
                };
                let marked = embed(seen, codeword, &params, &|| false).unwrap().positions;
                now = Mesh::new(marked, now.triangles().to_vec()).unwrap();
            }
            let filter = |c: &Codeword| HostFilter::new(&host, c.lattice_class(), &params).unwrap();
            let (filter, over) = (filter(&earlier), filter(&later));
            let surface = filter.surface();
            let at =
                |(carrier, &v): (u32, &u32)| Sighting { carrier, at: now.positions()[v as usize] };
            let sightings: Vec<Sighting> = (0..).zip(&surface.first_vertex).map(at).collect();
            let reading = filter.compare(&sightings, None);
            let bound = |soft: SoftBits, c: &Codeword| soft.log10_bound(soft.score(c).t);
            let alone = bound(reading.alone(), &earlier);
            let below = bound(reading.under(&over).unwrap(), &earlier);
            assert!(below < -12.0 && below < alone - 3.0, "{sample}: {below} {alone}");
            let other = bound(reading.under(&over).unwrap(), &codeword(5));
            assert!(other > -4.0, "{sample}: {other}");
        }
    }
}
