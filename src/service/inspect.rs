//! Inspect: says what a file is and how well it can carry a mark. Registers nothing.

use super::memory::{self, Purpose};
use super::{Service, ServiceError, Spooled};
use crate::forecast::{Expected, expected};
use crate::formats::Asset;
use crate::marking::{Inspection, MarkError, inspect_asset_until};
use crate::watermark::EmbedParams;

/// The result of an inspection.
#[derive(Debug)]
pub struct Inspected {
    /// SHA-256 of the file.
    pub sha256: [u8; 32],
    /// Length of the file in bytes.
    pub bytes: u64,
    /// The findings of the core.
    pub inspection: Inspection,
    /// What a mark is expected to survive.
    pub expected: Vec<Expected>,
}

impl Service {
    /// Reads a file and says how well it can carry a mark.
    ///
    /// # Errors
    /// [`ServiceError`] when the file cannot be read.
    pub async fn inspect(
        &self,
        file: Spooled,
        params: EmbedParams,
    ) -> Result<Inspected, ServiceError> {
        let limits = self.config.limits;
        let (sha256, bytes) = (file.sha256, file.bytes);
        let slot = self.admit()?;
        let (inspection, expected) = self
            .run(&slot, bytes, move |allowed| {
                let stop = || allowed.stop().now();
                let asset =
                    Asset::read_until(&file.read()?, &limits, &stop).map_err(MarkError::from)?;
                allowed.need(memory::needed(asset.mesh(), Purpose::Inspect))?;
                let inspection = inspect_asset_until(&asset, &params, &stop)?;
                let expected = expected(asset.mesh(), &inspection, &params, &stop);
                Ok((inspection, expected))
            })
            .await?;
        Ok(Inspected { sha256, bytes, inspection, expected })
    }
}
