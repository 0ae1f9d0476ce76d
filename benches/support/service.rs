//! A service in this process, over a data directory with many other records, for the benchmarks of
//! verification.

use futures::TryStreamExt as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use quadmark::formats::Format;
use quadmark::keys::KeyRing;
use quadmark::registry::Record;
use quadmark::service::{
    Depth, EmbedRequest, OnExisting, Service, ServiceError, Spooled, Text, Verification,
    VerifyRequest,
};
use quadmark::watermark::{BitCount, Codeword, MarkKey, Message, Method, Strength};

use sqlx::SqlitePool;
use sqlx::sqlite::SqliteConnectOptions;

use crate::seeded::{config, seed};

const BUSY: Duration = Duration::from_secs(10);

/// A registered mark and its file.
#[allow(dead_code)] // not every benchmark reads everything
pub struct Mark {
    pub record: Record,
    pub bytes: Vec<u8>,
    pub codeword: Codeword,
}

/// How to mark.
#[derive(Clone, Copy)]
pub struct Kind {
    pub method: Method,
    /// `None` for the default.
    pub strength: Option<Strength>,
    pub bits: BitCount,
}

/// The service and its keys.
pub struct Bench {
    pub service: Arc<Service>,
    keys: KeyRing,
    registry: SqlitePool,
}

impl Bench {
    /// Starts the service over a data directory that is first filled up to `others` records of
    /// others.
    pub async fn start(data: &Path, others: u64) -> Self {
        // The first start makes the schema and the master key.
        Service::open(config(data)).await.unwrap().close().await;
        seed(data, others).await;
        let service = Service::open(config(data)).await.unwrap();
        let keys = KeyRing::open(&data.join("master.keys")).unwrap();
        let registry = SqliteConnectOptions::new().filename(data.join("registry.sqlite"));
        let registry = SqlitePool::connect_with(registry.busy_timeout(BUSY)).await.unwrap();
        Self { service, keys, registry }
    }

    async fn upload(&self, bytes: &[u8]) -> Spooled {
        let admission = self.service.admit_upload(None).unwrap();
        let spool = self.service.spool(admission).unwrap().write(bytes).await.unwrap();
        spool.end(None).await.unwrap()
    }

    #[allow(dead_code)] // not every benchmark marks what must be fit for it
    /// Marks a file for an owner and keeps it. A later run over the same directory gets the same
    /// mark again.
    pub async fn mark(&self, file: &[u8], owner: &str, kind: Kind) -> Mark {
        self.try_mark(file, owner, kind).await.unwrap()
    }

    /// As `mark`, but the file may be unfit for a mark.
    #[allow(dead_code)] // not every benchmark marks whatever there is
    pub async fn try_mark(
        &self,
        file: &[u8],
        owner: &str,
        kind: Kind,
    ) -> Result<Mark, ServiceError> {
        let request = EmbedRequest {
            file: self.upload(file).await,
            owner_id: Text::parse("owner_id", owner).unwrap(),
            recipient: None,
            label: None,
            method: kind.method,
            layers: None,
            strength: kind.strength,
            max_distortion: None,
            bits: kind.bits,
            payload: None,
            keep_file: true,
            keep_host: true,
            on_existing: OnExisting::Allow,
            formats: Format::ALL.to_vec(),
            idempotency_key: Some(format!(
                "{}/{}/{}",
                kind.method,
                kind.strength.map_or(0.0, Strength::get),
                kind.bits.get()
            )),
        };
        let embedded = self.service.embed(request).await?;
        let record = embedded.record;
        let key = self.keys.mark_key(&record.key_id, &record.salt, &record.owner_id).unwrap();
        let message = Message::from_bytes(&record.message, record.bits).unwrap();
        let codeword = Codeword::new(&MarkKey::from_bytes(*key), &message);
        let content = embedded.content;
        let length = content.bytes();
        let parts = content.begin(0..length).await.unwrap();
        let bytes = parts.try_collect::<Vec<_>>().await.unwrap().concat();
        Ok(Mark { record, bytes, codeword })
    }

    /// The marks that a file carries; with an owner, those of that owner. Each verification is
    /// judged as the first question about a record, so that figures do not depend on how many cases
    /// a run has.
    pub async fn verify(&self, file: &[u8], owner: Option<&str>, depth: Depth) -> Verification {
        sqlx::query("DELETE FROM questions").execute(&self.registry).await.unwrap();
        let file = self.upload(file).await;
        let owner_id = owner.map(|owner| Text::parse("owner_id", owner).unwrap());
        let request = VerifyRequest { file, owner_id, watermark_id: None, depth };
        self.service.verify(request).await.unwrap()
    }
}
