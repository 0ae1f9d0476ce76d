//! The layers of a mark, and the mark made of one or both on a host.
//!
//! The relief comes first, then the blind layer is embedded on top of it in its closed loop, so that
//! what the blind reader sees is what is written. Must not know about bytes or files.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use serde::{Serialize, Serializer};

use super::{MarkError, quality_of};
use crate::mesh::Mesh;
use crate::mesh::quality::Quality;
use crate::mesh::surface::Surface;
use crate::relief::{Field, Signs};
use crate::watermark::{Codeword, EmbedParams, Embedding, Host, MarkKey, embed};

/// Which layers a mark has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layers {
    /// The statistics of the vertex norms, which are read without the host.
    Blind,
    /// The relief, which is read against the kept host.
    Relief,
    /// Both; where the mesh cannot carry the blind layer, the relief alone.
    Both,
}

impl Layers {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Blind, Self::Relief, Self::Both];

    /// The name in requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Blind => "blind",
            Self::Relief => "relief",
            Self::Both => "both",
        }
    }

    /// Whether a blind reader may find something.
    #[must_use]
    pub fn has_blind(self) -> bool {
        self != Self::Relief
    }

    /// Whether a reader with the host may find something beside the blind layer.
    #[must_use]
    pub fn has_relief(self) -> bool {
        self != Self::Blind
    }
}

impl fmt::Display for Layers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Layers {
    type Err = &'static str;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|layers| layers.name() == name);
        named.ok_or("must be blind, relief or both")
    }
}

impl Serialize for Layers {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

/// How far the relief moves the surface: root mean square distance as a share of the bounding box's
/// diagonal, from 0.0000001 to 0.1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Amplitude(f64);

impl Amplitude {
    /// # Errors
    /// A text, when it is out of range; also for NaN.
    pub fn new(share: f64) -> Result<Self, String> {
        if (1e-7..=0.1).contains(&share) {
            Ok(Self(share))
        } else {
            Err(format!("{share} is out of range: it is a share of the diagonal, 1e-7 to 0.1"))
        }
    }

    /// The share.
    #[must_use]
    pub fn get(self) -> f64 {
        self.0
    }
}

/// With the blind layer at its usual strength beside it, a mark stays below 0.01 % on nearly all meshes
/// (`benches/fidelity.rs`).
impl Default for Amplitude {
    fn default() -> Self {
        Self(8.5e-5)
    }
}

/// Where the vertices of a host go.
pub(super) struct Placed {
    /// Positions of all file vertices, rounded as the file stores them.
    pub(super) positions: Vec<DVec3>,
    /// What the blind layer reached; none without it.
    pub(super) embedding: Option<Embedding>,
    pub(super) quality: Quality,
}

/// A host to be marked.
pub(super) struct Base<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) surface: &'a Surface,
    /// File vertices that cannot move.
    pub(super) pinned: &'a [u32],
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

/// A host with a relief on it.
pub(super) struct Raised {
    mesh: Mesh,
    surface: Surface,
}

impl Base<'_> {
    /// Adds a relief; `signs` are those of the field.
    pub(super) fn raised(
        &self,
        field: &Field,
        signs: &Signs,
        amplitude: Amplitude,
    ) -> Result<Raised, MarkError> {
        let mut pinned = vec![false; self.surface.positions.len()];
        for &vertex in self.pinned {
            let carrier = usize::try_from(vertex).ok().and_then(|v| self.surface.carrier_of.get(v));
            let carrier = carrier.and_then(|&c| usize::try_from(c).ok());
            if let Some(pinned) = carrier.and_then(|c| pinned.get_mut(c)) {
                *pinned = true;
            }
        }
        let carriers = field.marked(self.surface, signs, amplitude.get(), &pinned);
        let mut positions = self.mesh.positions().to_vec();
        for (position, carrier) in positions.iter_mut().zip(&self.surface.carrier_of) {
            let at = usize::try_from(*carrier).ok().and_then(|carrier| carriers.get(carrier));
            *position = at.copied().unwrap_or(*position);
        }
        let mesh = Mesh::new(positions, self.mesh.triangles().to_vec())
            .map_err(|error| MarkError::Check(error.to_string()))?;
        let surface = Surface { positions: carriers, ..self.surface.clone() };
        Ok(Raised { mesh, surface })
    }

    /// Embeds the blind layer, on top of a relief if there is one.
    pub(super) fn embedded(
        &self,
        raised: Option<&Raised>,
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

    /// A relief alone.
    pub(super) fn alone(
        &self,
        raised: &Raised,
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
