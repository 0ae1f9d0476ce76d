//! The container of a stored marked file. Its frames are compressed one by one, so that a part of
//! the file can be read without the rest.
//!
//! All numbers are little endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | the magic `QMF1\r\n\x1a\n` |
//! | 4 | plain bytes of every frame but the last |
//! | 4 | number of frames |
//! | 8 | plain bytes of the file |
//! | 32 | SHA-256 of the plain file |
//! | 12 per frame | stored bytes (4), and the first 8 bytes of the SHA-256 of its plain bytes |
//! | 8 | the first 8 bytes of the SHA-256 of everything above |
//! | the rest | the frames, one after the other |
//!
//! A frame whose stored length equals its plain length is stored as it is; a shorter one is a zstd
//! frame. Pure; must not know where the bytes are kept. The reader treats the bytes as hostile: a
//! backup can be damaged.

use std::ops::Range;

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use crate::mesh::stop::{Stop, go_on, never};

const MAGIC: &[u8; 8] = b"QMF1\r\n\x1a\n";
/// Length of the magic, the three numbers and the hash, which give the length of the header.
pub const PREFIX_BYTES: usize = 8 + 4 + 4 + 8 + 32;
const ENTRY_BYTES: usize = 12;
const CHECK_BYTES: usize = 8;
/// Plain bytes of a frame. A reader holds one or two frames. With frames of 1 MiB, the dragon's OBJ
/// would take 26.7 % of its bytes instead of 27.3 %, a GLB as much as now, and thirty readers four
/// times the memory.
const FRAME_BYTES: usize = 256 << 10;
/// Number of frames that are copied, or hashed, between two queries of `stop`.
const FRAMES: usize = 16;
/// Most plain bytes of a frame that a header may name.
const MOST_FRAME_BYTES: u64 = 4 << 20;
/// Level 3 makes OBJ files 3 % larger than level 1 does, in half as much time again. Level 9 makes
/// them 15 % smaller in eight times the time, which would be half of what the marking takes.
const ZSTD_LEVEL: i32 = 1;

