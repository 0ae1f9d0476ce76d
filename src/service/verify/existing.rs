//! Finds the marks of a host that is about to be marked. The cheap stages of the cascade run first.
//! Then the host is compared with the hosts that it is most like, so that a copy of another owner's
//! asset is found even after damage that the blind reader does not survive.
//!
//! All live marks are searched, whoever makes the request. Must not know what is done about what it
//! finds.

use std::sync::Arc;

use super::super::existing::CarriedMark;
use super::super::hosts::HostKey;
use super::super::{Service, ServiceError};
use super::cascade::{Cascade, Found};
use super::charge::Charges;
use super::shortlist::{FetchedHost, ListedHost};
use super::{Depth, FirstJob};
use crate::formats::Asset;
use crate::jobs::{Memory, Slot, Stop};
use crate::watermark::{CodewordIndex, Suspect};

/// The state of a search for the marks of a host.
pub(in super::super) struct ExistingSearch {
    suspect: Suspect,
    all: CodewordIndex,
    cascade: Cascade,
    listed: Vec<ListedHost>,
}

impl Service {
    /// On the pool: the part of the search that needs only the file and the marks; `None` if there
    /// is no mark to search for. `geometry` is the key of the host's geometry. A geometry that is
    /// registered already was searched when it was registered.
    pub(in super::super) fn begin_existing_search(
        &self,
        host: &Asset,
        geometry: &[u8; 32],
        stop: &Stop,
    ) -> Result<Option<ExistingSearch>, ServiceError> {
        if self.known.len() == 0 {
            return Ok(None);
        }
        let begun = self.begin(host.mesh(), (None, Charges::default()), Depth::Fast, stop);
        let FirstJob { suspect, all, cascade, .. } = match begun {
            Ok(begun) => begun,
            // A surface that cannot be read cannot be marked either, and the marking gives the
            // reason.
            Err(ServiceError::Watermark(_)) => return Ok(None),
            Err(error) => return Err(error),
        };
        let is_known = !self.hosts.records_of(HostKey::new(geometry)).is_empty();
        let listed = if is_known || !cascade.is_open() {
            Vec::new()
        } else {
            self.shortlist(&suspect, None, Depth::Standard, stop)?
        };
        Ok(Some(ExistingSearch { suspect, all, cascade, listed }))
    }

    /// The live marks that a host carries with a bound below the match threshold, best first, and
    /// the marks that the newest record of the same geometry names.
    pub(in super::super) async fn find_existing_marks(
        self: &Arc<Self>,
        slot: &Slot,
        host: &Arc<Asset>,
        geometry: &[u8; 32],
        existing_search: ExistingSearch,
    ) -> Result<Vec<CarriedMark>, ServiceError> {
        let ExistingSearch { suspect, all, mut cascade, listed } = existing_search;
        if !listed.is_empty() {
            let hosts = self.fetch(listed, None).await?;
            let beyond = Memory::Beyond(hosts.iter().map(FetchedHost::memory).sum());
            let (service, host) = (self.clone(), host.clone());
            cascade = self
                .pool
                .run(slot, beyond, move |allowed| -> Result<Cascade, ServiceError> {
                    let seen = (host.mesh(), &suspect, &all);
                    service.search(hosts, seen, Depth::Standard, allowed.stop(), &mut cascade)?;
                    Ok(cascade)
                })
                .await??;
        }
        let certain = self.thresholds().certain;
        let seen = |found: Found| {
            let Found { id, log10_fp, .. } = found;
            (log10_fp < certain).then_some(CarriedMark { id, log10_fp })
        };
        let mut marks: Vec<CarriedMark> =
            cascade.finish().found.into_iter().filter_map(seen).collect();
        let earlier = self.hosts.records_of(HostKey::new(geometry));
        if let Some(&newest) = earlier.last() {
            let record = self.registry.record(newest).await?;
            let named = record.and_then(|record| record.existing_marks).unwrap_or_default();
            for mark in named {
                if marks.iter().all(|known| known.id != mark.watermark_id) {
                    marks.push(CarriedMark { id: mark.watermark_id, log10_fp: mark.log10_fp });
                }
            }
        }
        Ok(marks)
    }
}
