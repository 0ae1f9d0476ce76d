//! Inspect: what a file is and how well it can carry a mark. Registers nothing.

use super::{Service, ServiceError, Spooled};
use crate::lab::expected::{Expected, expected};
use crate::marking::{Inspection, inspect};
use crate::watermark::EmbedParams;

/// What was found.
#[derive(Debug)]
pub struct Inspected {
    /// The file's hash.
    pub sha256: [u8; 32],
    /// Its length.
    pub bytes: u64,
    /// What the core says.
    pub inspection: Inspection,
    /// What a mark is expected to survive.
    pub expected: Vec<Expected>,
}

impl Service {
    /// Reads a file and says how well it can carry a mark.
    ///
    /// # Errors
    /// [`ServiceError`]: the file cannot be read.
    pub async fn inspect(
        &self,
        mut file: Spooled,
        params: EmbedParams,
    ) -> Result<Inspected, ServiceError> {
        let limits = self.config.limits;
        let (sha256, bytes) = (file.sha256, file.bytes);
        let inspection =
            self.run(bytes, move |_| Ok(inspect(&file.read()?, &params, &limits)?)).await?;
        let expected = expected(&inspection, &params);
        Ok(Inspected { sha256, bytes, inspection, expected })
    }
}