/// Why a stored file cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum MarkedError {
    /// The file is not this container, was changed, or is cut off.
    #[error("the stored file is damaged: {0}")]
    Damaged(&'static str),
    /// The file is longer than the container can hold.
    #[error("the file is too long to be stored")]
    TooLong,
    /// The caller stopped the packing.
    #[error("packing was given up")]
    Stopped,
    /// zstd failed.
    #[error("the file cannot be compressed: {0}")]
    Zstd(#[from] std::io::Error),
}

/// Packs a file whose SHA-256 is `sha256`. The frames are compressed on all cores.
///
/// # Errors
/// [`MarkedError`]; not expected below 2^32 frames.
pub fn pack(plain: &[u8], sha256: &[u8; 32]) -> Result<Vec<u8>, MarkedError> {
    pack_until(plain, sha256, &never)
}

/// The same, as long as `stop` answers `false`.
///
/// # Errors
/// Also [`MarkedError::Stopped`].
pub fn pack_until(plain: &[u8], sha256: &[u8; 32], stop: Stop<'_>) -> Result<Vec<u8>, MarkedError> {
    let heard = || go_on(stop).ok_or(MarkedError::Stopped);
    let frame = |plain: &[u8]| heard().and_then(|()| pack_frame(plain));
    let frames: Vec<([u8; ENTRY_BYTES], Vec<u8>)> =
        plain.par_chunks(FRAME_BYTES).map(frame).collect::<Result<_, MarkedError>>()?;
    let count = u32::try_from(frames.len()).map_err(|_| MarkedError::TooLong)?;
    let frame_bytes = u32::try_from(FRAME_BYTES).map_err(|_| MarkedError::TooLong)?;
    let stored: usize = frames.iter().map(|(_, bytes)| bytes.len()).sum();
    let header = PREFIX_BYTES + frames.len() * ENTRY_BYTES + CHECK_BYTES;
    let mut packed = Vec::with_capacity(header + stored);
    packed.extend_from_slice(MAGIC);
    packed.extend_from_slice(&frame_bytes.to_le_bytes());
    packed.extend_from_slice(&count.to_le_bytes());
    packed.extend_from_slice(&(plain.len() as u64).to_le_bytes());
    packed.extend_from_slice(sha256);
    for (entry, _) in &frames {
        packed.extend_from_slice(entry);
    }
    packed.extend_from_slice(&check_of(&packed));
    for (number, (_, bytes)) in frames.iter().enumerate() {
        if number % FRAMES == 0 {
            heard()?;
        }
        packed.extend_from_slice(bytes);
    }
    Ok(packed)
}

/// The SHA-256 of a file; `None` once `stop` answers `true`.
#[must_use]
pub fn sha256_until(plain: &[u8], stop: Stop<'_>) -> Option<[u8; 32]> {
    let mut hash = Sha256::new();
    for part in plain.chunks(FRAMES * FRAME_BYTES) {
        go_on(stop)?;
        hash.update(part);
    }
    Some(hash.finalize().into())
}

fn pack_frame(plain: &[u8]) -> Result<([u8; ENTRY_BYTES], Vec<u8>), MarkedError> {
    let packed = zstd::bulk::compress(plain, ZSTD_LEVEL)?;
    let stored = if packed.len() < plain.len() { packed } else { plain.to_vec() };
    let length = u32::try_from(stored.len()).map_err(|_| MarkedError::TooLong)?;
    let mut entry = [0; ENTRY_BYTES];
    for (place, byte) in
        entry.iter_mut().zip(length.to_le_bytes().into_iter().chain(check_of(plain)))
    {
        *place = byte;
    }
    Ok((entry, stored))
}

/// Detects damage, not forgery: whoever can write to the store can write a fitting checksum too.
fn check_of(bytes: &[u8]) -> [u8; CHECK_BYTES] {
    let hash: [u8; 32] = Sha256::digest(bytes).into();
    std::array::from_fn(|place| hash.get(place).copied().unwrap_or_default())
}

/// The positions of the frames of a stored file.
#[derive(Debug)]
pub struct Index {
    frame_bytes: u64,
    plain_bytes: u64,
    sha256: [u8; 32],
    frames: Vec<Frame>,
}

#[derive(Debug)]
struct Frame {
    start: u64,
    stored: u64,
    check: [u8; CHECK_BYTES],
}

struct Prefix {
    frame_bytes: u64,
    frames: u64,
    plain_bytes: u64,
    sha256: [u8; 32],
}

impl Prefix {
    fn read(head: &[u8]) -> Result<Self, MarkedError> {
        let cut_off = MarkedError::Damaged("it is cut off");
        let (magic, rest) = head.split_first_chunk::<8>().ok_or(cut_off)?;
        if magic != MAGIC {
            return Err(MarkedError::Damaged("it does not begin with QMF1"));
        }
        let cut_off = || MarkedError::Damaged("it is cut off");
        let (frame_bytes, rest) = rest.split_first_chunk::<4>().ok_or_else(cut_off)?;
        let (frames, rest) = rest.split_first_chunk::<4>().ok_or_else(cut_off)?;
        let (plain_bytes, rest) = rest.split_first_chunk::<8>().ok_or_else(cut_off)?;
        let (sha256, _) = rest.split_first_chunk::<32>().ok_or_else(cut_off)?;
        let prefix = Self {
            frame_bytes: u64::from(u32::from_le_bytes(*frame_bytes)),
            frames: u64::from(u32::from_le_bytes(*frames)),
            plain_bytes: u64::from_le_bytes(*plain_bytes),
            sha256: *sha256,
        };
        if !(1..=MOST_FRAME_BYTES).contains(&prefix.frame_bytes)
            || prefix.plain_bytes.div_ceil(prefix.frame_bytes) != prefix.frames
        {
            return Err(MarkedError::Damaged("its header contradicts itself"));
        }
        Ok(prefix)
    }

    fn header_bytes(&self) -> u64 {
        (PREFIX_BYTES + CHECK_BYTES) as u64 + self.frames * ENTRY_BYTES as u64
    }
}

/// Whether a stored file is in this container. Files that were stored before the container existed
/// are plain files.
#[must_use]
pub fn is_packed(head: &[u8]) -> bool {
    head.starts_with(MAGIC)
}

impl Index {
    /// Length in bytes of the header of a stored file of `blob_bytes`, from its first
    /// [`PREFIX_BYTES`].
    ///
    /// # Errors
    /// [`MarkedError::Damaged`], also when the file is shorter than its header.
    pub fn header_bytes(head: &[u8], blob_bytes: u64) -> Result<u64, MarkedError> {
        let header = Prefix::read(head)?.header_bytes();
        if header > blob_bytes {
            return Err(MarkedError::Damaged("it is cut off"));
        }
        Ok(header)
    }

    /// Reads the header of a stored file of `blob_bytes`. `head` holds at least the whole header.
    ///
    /// # Errors
    /// [`MarkedError::Damaged`] for anything that [`pack`] did not write.
    pub fn read(head: &[u8], blob_bytes: u64) -> Result<Self, MarkedError> {
        let cut_off = || MarkedError::Damaged("it is cut off");
        let prefix = Prefix::read(head)?;
        let header = usize::try_from(prefix.header_bytes()).map_err(|_| MarkedError::TooLong)?;
        let header = head.get(..header).ok_or_else(cut_off)?;
        let (checked, check) = header.split_last_chunk::<CHECK_BYTES>().ok_or_else(cut_off)?;
        if check_of(checked) != *check {
            return Err(MarkedError::Damaged("its header was changed"));
        }
        let mut start = header.len() as u64;
        let mut frames = Vec::new();
        for entry in checked.get(PREFIX_BYTES..).unwrap_or_default().chunks_exact(ENTRY_BYTES) {
            let (stored, check) = entry.split_first_chunk::<4>().ok_or_else(cut_off)?;
            let check = check.first_chunk::<CHECK_BYTES>().ok_or_else(cut_off)?;
            let stored = u64::from(u32::from_le_bytes(*stored));
            frames.push(Frame { start, stored, check: *check });
            start += stored;
        }
        if start != blob_bytes {
            return Err(MarkedError::Damaged("its length is not what its header says"));
        }
        let Prefix { frame_bytes, plain_bytes, sha256, .. } = prefix;
        let index = Self { frame_bytes, plain_bytes, sha256, frames };
        let fits = |(number, frame): (usize, &Frame)| {
            index.plain(number).is_some_and(|plain| frame.stored <= plain.end - plain.start)
        };
        if !index.frames.iter().enumerate().all(fits) {
            return Err(MarkedError::Damaged("a frame is longer than what it holds"));
        }
        Ok(index)
    }

    /// Bytes of the plain file.
    #[must_use]
    pub fn plain_bytes(&self) -> u64 {
        self.plain_bytes
    }

    /// SHA-256 of the plain file, as it was when it was packed.
    #[must_use]
    pub fn sha256(&self) -> &[u8; 32] {
        &self.sha256
    }

    /// The frame that holds the byte at `position`.
    #[must_use]
    pub fn frame_at(&self, position: u64) -> Option<usize> {
        usize::try_from(position / self.frame_bytes).ok().filter(|&frame| frame < self.frames.len())
    }

    /// The range of a frame in the stored file.
    #[must_use]
    pub fn stored(&self, frame: usize) -> Option<Range<u64>> {
        let Frame { start, stored, .. } = *self.frames.get(frame)?;
        Some(start..start + stored)
    }

    /// The range of the plain file that a frame holds.
    #[must_use]
    pub fn plain(&self, frame: usize) -> Option<Range<u64>> {
        let start = (frame as u64).checked_mul(self.frame_bytes)?;
        let end = start.saturating_add(self.frame_bytes).min(self.plain_bytes);
        (start < end).then_some(start..end)
    }

    /// The plain bytes of a frame, checked.
    ///
    /// # Errors
    /// [`MarkedError::Damaged`].
    pub fn unpack(&self, frame: usize, stored: Vec<u8>) -> Result<Vec<u8>, MarkedError> {
        let missing = MarkedError::Damaged("there is no such frame");
        let (Some(plain), Some(entry)) = (self.plain(frame), self.frames.get(frame)) else {
            return Err(missing);
        };
        let changed = || MarkedError::Damaged("a frame was changed");
        let length = usize::try_from(plain.end - plain.start).map_err(|_| MarkedError::TooLong)?;
        let plain = if stored.len() == length {
            stored
        } else {
            // The result is at most `MOST_FRAME_BYTES` long, whatever the frame says.
            zstd::bulk::decompress(&stored, length).map_err(|_| changed())?
        };
        if plain.len() != length || check_of(&plain) != entry.check {
            return Err(changed());
        }
        Ok(plain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packed(plain: &[u8]) -> Vec<u8> {
        pack(plain, &Sha256::digest(plain).into()).unwrap()
    }

    fn unpack_all(packed: &[u8]) -> Result<Vec<u8>, MarkedError> {
        let length = packed.len() as u64;
        let header = usize::try_from(Index::header_bytes(packed, length)?).unwrap();
        let index = Index::read(&packed[..header], length)?;
        let mut plain = Vec::new();
        for frame in 0..index.frames.len() {
            let stored = index.stored(frame).unwrap();
            let stored =
                usize::try_from(stored.start).unwrap()..usize::try_from(stored.end).unwrap();
            plain.extend(index.unpack(frame, packed[stored].to_vec())?);
        }
        assert_eq!(plain.len() as u64, index.plain_bytes());
        assert_eq!(<[u8; 32]>::from(Sha256::digest(&plain)), *index.sha256());
        Ok(plain)
    }

    /// Text that compresses, and noise that does not.
    fn samples() -> Vec<Vec<u8>> {
        let noise = |length: u32| -> Vec<u8> {
            (0..length.div_ceil(32)).flat_map(|n| Sha256::digest(n.to_le_bytes())).collect()
        };
        let text = |lines: u32| -> Vec<u8> {
            (0..lines).flat_map(|n| format!("v {}.25 0 -1\n", n % 97).into_bytes()).collect()
        };
        vec![Vec::new(), b"v".to_vec(), text(10), noise(40), text(50_000), noise(600_000)]
    }

    #[test]
    fn what_goes_in_comes_out_and_never_grows_by_more_than_the_header() {
        for plain in samples() {
            let packed = packed(&plain);
            assert_eq!(unpack_all(&packed).unwrap(), plain);
            let frames = plain.len().div_ceil(FRAME_BYTES);
            let header = PREFIX_BYTES + CHECK_BYTES + frames * ENTRY_BYTES;
            assert!(packed.len() <= plain.len() + header);
        }
        let text = &samples()[4];
        assert!(packed(text).len() * 4 < text.len());
    }

    #[test]
    fn every_prefix_is_refused() {
        for plain in [&samples()[2], &samples()[3]] {
            let packed = packed(plain);
            for length in 0..packed.len() {
                assert!(unpack_all(&packed[..length]).is_err(), "{length} bytes");
            }
            assert!(unpack_all(&[packed.as_slice(), b"x"].concat()).is_err());
        }
    }

    #[test]
    fn a_changed_bit_is_noticed_or_changes_nothing() {
        for plain in [&samples()[2], &samples()[3]] {
            let packed = packed(plain);
            let mut unnoticed = 0;
            for place in 0..packed.len() {
                for bit in 0..8 {
                    let mut damaged = packed.clone();
                    damaged[place] ^= 1 << bit;
                    if let Ok(read) = unpack_all(&damaged) {
                        assert!(read == *plain, "bit {bit} of byte {place}");
                        unnoticed += 1;
                    }
                }
            }
            // zstd ignores a few bits of a frame's header.
            assert!(unnoticed <= 4, "{unnoticed}");
        }
    }

    #[test]
    fn a_header_that_promises_much_costs_nothing() {
        let mut promising = packed(&samples()[2]);
        // A header with 2^40 plain bytes in 2^22 frames, and a checksum that fits.
        let frame: u32 = 1 << 18;
        promising.truncate(PREFIX_BYTES);
        promising[8..12].copy_from_slice(&frame.to_le_bytes());
        promising[12..16].copy_from_slice(&(1_u32 << 22).to_le_bytes());
        promising[16..24].copy_from_slice(&(1_u64 << 40).to_le_bytes());
        let check = check_of(&promising);
        promising.extend_from_slice(&check);
        assert!(Index::header_bytes(&promising, promising.len() as u64).is_err());
        assert!(Index::read(&promising, promising.len() as u64).is_err());
        // Frames of an impossible size.
        promising[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(Index::header_bytes(&promising, u64::MAX).is_err());
        promising[8..12].copy_from_slice(&0_u32.to_le_bytes());
        assert!(Index::header_bytes(&promising, u64::MAX).is_err());
    }

    proptest! {
        #[test]
        fn no_bytes_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..200), magic: bool) {
            if magic {
                bytes.splice(0..bytes.len().min(8), MAGIC.iter().copied());
            }
            let _ = unpack_all(&bytes);
        }

        #[test]
        fn damage_never_changes_what_is_read(
            places in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6)
        ) {
            let plain = &samples()[2];
            let mut damaged = packed(plain);
            for (place, value) in places {
                let place = place.index(damaged.len());
                damaged[place] = value;
            }
            if let Ok(read) = unpack_all(&damaged) {
                prop_assert_eq!(&read, plain);
            }
        }
    }
}
