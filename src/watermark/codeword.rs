//! Keys and messages to codewords: which bit each bin carries, and where the bins lie.
//!
//! Marks outlive versions (invariant I5). Everything here is built from raw `ChaCha20` words with its
//! own shuffle, pinned by golden vectors, and must never change for scheme version 1.

use std::fmt;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use zeroize::{Zeroize, ZeroizeOnDrop};

use super::{BitCount, WatermarkError};

/// Number of layout classes: how many values the trimmed share eps can take.
pub const LAYOUT_CLASSES: usize = 256;

/// The 32-byte secret of one mark, derived from the service's master key. It is never shown and is
/// wiped when dropped.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct MarkKey([u8; 32]);

impl MarkKey {
    /// Takes 32 uniformly random (or derived) bytes.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The bytes, for layers that draw from their own streams.
    pub(crate) fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Reads 64 hexadecimal digits of either case.
    ///
    /// # Errors
    /// [`WatermarkError::KeyNotHex`].
    pub fn from_hex(digits: &str) -> Result<Self, WatermarkError> {
        let mut bytes = [0; 32];
        hex::decode_to_slice(digits, &mut bytes).map_err(|_| WatermarkError::KeyNotHex)?;
        Ok(Self(bytes))
    }
}

impl fmt::Debug for MarkKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MarkKey(..)")
    }
}

/// The M bits that a mark carries, as its owner knows them. The most significant bit of the first byte
/// comes first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message(Vec<bool>);

impl Message {
    /// The bits of `bytes`, filled up with zero bits at the end.
    ///
    /// # Errors
    /// [`WatermarkError::MessageTooLong`] when `bytes` has more than `bits` bits. Where `bits` is no
    /// multiple of eight, the unused bits of the last byte may be given if they are zero.
    pub fn from_bytes(bytes: &[u8], bits: BitCount) -> Result<Self, WatermarkError> {
        let bits = bits.get();
        let mut all: Vec<bool> =
            bytes.iter().flat_map(|byte| (0..8).rev().map(move |k| byte >> k & 1 == 1)).collect();
        let too_long = all.len() > bits.next_multiple_of(8) || all.iter().skip(bits).any(|&b| b);
        if too_long {
            return Err(WatermarkError::MessageTooLong { given: all.len(), bits });
        }
        all.resize(bits, false);
        Ok(Self(all))
    }

    /// As [`Message::from_bytes`], from hexadecimal digits of either case.
    ///
    /// # Errors
    /// [`WatermarkError::MessageNotHex`] or [`WatermarkError::MessageTooLong`].
    pub fn from_hex(digits: &str, bits: BitCount) -> Result<Self, WatermarkError> {
        if digits.len() > 2 * bits.get().div_ceil(8) {
            return Err(WatermarkError::MessageTooLong {
                given: digits.len().saturating_mul(4),
                bits: bits.get(),
            });
        }
        Self::from_bytes(&hex::decode(digits).map_err(|_| WatermarkError::MessageNotHex)?, bits)
    }

    /// Takes the bits themselves.
    ///
    /// # Errors
    /// [`WatermarkError::BitsOutOfRange`] when there are fewer than 16 or more than 256.
    pub fn from_bits(bits: Vec<bool>) -> Result<Self, WatermarkError> {
        BitCount::new(u32::try_from(bits.len()).unwrap_or(u32::MAX))?;
        Ok(Self(bits))
    }

    /// Number of bits.
    #[must_use]
    pub fn bit_count(&self) -> BitCount {
        // The constructors admit no other length.
        u32::try_from(self.0.len()).ok().and_then(|n| BitCount::new(n).ok()).unwrap_or_default()
    }

    /// The bits in message order.
    #[must_use]
    pub fn bits(&self) -> &[bool] {
        &self.0
    }

    /// The bytes, the last one filled up with zero bits.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.0
            .chunks(8)
            .map(|byte| {
                byte.iter().enumerate().fold(0, |b, (i, &bit)| b | u8::from(bit) << (7 - i))
            })
            .collect()
    }

    /// The bytes in lower-case hexadecimal digits.
    #[must_use]
    pub fn to_hex(&self) -> String {
        hex::encode(self.to_bytes())
    }
}

/// What a mark key determines about a mark of M bits: where the bins lie and how message bits map to
/// bins. The order of the draws from the key's `ChaCha20` stream is fixed: class, permutation,
/// whitening.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule {
    /// The layout class k; the trimmed share is `0.15 (k + 1/2) / 256`.
    pub layout_class: u8,
    /// Per message bit, the bin that carries it.
    pub bin_of_bit: Vec<usize>,
    /// Per bin, whether its bit is inverted. Makes the codeword uniform whatever the message.
    pub whitening: Vec<bool>,
}

impl Schedule {
    /// Draws the schedule from the key's stream (nonce and counter zero).
    #[must_use]
    pub fn new(key: &MarkKey, bits: BitCount) -> Self {
        let mut stream = ChaCha20Rng::from_seed(key.0);
        let layout_class = stream.next_u32().to_le_bytes()[0];
        let mut bin_of_bit: Vec<usize> = (0..bits.get()).collect();
        // Fisher-Yates from the end.
        for last in (1..bin_of_bit.len()).rev() {
            bin_of_bit.swap(last, below(&mut stream, last + 1));
        }
        let mut word = 0;
        let whitening = (0..bits.get())
            .map(|bin| {
                if bin % 32 == 0 {
                    word = stream.next_u32();
                }
                word >> (bin % 32) & 1 == 1
            })
            .collect();
        Self { layout_class, bin_of_bit, whitening }
    }
}

