//! Random numbers from seeds. The same seed gives the same numbers in every release.
//!
//! They are raw words of a `ChaCha20` stream with our own arithmetic, since the distributions of
//! the `rand` crate may change from version to version. Must not draw a seed itself.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Random(ChaCha20Rng);

impl Random {
    /// The stream of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self::derived(seed, [0; 3])
    }

    /// A separate stream for each seed and position in an experiment (trial, method, attack, ...).
    #[must_use]
    pub fn derived(seed: u64, place: [u64; 3]) -> Self {
        let [a, b, c] = place;
        let mut key = [0; 32];
        for (bytes, word) in key.chunks_mut(8).zip([seed, a, b, c]) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        Self(ChaCha20Rng::from_seed(key))
    }

    /// 64 random bits.
    pub fn word(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in [0, 1), in steps of 2^-53.
    pub fn share(&mut self) -> f64 {
        const STEPS: f64 = 9_007_199_254_740_992.0; // 2^53
        (self.word() >> 11) as f64 / STEPS
    }

    /// Uniform in [-1, 1).
    pub fn symmetric(&mut self) -> f64 {
        2.0 * self.share() - 1.0
    }

    /// From the standard normal distribution (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        // 1 minus a share is never 0.
        let size = (-2.0 * libm::log(1.0 - self.share())).sqrt();
        size * libm::cos(TAU * self.share())
    }

    /// Uniform on the unit sphere (Archimedes: height and longitude are uniform).
    pub fn direction(&mut self) -> DVec3 {
        let (z, angle) = (self.symmetric(), TAU * self.share());
        let r = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(r * libm::cos(angle), r * libm::sin(angle), z)
    }

    /// A rotation, uniform over all of them (Shoemake 1992).
    pub fn rotation(&mut self) -> DQuat {
        let (u, a, b) = (self.share(), TAU * self.share(), TAU * self.share());
        let (s, t) = ((1.0 - u).sqrt(), u.sqrt());
        DQuat::from_xyzw(s * libm::sin(a), s * libm::cos(a), t * libm::sin(b), t * libm::cos(b))
    }

    /// Uniform below `bound`; 0 when `bound` is 0. Words of the last, incomplete block are drawn
    /// again, so that no value is favoured.
    pub fn below(&mut self, bound: usize) -> usize {
        let bound = u64::try_from(bound).unwrap_or(u64::MAX).max(1);
        let limit = u64::MAX - u64::MAX % bound;
        loop {
            let word = self.word();
            if word < limit {
                return usize::try_from(word % bound).unwrap_or(0);
            }
        }
    }

    /// Puts `items` in a random order (Fisher-Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }

    /// 32 random bytes.
    pub fn bytes(&mut self) -> [u8; 32] {
        let mut bytes = [0; 32];
        for chunk in bytes.chunks_mut(8) {
            chunk.copy_from_slice(&self.word().to_le_bytes());
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_repeat_and_differ_by_place() {
        let words = |mut random: Random| [random.word(), random.word()];
        assert_eq!(words(Random::new(7)), words(Random::new(7)));
        assert_ne!(words(Random::new(7)), words(Random::new(8)));
        assert_ne!(words(Random::derived(7, [0, 1, 0])), words(Random::derived(7, [1, 0, 0])));
    }

    #[test]
    fn directions_and_rotations_have_no_preferred_side() {
        let mut random = Random::new(1);
        let mean = (0..20_000).map(|_| random.direction()).sum::<DVec3>() / 20_000.0;
        assert!(mean.length() < 0.02, "{mean}");
        let mean = (0..20_000).map(|_| random.rotation() * DVec3::X).sum::<DVec3>() / 20_000.0;
        assert!(mean.length() < 0.02, "{mean}");
        assert!((random.direction().length() - 1.0).abs() < 1e-12);
        assert!(random.rotation().is_normalized());
    }

    #[test]
    fn normal_numbers_have_mean_variance_and_kurtosis() {
        let mut random = Random::new(2);
        let numbers: Vec<f64> = (0..100_000).map(|_| random.normal()).collect();
        let moment =
            |power: i32| numbers.iter().map(|x| x.powi(power)).sum::<f64>() / numbers.len() as f64;
        assert!(moment(1).abs() < 0.02, "{}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.02, "{}", moment(2));
        assert!((moment(4) - 3.0).abs() < 0.15, "{}", moment(4));
    }

    #[test]
    fn shuffling_keeps_every_item() {
        let mut items: Vec<u32> = (0..1000).collect();
        Random::new(3).shuffle(&mut items);
        assert!(items.windows(2).any(|w| w[0] > w[1]));
        items.sort_unstable();
        assert!(items.into_iter().eq(0..1000));
    }
}
