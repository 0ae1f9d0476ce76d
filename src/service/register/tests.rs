//! Registrations and revocations at the same time, interleaved step by step.

use std::sync::Mutex;

use async_trait::async_trait;
use jiff::Timestamp;
use tokio::sync::oneshot;

use super::super::test_support::{keys, service};
use super::*;
use crate::registry::{
    Counts, Cursor, Filter, HostSketch, Identity, MarkSource, Order, Page, Registry, Sqlite,
    StoredVerification, Tally, sample_record,
};

/// A registry that, after its next commit, reports the commit and waits until it is allowed to go
/// on.
struct Halting {
    inner: Sqlite,
    halt: Mutex<Option<(oneshot::Sender<()>, oneshot::Receiver<()>)>>,
}

#[async_trait]
impl Registry for Halting {
    async fn register(
        &self,
        record: &Record,
        idempotency: Option<&IdempotencyEntry>,
    ) -> Result<(), RegistryError> {
        self.inner.register(record, idempotency).await?;
        let halt = self.halt.lock().unwrap().take();
        if let Some((committed, go_on)) = halt {
            committed.send(()).unwrap();
            go_on.await.unwrap();
        }
        Ok(())
    }
    async fn record(&self, id: Uuid) -> Result<Option<Record>, RegistryError> {
        self.inner.record(id).await
    }
    async fn records(&self, ids: &[Uuid]) -> Result<Vec<Record>, RegistryError> {
        self.inner.records(ids).await
    }
    async fn page(
        &self,
        filter: &Filter,
        order: Order,
        after: Option<Cursor>,
        limit: u32,
    ) -> Result<Page, RegistryError> {
        self.inner.page(filter, order, after, limit).await
    }
    async fn counts(&self, owner_id: Option<&str>) -> Result<Counts, RegistryError> {
        self.inner.counts(owner_id).await
    }
    async fn live_ids(
        &self,
        owner_id: &str,
        after: Option<Uuid>,
        limit: u32,
    ) -> Result<Vec<Uuid>, RegistryError> {
        self.inner.live_ids(owner_id, after, limit).await
    }
    async fn last_row(&self) -> Result<i64, RegistryError> {
        self.inner.last_row().await
    }
    async fn mark_sources(&self, after: i64, last: i64) -> Result<Vec<MarkSource>, RegistryError> {
        self.inner.mark_sources(after, last).await
    }
    async fn keep_sketch(&self, host: &[u8; 32], sketch: &[u8]) -> Result<(), RegistryError> {
        self.inner.keep_sketch(host, sketch).await
    }
    async fn uses_host(&self, geometry: &[u8; 32]) -> Result<bool, RegistryError> {
        self.inner.uses_host(geometry).await
    }
    async fn sketches(&self, after: i64, limit: u32) -> Result<Vec<HostSketch>, RegistryError> {
        self.inner.sketches(after, limit).await
    }
    async fn hosts(&self, after: i64, last: i64) -> Result<Vec<(Uuid, [u8; 32])>, RegistryError> {
        self.inner.hosts(after, last).await
    }
    async fn host_parents(&self) -> Result<Vec<([u8; 32], [u8; 32])>, RegistryError> {
        self.inner.host_parents().await
    }
    async fn refused(
        &self,
        host: &[u8; 32],
        owner_id: &str,
        tries: u32,
    ) -> Result<(), RegistryError> {
        self.inner.refused(host, owner_id, tries).await
    }
    async fn tally(&self, id: Uuid) -> Result<Tally, RegistryError> {
        self.inner.tally(id).await
    }
    async fn question(&self, id: Uuid, question: &[u8; 32]) -> Result<u64, RegistryError> {
        self.inner.question(id, question).await
    }
    async fn ask(
        &self,
        ids: &[Uuid],
        question: &[u8; 32],
    ) -> Result<Vec<(Uuid, u64)>, RegistryError> {
        self.inner.ask(ids, question).await
    }
    async fn revoke(&self, id: Uuid, at: Timestamp) -> Result<Option<Record>, RegistryError> {
        self.inner.revoke(id, at).await
    }
    async fn existing(&self, ids: &[Uuid]) -> Result<Vec<Uuid>, RegistryError> {
        self.inner.existing(ids).await
    }
    async fn idempotency(
        &self,
        owner_id: &str,
        key: &str,
    ) -> Result<Option<IdempotencyEntry>, RegistryError> {
        self.inner.idempotency(owner_id, key).await
    }
    async fn keep_verification(&self, kept: &StoredVerification) -> Result<(), RegistryError> {
        self.inner.keep_verification(kept).await
    }
    async fn verification(&self, id: Uuid) -> Result<Option<StoredVerification>, RegistryError> {
        self.inner.verification(id).await
    }
    async fn seen(&self) -> Result<Option<Identity>, RegistryError> {
        self.inner.seen().await
    }
    async fn ping(&self) -> Result<(), RegistryError> {
        self.inner.ping().await
    }
    async fn close(&self) {
        self.inner.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_revoked_while_it_is_registered_is_not_found() {
    let directory = tempfile::tempdir().unwrap();
    let inner = Sqlite::open(directory.path()).await.unwrap();
    let (committed, has_committed) = oneshot::channel();
    let (let_on, go_on) = oneshot::channel();
    let registry = Halting { inner, halt: Mutex::new(Some((committed, go_on))) };
    let service = service(directory.path(), registry);
    let record = Record { key_id: keys().current().to_owned(), host_kept: true, ..sample_record() };

    let (registering, mark) = (service.clone(), record.clone());
    let registering = tokio::spawn(async move {
        let host = KeptHost { key: [3; 32], geometry: Bytes::from_static(b"host"), sketch: None };
        registering.register(&mark, Some(Bytes::from_static(b"file")), Some(host), None).await
    });
    has_committed.await.unwrap();
    assert_eq!(service.marks(), 0, "committed and not yet in memory");
    let revoking = service.clone();
    let revoking = tokio::spawn(async move { revoking.revoke(record.id).await });
    // Either the revocation has ended, or it waits for the registration: then nobody else gets the
    // lock.
    while !revoking.is_finished() && service.order.try_read().is_ok() {
        tokio::task::yield_now().await;
    }
    let_on.send(()).unwrap();
    registering.await.unwrap().unwrap();
    assert!(revoking.await.unwrap().unwrap().revoked_at.is_some());
    assert_eq!(service.marks(), 0, "a revoked mark is searched for");
    assert_eq!(service.hosts.len(), 0, "the host of a revoked mark is looked at");
}
