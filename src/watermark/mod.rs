//! Pure watermark core.
