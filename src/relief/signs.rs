//! The signs of a mark: one fair, independent sign per cell of the host, from a stream of the mark key
//! that serves nothing else.

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::watermark::MarkKey;

/// The `ChaCha20` stream of the relief. The codeword of the blind layer is drawn from stream 0.
const STREAM: u64 = 1;

/// One sign per cell, 64 to a word, the first cell in the lowest bit.
#[derive(Clone, PartialEq, Eq)]
pub struct Signs(Vec<u64>);

impl std::fmt::Debug for Signs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // The signs would let a reader remove the mark.
        write!(f, "Signs(..)")
    }
}

impl Signs {
    /// The first `cells` signs of a mark key.
    #[must_use]
    pub fn new(key: &MarkKey, cells: usize) -> Self {
        let mut stream = ChaCha20Rng::from_seed(*key.bytes());
        stream.set_stream(STREAM);
        let word = |_| {
            let low = u64::from(stream.next_u32());
            low | u64::from(stream.next_u32()) << 32
        };
        Self((0..cells.div_ceil(64)).map(word).collect())
    }

    /// The sign of a cell, 1 or -1; 0 for a cell beyond those drawn.
    #[must_use]
    pub fn sign(&self, cell: u32) -> f64 {
        let word = usize::try_from(cell / 64).ok().and_then(|at| self.0.get(at));
        word.map_or(0.0, |word| if word >> (cell % 64) & 1 == 1 { 1.0 } else { -1.0 })
    }

    /// The signs, eight to a byte, the first in the lowest bit.
    pub(super) fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        self.0.iter().flat_map(|word| word.to_le_bytes())
    }
}
