//! The bytes of a document's buffers, loaded when the geometry first needs them.
//!
//! A buffer in another file is never opened. It is an error only when the geometry needs it, so
//! that a missing image or animation does not prevent a mark.

use std::borrow::Cow;

use super::container::Container;
use super::document::Document;
use super::{data_uri, malformed};
use crate::formats::FormatError;

/// Buffers by index; those not loaded are absent.
#[derive(Debug)]
pub(super) struct Buffers<'a> {
    file: &'a [u8],
    container: &'a Container,
    loaded: Vec<Option<Cow<'a, [u8]>>>,
}

impl<'a> Buffers<'a> {
    pub(super) fn new(file: &'a [u8], container: &'a Container, document: &Document) -> Self {
        let loaded = document.buffers.iter().map(|_| None).collect();
        Self { file, container, loaded }
    }

    /// Loads a buffer unless it is loaded, and checks that it is as long as it declares.
    pub(super) fn load(&mut self, document: &Document, index: usize) -> Result<(), FormatError> {
        let (Some(buffer), Some(slot)) = (document.buffers.get(index), self.loaded.get_mut(index))
        else {
            return Err(malformed(
                format!("buffers[{index}]"),
                "a bufferView names this buffer, which does not exist",
            ));
        };
        if slot.is_some() {
            return Ok(());
        }
        let bytes = match (&buffer.uri, &self.container.bin) {
            (Some(uri), _) => {
                let uri = data_uri::parse(uri).ok_or_else(|| FormatError::ExternalBuffer {
                    buffer: index,
                    uri: uri.chars().take(100).collect(),
                })?;
                let path = || format!("buffers[{index}].uri");
                Cow::Owned(uri.decode().map_err(|reason| malformed(path(), reason))?)
            }
            (None, Some(bin)) if index == 0 => {
                Cow::Borrowed(self.file.get(bin.clone()).unwrap_or_default())
            }
            _ => {
                return Err(malformed(
                    format!("buffers[{index}].uri"),
                    "the buffer has no data: it is neither the GLB's BIN chunk nor a data URI",
                ));
            }
        };
        if buffer.byte_length > bytes.len() {
            return Err(malformed(
                format!("buffers[{index}].byteLength"),
                format!("it says {} bytes, the data has {}", buffer.byte_length, bytes.len()),
            ));
        }
        *slot = Some(bytes);
        Ok(())
    }

    /// The bytes of a loaded buffer; empty for any other.
    pub(super) fn bytes(&self, index: usize) -> &[u8] {
        self.loaded.get(index).and_then(Option::as_deref).unwrap_or_default()
    }

    /// The bytes of a loaded buffer, to change.
    pub(super) fn bytes_mut(&mut self, index: usize) -> &mut [u8] {
        match self.loaded.get_mut(index) {
            Some(Some(bytes)) => bytes.to_mut(),
            _ => &mut [],
        }
    }
}
