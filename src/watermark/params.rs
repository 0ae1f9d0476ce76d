//! The parameters of an embedding: method, strength, number of bits. Each type checks its range.

use std::fmt;
use std::str::FromStr;

use super::WatermarkError;

/// The statistic of a bin that carries its bit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Modulation {
    /// Mean of the norms in the bin, normalised to [0, 1): neutral at 1/2 (paper eq. 8-11).
    Mean,
    /// Mean square of the norms in the bin, normalised to [-1, 1): neutral at 1/3 (eq. 12-15).
    Variance,
}

impl Modulation {
    /// The statistic of a bin that norms fill evenly.
    #[must_use]
    pub fn neutral(self) -> f64 {
        match self {
            Self::Mean => 0.5,
            Self::Variance => 1.0 / 3.0,
        }
    }
}

impl fmt::Display for Modulation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::Variance => "variance",
        })
    }
}

impl FromStr for Modulation {
    type Err = WatermarkError;
    fn from_str(name: &str) -> Result<Self, WatermarkError> {
        match name {
            "mean" => Ok(Self::Mean),
            "variance" => Ok(Self::Variance),
            other => Err(WatermarkError::UnknownModulation(shortened(other))),
        }
    }
}

/// Where on its sphere a vertex with a new norm goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Placement {
    /// Along the ray from the centre (Cho et al. 2007).
    Radial,
    /// Quadric selective placement (paper eq. 17-20).
    Qsp,
    /// The least quadric error on the sphere (method section 4).
    Exact,
}

/// How the new norms of a bin are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shaping {
    /// One power for the whole bin (Cho et al. 2007, paper eq. 9-15).
    PowerMap,
    /// The cheapest moves that reach the same statistic (method section 3).
    Allocation,
}

/// Modulation and placement by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// Mean, radial: Cho et al. 2007.
    ChoMean,
    /// Variance, radial: Cho et al. 2007.
    ChoVar,
    /// Mean, quadric selective placement: Luo and Bors 2009.
    QspMean,
    /// Variance, quadric selective placement: Luo and Bors 2009.
    QspVar,
    /// Mean, least-distortion allocation, exact placement.
    ExactMean,
    /// Variance, least-distortion allocation, exact placement.
    ExactVar,
}

impl Method {
    /// Every method, in the order of the documentation.
    pub const ALL: [Self; 6] =
        [Self::ChoMean, Self::ChoVar, Self::QspMean, Self::QspVar, Self::ExactMean, Self::ExactVar];

    /// The method's name in requests and records.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ChoMean => "cho-mean",
            Self::ChoVar => "cho-var",
            Self::QspMean => "qsp-mean",
            Self::QspVar => "qsp-var",
            Self::ExactMean => "exact-mean",
            Self::ExactVar => "exact-var",
        }
    }

    /// All names, for error texts and help.
    #[must_use]
    pub fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }

    /// The statistic that it moves.
    #[must_use]
    pub fn modulation(self) -> Modulation {
        match self {
            Self::ChoMean | Self::QspMean | Self::ExactMean => Modulation::Mean,
            Self::ChoVar | Self::QspVar | Self::ExactVar => Modulation::Variance,
        }
    }

    /// Where it puts a vertex on its sphere.
    #[must_use]
    pub fn placement(self) -> Placement {
        match self {
            Self::ChoMean | Self::ChoVar => Placement::Radial,
            Self::QspMean | Self::QspVar => Placement::Qsp,
            Self::ExactMean | Self::ExactVar => Placement::Exact,
        }
    }

    /// How it chooses new norms.
    #[must_use]
    pub fn shaping(self) -> Shaping {
        match self {
            Self::ExactMean | Self::ExactVar => Shaping::Allocation,
            Self::ChoMean | Self::ChoVar | Self::QspMean | Self::QspVar => Shaping::PowerMap,
        }
    }
}

