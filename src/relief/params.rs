//! The parameters of a mark that concern its layers.

use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

/// Which layers a mark has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layers {
    /// The statistics of the vertex norms, which are read without the host.
    Blind,
    /// The relief, which is read against the kept host.
    Relief,
    /// Both layers; where the mesh cannot carry the blind layer, the relief alone.
    Both,
}

impl Layers {
    /// All values.
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

    /// Whether a reader with the host may find a relief.
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
/// diagonal, 1e-7 to 0.1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Amplitude(f64);

impl Amplitude {
    /// The amplitude `share`, if it is in range.
    ///
    /// # Errors
    /// A text, when the share is out of range or NaN.
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

/// 8e-5: the relief's part of the limit of 0.01 %, which is the default limit of a mark's distortion.
impl Default for Amplitude {
    fn default() -> Self {
        Self(8e-5)
    }
}
