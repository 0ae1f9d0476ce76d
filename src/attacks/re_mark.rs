//! An overmark: marking a marked mesh again.

use glam::DVec3;

use super::AttackError;
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::watermark::{
    Codeword, EmbedParams, Embedding, Host, MarkKey, Message, WatermarkError, embed,
};

/// Embeds a random message under a random key into the mesh, whatever marks it carries already (the
/// second watermark of Cox et al. 1997, section V). Positions are rounded to single precision, as
/// most files store them.
///
/// # Errors
/// [`AttackError::Watermark`] when the mesh does not carry the second mark.
pub fn re_mark(mesh: &Mesh, params: &EmbedParams, seed: u64) -> Result<Mesh, AttackError> {
    let (key, message) = key_and_message(params, &mut Random::new(seed))?;
    let marked = mark(mesh, &Codeword::new(&key, &message), params)?;
    Ok(Mesh::new(marked.positions, mesh.triangles().to_vec())?)
}

/// A random mark key and a random message of the requested length.
///
/// # Errors
/// None in practice: the length comes from a valid [`crate::watermark::BitCount`].
pub fn key_and_message(
    params: &EmbedParams,
    random: &mut Random,
) -> Result<(MarkKey, Message), WatermarkError> {
    let key = MarkKey::from_bytes(random.bytes());
    let bits = (0..params.bits.get()).map(|_| random.word() & 1 == 1).collect();
    Ok((key, Message::from_bits(bits)?))
}

/// Embeds into a mesh in memory. Positions are rounded as a file with single-precision coordinates
/// would store them.
///
/// # Errors
/// As [`embed`].
pub fn mark(
    mesh: &Mesh,
    codeword: &Codeword,
    params: &EmbedParams,
) -> Result<Embedding, WatermarkError> {
    mark_until(mesh, codeword, params, &|| false)
}

/// As [`mark`]; ends when `stop`, which is called between passes, returns `true`.
///
/// # Errors
/// Also [`WatermarkError::Cancelled`].
pub fn mark_until(
    mesh: &Mesh,
    codeword: &Codeword,
    params: &EmbedParams,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Embedding, WatermarkError> {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is meant")]
    let round = |positions: &mut [DVec3]| {
        for p in positions {
            *p = DVec3::from_array(p.to_array().map(|x| f64::from(x as f32)));
        }
    };
    let host =
        Host { mesh, surface: &Surface::new(mesh), pinned: &[], round: &round, original: None };
    embed(host, codeword, params, stop)
}
