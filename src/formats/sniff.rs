//! What kind of file is this? Content decides, never a name or a media type.

use super::{Format, FormatError};

/// Names the format of a file from its first bytes.
///
/// # Errors
/// [`FormatError::Empty`], or [`FormatError::UnknownFormat`] naming what it looks like.
pub fn sniff(bytes: &[u8]) -> Result<Format, FormatError> {
    let _ = bytes;
    Err(FormatError::Empty)
}