/// `exact-mean`: a third of the distortion of `qsp-mean`, and of the two `exact` methods the one that
/// survives more at equal distortion (`benches/metro/robustness.py`).
impl Default for Method {
    fn default() -> Self {
        Self::ExactMean
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Method {
    type Err = WatermarkError;
    fn from_str(name: &str) -> Result<Self, WatermarkError> {
        let named = Self::ALL.into_iter().find(|m| m.name() == name);
        named.ok_or_else(|| WatermarkError::UnknownMethod(shortened(name)))
    }
}

/// At most 40 characters of what a caller sent, for an error text.
fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

/// How far a bin's statistic is moved from neutral (the paper's alpha): 0.01 to 0.25.
///
/// Below 0.01 a bit is lost in the sampling noise of its bin; above 0.25 the power map empties
/// most of the bin.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Strength(f64);

impl Strength {
    /// The largest strength.
    pub const MAX: Self = Self(0.25);

    /// The usual strength beside a relief. The blind layer then has to survive only conversions, moves
    /// and mild noise, and with the matched filter strong noise. This strength costs half of what 0.15
    /// costs, and the closed loop settles in few rounds.
    pub const BESIDE_A_RELIEF: Self = Self(0.1);

    /// The strength `alpha`, if it is in range.
    ///
    /// # Errors
    /// [`WatermarkError::StrengthOutOfRange`], also for NaN.
    pub fn new(alpha: f64) -> Result<Self, WatermarkError> {
        if (0.01..=0.25).contains(&alpha) {
            Ok(Self(alpha))
        } else {
            Err(WatermarkError::StrengthOutOfRange(alpha))
        }
    }

    /// The paper's alpha.
    #[must_use]
    pub fn get(self) -> f64 {
        self.0
    }
}

/// 0.15: with `exact-mean` the strongest that moves nearly all surfaces by less than 0.01 % of their
/// diagonal (MRMS; `benches/fidelity.rs`). The paper's experiments use 0.1.
impl Default for Strength {
    fn default() -> Self {
        Self(0.15)
    }
}

/// Number of bits that a mark carries (the paper's M, also the number of bins): 16 to 256.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BitCount(u16);

impl BitCount {
    /// The number `bits`, if it is in range.
    ///
    /// # Errors
    /// [`WatermarkError::BitsOutOfRange`].
    pub fn new(bits: u32) -> Result<Self, WatermarkError> {
        let in_range = u16::try_from(bits).ok().filter(|b| (16..=256).contains(b));
        in_range.map(Self).ok_or(WatermarkError::BitsOutOfRange(bits))
    }

    /// The paper's M.
    #[must_use]
    pub fn get(self) -> usize {
        usize::from(self.0)
    }
}

/// 64, as in the paper's experiments.
impl Default for BitCount {
    fn default() -> Self {
        Self(64)
    }
}

impl fmt::Display for BitCount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The parameters of one embedding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EmbedParams {
    /// Modulation and placement.
    pub method: Method,
    /// How far the statistics move.
    pub strength: Strength,
    /// Number of bits.
    pub bits: BitCount,
    /// Repeat until the blind reader reads every bit (method section 5). Otherwise the paper's single
    /// pass, which is not checked.
    pub closed_loop: bool,
}

impl Default for EmbedParams {
    fn default() -> Self {
        Self {
            method: Method::default(),
            strength: Strength::default(),
            bits: BitCount::default(),
            closed_loop: true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for method in Method::ALL {
            assert_eq!(method.name().parse::<Method>(), Ok(method));
        }
        for modulation in [Modulation::Mean, Modulation::Variance] {
            assert_eq!(modulation.to_string().parse::<Modulation>(), Ok(modulation));
        }
        assert!(matches!("qsp".parse::<Method>(), Err(WatermarkError::UnknownMethod(_))));
    }

    #[test]
    fn ranges_are_closed_intervals() {
        for (alpha, fits) in
            [(0.01, true), (0.25, true), (0.009, false), (7.0, false), (f64::NAN, false)]
        {
            assert_eq!(Strength::new(alpha).is_ok(), fits, "{alpha}");
        }
        for (bits, fits) in [(16, true), (256, true), (15, false), (257, false), (u32::MAX, false)]
        {
            assert_eq!(BitCount::new(bits).is_ok(), fits, "{bits}");
        }
    }
}
