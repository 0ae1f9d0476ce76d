//! The errors of the watermark core, one variant per cause.

/// Why a mesh cannot be marked or read, or a parameter is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WatermarkError {
    /// The strength is not a number between 0.01 and 0.25.
    #[error("strength {0} is out of range: it must lie between 0.01 and 0.25")]
    StrengthOutOfRange(f64),
    /// The number of bits is not between 16 and 256.
    #[error("{0} bits are out of range: a mark carries 16 to 256 bits")]
    BitsOutOfRange(u32),
    /// A method of this name does not exist.
    #[error("unknown method {0:?}: the methods are {methods}", methods = crate::watermark::Method::names())]
    UnknownMethod(String),
    /// A modulation of this name does not exist.
    #[error("unknown modulation {0:?}: it is mean or variance")]
    UnknownModulation(String),
    /// The message has more bits than the mark.
    #[error(
        "the message has {given} bits, the mark carries {bits}: shorten it or raise the number of bits"
    )]
    MessageTooLong {
        /// Bits given.
        given: usize,
        /// Bits that the mark carries.
        bits: usize,
    },
    /// A message that is not written in hexadecimal digits.
    #[error("the message is not hexadecimal: use an even number of the digits 0-9 and a-f")]
    MessageNotHex,
    /// A mark key that is not 64 hexadecimal digits.
    #[error("the key must be 64 hexadecimal digits (32 bytes)")]
    KeyNotHex,
    /// Too few bins can carry a bit.
    #[error(
        "the mesh can carry {usable} of {bits} bits and at least {needed} are needed: of its \
         {vertices} carrier vertices, {in_bins} lie in bins and the poorest bin has {least_count} \
         ({reason}); use a mesh with more vertices or a less uniform distance to its centre, or \
         fewer bits"
    )]
    InsufficientCapacity {
        /// Bins that read their bit.
        usable: usize,
        /// Bins that must read their bit.
        needed: usize,
        /// Bins requested.
        bits: usize,
        /// Carrier vertices of the mesh.
        vertices: usize,
        /// Carrier vertices inside the bin layout.
        in_bins: usize,
        /// Vertices of the poorest bin.
        least_count: usize,
        /// What stands in the way.
        reason: &'static str,
    },
    /// All carrier vertices are at the same distance from the centre, or there is no carrier vertex.
    #[error(
        "no radial extent: the {vertices} carrier vertices are all at the same distance from the \
         centre, so nothing can be carried or read there"
    )]
    NoRadialExtent {
        /// Carrier vertices of the mesh.
        vertices: usize,
    },
    /// The caller asked to stop.
    #[error("stopped before it was done")]
    Cancelled,
}
