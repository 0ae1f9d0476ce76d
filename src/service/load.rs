//! Loading: derives the codewords of all live records at the start.
//!
//! Reading and deriving overlap: some batches of rows are read on several connections while others
//! are derived on several threads. The batches enter the index in order.

use std::sync::Arc;

use futures::{StreamExt as _, TryStreamExt as _, stream};
use rayon::prelude::*;
use tracing::{debug, warn};
use uuid::Uuid;

use super::{Service, ServiceError, StartError, known};
use crate::registry::MarkSource;

/// Rows per batch.
const ROWS: i64 = 8_192;

/// Batches that are worked on at once.
const BATCHES: usize = 4;

impl Service {
    /// Fills the index of marks.
    pub(super) async fn load(self: &Arc<Self>) -> Result<(), StartError> {
        let end = self.registry.last_row().await?;
        let starts = (0..).map(|batch| batch * ROWS).take_while(|&start| start < end);
        let batches = stream::iter(starts).map(|start| self.clone().load_batch(start));
        batches
            .buffered(BATCHES)
            .try_for_each(|(marks, unreadable)| {
                self.known.extend(marks);
                self.unreadable.extend(unreadable);
                std::future::ready(Ok(()))
            })
            .await?;
        let unreadable = self.unreadable.len();
        if unreadable > 0 {
            warn!(unreadable, "marks cannot be searched for: quadmark check says which and why");
        }
        Ok(())
    }

    /// The marks of the rows after `start`, and those that cannot be read.
    async fn load_batch(
        self: Arc<Self>,
        start: i64,
    ) -> Result<(Vec<known::Mark>, Vec<Uuid>), StartError> {
        let sources = self.registry.mark_sources(start, start + ROWS).await?;
        let derived = tokio::task::spawn_blocking(move || self.derive(&sources));
        derived.await.map_err(|error| StartError::Load(error.to_string()))
    }

    fn derive(&self, sources: &[MarkSource]) -> (Vec<known::Mark>, Vec<Uuid>) {
        let derived: Vec<Result<known::Mark, ServiceError>> =
            sources.par_iter().map(|source| known::mark(&self.keys, source)).collect();
        let mut marks = Vec::with_capacity(derived.len());
        let mut unreadable = Vec::new();
        for (mark, source) in derived.into_iter().zip(sources) {
            match mark {
                Ok(mark) => marks.push(mark),
                Err(error) => {
                    unreadable.push(source.id);
                    debug!(watermark = %source.id, %error, "a mark cannot be searched for");
                }
            }
        }
        (marks, unreadable)
    }
}
