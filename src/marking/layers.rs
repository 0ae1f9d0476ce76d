//! The layers of a mark, and the mark made of one or both on a host.
//!
//! The relief comes first. The blind layer is then embedded on top of it in its closed loop, so
//! that the blind reader sees what is written. Must not know about bytes or files.

use glam::DVec3;

use super::{MarkError, quality_of};
use crate::mesh::Mesh;
use crate::mesh::quality::Quality;
use crate::mesh::surface::Surface;
use crate::relief::{Amplitude, Field, Signs};
use crate::watermark::{Codeword, EmbedParams, Embedding, Host, MarkKey, WatermarkError, embed};

/// The new positions of a host's vertices.
pub(super) struct Placed {
    /// Positions of all file vertices, rounded as the file stores them.
    pub(super) positions: Vec<DVec3>,
    /// The result of the blind layer; none without it.
    pub(super) embedding: Option<Embedding>,
    pub(super) quality: Quality,
}

/// A host to be marked.
pub(super) struct UnmarkedHost<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) surface: &'a Surface,
    /// File vertices that cannot move.
    pub(super) pinned: &'a [u32],
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

/// A host with a relief on it.
pub(super) struct WithRelief {
    mesh: Mesh,
    surface: Surface,
}

impl UnmarkedHost<'_> {
    /// Adds a relief with the signs of a key on `field`.
    pub(super) fn raised(
        &self,
        field: &Field,
        signs: &Signs,
        amplitude: Amplitude,
    ) -> Result<WithRelief, MarkError> {
        let mut pinned = vec![false; self.surface.positions.len()];
        for &vertex in self.pinned {
            let carrier = usize::try_from(vertex).ok().and_then(|v| self.surface.carrier_of.get(v));
            let carrier = carrier.and_then(|&c| usize::try_from(c).ok());
            if let Some(pinned) = carrier.and_then(|c| pinned.get_mut(c)) {
                *pinned = true;
            }
        }
        let carriers = field
            .marked_until(self.surface, signs, amplitude.get(), &pinned, self.stop)
            .ok_or(WatermarkError::Cancelled)?;
        let mut positions = self.mesh.positions().to_vec();
        for (position, carrier) in positions.iter_mut().zip(&self.surface.carrier_of) {
            let at = usize::try_from(*carrier).ok().and_then(|carrier| carriers.get(carrier));
            *position = at.copied().unwrap_or(*position);
        }
        let mesh = Mesh::new(positions, self.mesh.triangles().to_vec())
            .map_err(|error| MarkError::Check(error.to_string()))?;
        let surface = Surface { positions: carriers, ..self.surface.clone() };
        Ok(WithRelief { mesh, surface })
    }

    /// Embeds the blind layer, on top of a relief if there is one.
    pub(super) fn embedded(
        &self,
        raised: Option<&WithRelief>,
        codeword: &Codeword,
        params: &EmbedParams,
        round: &(dyn Fn(&mut [DVec3]) + Sync),
    ) -> Result<Placed, MarkError> {
        let (mesh, surface) =
            raised.map_or((self.mesh, self.surface), |raised| (&raised.mesh, &raised.surface));
        let original = Some(self.surface);
        let host = Host { mesh, surface, pinned: self.pinned, round, original };
        let mut embedding = embed(host, codeword, params, self.stop)?;
        let positions = std::mem::take(&mut embedding.positions);
        let quality = quality_of(self.surface, &positions, self.stop)?;
        Ok(Placed { positions, embedding: Some(embedding), quality })
    }

    /// The mark of a relief alone.
    pub(super) fn alone(
        &self,
        raised: &WithRelief,
        round: &(dyn Fn(&mut [DVec3]) + Sync),
    ) -> Result<Placed, MarkError> {
        let mut positions = raised.mesh.positions().to_vec();
        round(&mut positions);
        let quality = quality_of(self.surface, &positions, self.stop)?;
        Ok(Placed { positions, embedding: None, quality })
    }
}

/// The signs of a mark key on a field.
pub(super) fn signs(key: &MarkKey, field: &Field) -> Signs {
    Signs::new(key, field.signs())
}
