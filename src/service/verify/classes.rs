//! The lattice class as evidence: a codeword is its bits *and* where its bins lie.
//!
//! A record's class is drawn by its key like its bits, uniformly and independently of any file that
//! does not carry the mark. So what a record may spend of the error probability need not be the same
//! for all classes: it may be more where the suspect's statistics look like those of a mark on this
//! lattice, as long as the mean over the classes is one. A part that shows few bins is told by that as by
//! three or four more of them.

use std::collections::BTreeMap;

use crate::watermark::{BitCount, LATTICE_CLASSES, Modulation, Profile, Strength};

/// What is dealt out by rank; the rest goes to all classes alike, so that a suspect whose lattice
/// cannot be told loses little.
const BY_RANK: f64 = 0.5;

/// Shares by lattice class, for the marks of one kind.
type Shares = Vec<f64>;

/// How well a suspect in a frame fits the lattices of each class.
pub(super) struct Classes<'a> {
    profile: &'a Profile,
    known: BTreeMap<(BitCount, Modulation, u64), Shares>,
}

impl<'a> Classes<'a> {
    pub(super) fn new(profile: &'a Profile) -> Self {
        Self { profile, known: BTreeMap::new() }
    }

    /// By what the share of a record of this kind and class is multiplied.
    pub(super) fn share(
        &mut self,
        bits: BitCount,
        modulation: Modulation,
        strength: Strength,
        class: u8,
    ) -> f64 {
        let key = (bits, modulation, strength.get().to_bits());
        let fits = |class| self.profile.likeness(class, bits, modulation, strength);
        let shares = self.known.entry(key).or_insert_with(|| shares(fits));
        shares.get(usize::from(class)).copied().unwrap_or(1.0)
    }
}

/// Shares by class, whose mean is one: inversely by rank.
fn shares(fits: impl Fn(u8) -> f64) -> Shares {
    let mut ranking: Vec<(f64, u8)> = (0..=u8::MAX).map(|class| (fits(class), class)).collect();
    ranking.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let classes = LATTICE_CLASSES as f64;
    let harmonic: f64 = (1..=LATTICE_CLASSES).map(|rank| 1.0 / rank as f64).sum();
    let mut shares = vec![1.0; LATTICE_CLASSES];
    for (rank, (_, class)) in (1_u32..).zip(ranking) {
        let by_rank = classes / (harmonic * f64::from(rank));
        if let Some(share) = shares.get_mut(usize::from(class)) {
            *share = (1.0 - BY_RANK) + BY_RANK * by_rank;
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::surface::Surface;
    use crate::sample::Sample;
    use crate::watermark::{Codeword, EmbedParams, Host, MarkKey, Message, Suspect, embed};

    #[test]
    fn the_mean_share_is_one_and_the_best_fit_has_the_most() {
        for best in [0, 77, 255] {
            let shares = shares(|class| -f64::from(class.abs_diff(best)));
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            assert!((mean - 1.0).abs() < 1e-12, "{mean}");
            assert!(shares.iter().all(|share| *share > 0.5));
            let most = shares.iter().copied().fold(0.0, f64::max);
            assert!(shares[usize::from(best)] >= most && most > 20.0, "{most}");
        }
        // What is no number is in no way likely, and does no harm.
        let none = shares(|_| f64::NAN);
        assert!((none.iter().sum::<f64>() / 256.0 - 1.0).abs() < 1e-12);
    }

    /// Codewords of a random class, each with the share of its class: no more reach a bound than it
    /// says, on a mesh that carries another's mark as on one that carries none.
    #[test]
    fn random_codewords_stay_within_the_bound() {
        const CODEWORDS: u32 = 200_000;
        let host = Sample::Blob.mesh(8000).unwrap();
        let surface = Surface::new(&host);
        let (message, params) =
            (Message::from_bits(vec![true; 64]).unwrap(), EmbedParams::default());
        let seen =
            Host { mesh: &host, surface: &surface, pinned: &[], round: &|_| {}, original: None };
        let other = Codeword::new(&MarkKey::from_bytes([7; 32]), &message);
        let positions = embed(seen, &other, &params, &|| false).unwrap().positions;
        let marked = Mesh::new(positions, host.triangles().to_vec()).unwrap();
        let modulation = params.method.modulation();
        for mesh in [&host, &marked] {
            let suspect = Suspect::new(mesh).unwrap();
            let mut classes = Classes::new(suspect.profile());
            let softs: Vec<_> =
                (0..=u8::MAX).map(|class| suspect.read(class, params.bits, modulation)).collect();
            let mut reached = [0_u32; 3];
            let levels = [-2.0, -2.5, -3.0];
            for id in 0..CODEWORDS {
                let mut key = [0x4e; 32];
                key[..4].copy_from_slice(&id.to_le_bytes());
                let codeword = Codeword::new(&MarkKey::from_bytes(key), &message);
                let class = codeword.lattice_class();
                let soft = &softs[usize::from(class)];
                let score = soft.score(&codeword);
                // (Most are nowhere near.)
                if score.bits_agreeing < 36 {
                    continue;
                }
                let share = classes.share(params.bits, modulation, params.strength, class);
                let bound = soft.log10_bound(score.t) - share.log10();
                for (reached, level) in reached.iter_mut().zip(levels) {
                    *reached += u32::from(bound <= level);
                }
            }
            for (reached, level) in reached.into_iter().zip(levels) {
                let expected = f64::from(CODEWORDS) * 10_f64.powf(level);
                let most = expected + 4.0 * expected.sqrt() + 2.0;
                assert!(f64::from(reached) <= most, "{level}: {reached} of at most {expected}");
                assert!(f64::from(reached) > 0.02 * expected, "{level}: {reached}");
            }
            let best =
                classes.share(params.bits, modulation, params.strength, other.lattice_class());
            println!("share of the other's class: {best}");
        }
    }
}