/// A uniform number below `bound` (at most 256) from whole words. Words of the last, incomplete block
/// of `bound` are drawn again, so that no value is likelier than another.
fn below(stream: &mut ChaCha20Rng, bound: usize) -> usize {
    let bound = u32::try_from(bound).unwrap_or(u32::MAX).max(1);
    let limit = u32::MAX - u32::MAX % bound;
    loop {
        let word = stream.next_u32();
        if word < limit {
            return usize::try_from(word % bound).unwrap_or(0);
        }
    }
}

/// The M bits as the bins carry them: permuted and whitened by the mark key.
#[derive(Clone, PartialEq, Eq)]
pub struct Codeword {
    layout_class: u8,
    bits: Vec<bool>,
}

impl fmt::Debug for Codeword {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Its bits would let a reader remove the mark.
        write!(f, "Codeword({} bits)", self.bits.len())
    }
}

impl Codeword {
    /// The codeword of `message` under `key`.
    #[must_use]
    pub fn new(key: &MarkKey, message: &Message) -> Self {
        let schedule = Schedule::new(key, message.bit_count());
        let mut codeword = schedule.whitening;
        for (&bit, &bin) in message.0.iter().zip(&schedule.bin_of_bit) {
            if let Some(carried) = codeword.get_mut(bin) {
                *carried ^= bit;
            }
        }
        Self { layout_class: schedule.layout_class, bits: codeword }
    }

    /// The same bit in all bins, from which the matched filter computes displacements of a host. No
    /// mark carries this codeword.
    #[must_use]
    pub fn uniform(layout_class: u8, bits: BitCount, bit: bool) -> Self {
        Self { layout_class, bits: vec![bit; bits.get()] }
    }

    /// A stand-in for the record's codeword where something about a host must not depend on that
    /// codeword: fixed bits that look random, on a fixed bin layout. `number` selects one of several.
    /// No mark carries this codeword.
    ///
    /// The bin layouts are a sixth and half of the way from the widest bins to the narrowest. The
    /// widest bins are not typical: their last bins hold the few vertices at the ends of the radial
    /// range and cost up to three times as much with one codeword as with another.
    #[must_use]
    pub fn probe(bits: BitCount, number: u8) -> Self {
        let fixed = MarkKey([0x70_u8.wrapping_add(number); 32]);
        let layout_class = if number.is_multiple_of(2) { 43 } else { 128 };
        Self { layout_class, bits: std::mem::take(&mut Schedule::new(&fixed, bits).whitening) }
    }

    /// The layout class, which determines where the bins lie.
    #[must_use]
    pub fn layout_class(&self) -> u8 {
        self.layout_class
    }

    /// Number of bits, which is the number of bins.
    #[must_use]
    pub fn bit_count(&self) -> BitCount {
        // The codeword is as long as the message it was made from.
        u32::try_from(self.bits.len()).ok().and_then(|n| BitCount::new(n).ok()).unwrap_or_default()
    }

    /// Per bin, its bit.
    #[must_use]
    pub fn bits(&self) -> &[bool] {
        &self.bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(first: u8) -> MarkKey {
        MarkKey::from_bytes(std::array::from_fn(|i| {
            first.wrapping_add(u8::try_from(i).unwrap().wrapping_mul(7))
        }))
    }

    #[test]
    fn the_stream_is_chacha20_of_the_key() {
        // RFC 8439, appendix A.1, test vector 1: zero key, nonce and counter.
        let mut stream = ChaCha20Rng::from_seed([0; 32]);
        assert_eq!(stream.next_u32().to_le_bytes(), [0x76, 0xb8, 0xe0, 0xad]);
        assert_eq!(stream.next_u32().to_le_bytes(), [0xa0, 0xf1, 0x3d, 0x90]);
    }

    #[test]
    fn a_schedule_is_a_permutation() {
        for bits in [16, 17, 64, 255, 256] {
            let schedule = Schedule::new(&key(3), BitCount::new(bits).unwrap());
            let mut bins = schedule.bin_of_bit.clone();
            bins.sort_unstable();
            assert!(bins.into_iter().eq(0..bits as usize));
            assert_eq!(schedule.whitening.len(), bits as usize);
        }
    }

    #[test]
    fn messages_read_most_significant_bit_first() {
        let bits = BitCount::new(20).unwrap();
        let message = Message::from_hex("8001", bits).unwrap();
        let ones: Vec<usize> = (0..20).filter(|&i| message.bits()[i]).collect();
        assert_eq!(ones, [0, 15]);
        assert_eq!(message.to_hex(), "800100");
        for (hex, error) in [
            ("00000001", WatermarkError::MessageTooLong { given: 32, bits: 20 }),
            ("000001", WatermarkError::MessageTooLong { given: 24, bits: 20 }),
            ("0g", WatermarkError::MessageNotHex),
            ("123", WatermarkError::MessageNotHex),
        ] {
            assert_eq!(Message::from_hex(hex, bits), Err(error), "{hex}");
        }
        assert!(Message::from_hex("0000f0", bits).is_ok());
    }

    #[test]
    fn equal_messages_under_different_keys_share_nothing() {
        let message = Message::from_hex("00", BitCount::default()).unwrap();
        let (a, b) = (Codeword::new(&key(1), &message), Codeword::new(&key(2), &message));
        assert_ne!(a.bits(), b.bits());
        assert_eq!(format!("{a:?} {:?}", key(1)), "Codeword(64 bits) MarkKey(..)");
    }
}
