//! The use cases: embed, verify, inspect, and the requests about records.
//!
//! Transactions and the order of work are decided here and nowhere else. Must not know about HTTP,
//! nor how records and files are stored.

mod admission;
mod adopt;
mod check;
mod content;
mod embed;
mod error;
mod existing;
mod families;
mod hosts;
mod idempotency;
mod inspect;
mod known;
mod load;
mod making;
mod memory;
mod records;
mod register;
mod seen;
mod spool;
mod start;
mod sweep;
#[cfg(test)]
mod test_support;
mod text;
mod verdict;
mod verify;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio_util::task::TaskTracker;
use tracing::{info, warn};

use admission::{Limits, Uploads};

use crate::blobs::{BlobError, Blobs};
use crate::config::{Config, MEMORY_PER_UPLOAD_BYTE, SecretText};
use crate::formats::FormatError;
use crate::jobs::{Allowance, JobError, Memory, Pool, Slot};
use crate::keys::{KeyError, KeyRing};
use crate::registry::{KeyUse, Registry, RegistryError, Sqlite};
use crate::watermark::WatermarkError;

pub use admission::Admission;
pub use check::{Checked, Finding, check};
pub use content::{Content, Parts};
pub use embed::{EmbedRequest, Embedded, SALTS};
pub use error::ServiceError;
pub use existing::OnExisting;
pub use inspect::Inspected;
pub use spool::{Spool, Spooled};
pub use text::Text;
pub use verdict::{
    ComparedHosts, Evidence, FileFacts, FrameFacts, FrameName, Match, StageName, StageRun, Verdict,
    Verification,
};
pub use verify::{Depth, VerifyRequest};

/// Records read from the registry at a time.
const BATCH: u32 = 5_000;

/// Longest wait for tasks whose jobs were told to stop: removing files takes no longer.
const TIDY: Duration = Duration::from_secs(5);

/// Why the service cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The master keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeyError),
    /// The registry cannot be opened.
    #[error(transparent)]
    Registry(#[from] RegistryError),
    /// The blob store cannot be opened.
    #[error(transparent)]
    Blobs(#[from] BlobError),
    /// The directory for uploads cannot be prepared.
    #[error("the directory {path} cannot be prepared: {source}", path = path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The codewords of the records cannot be loaded.
    #[error("the marks of the registry cannot be loaded: {0}")]
    Load(String),
    /// The directory holds files, or a note of an earlier registry, but no registry with records.
    #[error(
        "the registry in {data} is missing or empty, but it is not a new data directory: {files} \
         files lie there. Put registry.sqlite back from its backup; or say --accept-registry to \
         start anew and move the files to quarantine",
        data = data.display()
    )]
    RegistryGone {
        /// The data directory.
        data: PathBuf,
        /// How many files were found.
        files: usize,
    },
    /// The registry was written to less often than the note of the last service says: it is an
    /// older one.
    #[error(
        "the registry in {data} is older than the one that served here last: {found} changes of \
         {noted} are in it. Put the newer one back; or say --accept-registry to go on without what \
         is missing",
        data = data.display()
    )]
    OlderRegistry {
        /// The data directory.
        data: PathBuf,
        /// Number of changes that this registry has seen.
        found: u64,
        /// Number of changes of the registry that served last.
        noted: u64,
    },
    /// The registry is not the one that served last.
    #[error(
        "the registry in {data} is not the one that served here last. Put that one back; or say \
         --accept-registry to serve with this one",
        data = data.display()
    )]
    OtherRegistry {
        /// The data directory.
        data: PathBuf,
    },
    /// More files without a record than a crash explains.
    #[error(
        "{files} files in {data} have no record, more than the {few} that a crash can leave (two \
         for each job that may run or wait): the registry is probably not theirs, or an older one. \
         List them with quadmark check, and put the right registry back; or say --accept-registry \
         to move them to quarantine",
        data = data.display()
    )]
    Orphans {
        /// The data directory.
        data: PathBuf,
        /// Files without a record.
        files: usize,
        /// How many files without a record a crash can leave.
        few: usize,
    },
    /// Master keys that records need are not there.
    #[error(
        "master keys that records need are not in {from}: {}. Put the right keys back; or, where \
         they are lost, say --allow-unreadable-marks to start without these marks",
        listed(keys)
    )]
    MissingKeys {
        /// The missing keys, with the number of records that need them.
        keys: Vec<KeyUse>,
        /// Where the keys were looked for.
        from: String,
    },
}

fn listed(keys: &[KeyUse]) -> String {
    let one = |key: &KeyUse| format!("{} (of {} records)", key.key_id, key.records);
    keys.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// The service: everything that a request needs. All requests share it.
pub struct Service {
    config: Config,
    keys: KeyRing,
    registry: Arc<dyn Registry>,
    blobs: Blobs,
    pool: Pool,
    known: known::Known,
    unreadable: known::Unreadable,
    hosts: hosts::Hosts,
    host_cache: verify::HostCache,
    in_progress: idempotency::InProgress,
    /// Registrations hold this lock shared, a revocation holds it alone, each from the registry's
    /// commit until the marks in memory agree with the registry. Without the lock, a mark that is
    /// revoked between the two steps of its registration would be inserted after it was removed,
    /// and would be found until the next start.
    order: tokio::sync::RwLock<()>,
    /// Work that goes on after its connection has ended.
    tasks: TaskTracker,
    spool_directory: PathBuf,
    uploads: Uploads,
    /// Whether the data directory is only read: then verdicts are not kept.
    only_reads: bool,
}

impl Service {
    /// Opens everything under the data directory, creates what is missing, and loads the marks.
    ///
    /// # Errors
    /// [`StartError`], with a text for the operator.
    pub async fn open(config: Config) -> Result<Arc<Self>, StartError> {
        let start::Opened { registry, keys, blobs, spool_directory } = start::open(&config).await?;
        let service = Self::over(config, keys, registry, blobs, spool_directory, false);
        service.load().await?;
        service.load_hosts().await?;
        service.announce();
        Ok(service)
    }

    /// Opens an existing data directory for verification only: nothing in the directory is changed,
    /// verdicts are not kept, and a running service is not disturbed.
    ///
    /// # Errors
    /// [`StartError`], with a text for the operator.
    pub async fn open_to_verify(config: Config) -> Result<Arc<Self>, StartError> {
        let registry = Sqlite::open_to_read(&config.data).await?;
        let keys = match &config.master_key {
            Some(text) => KeyRing::from_hex(SecretText::reveal(text))?,
            None => KeyRing::open(&config.master_key_file)?,
        };
        start::check_keys(&config, &keys, &registry.survey().await?)?;
        let directory = config.data.join("blobs");
        let blobs = Blobs::there(&directory)?;
        let blobs = blobs.ok_or_else(|| BlobError::NoDirectory(directory.display().to_string()))?;
        let service = Self::over(config, keys, registry, blobs, std::env::temp_dir(), true);
        service.load().await?;
        service.load_hosts().await?;
        Ok(service)
    }

    fn over(
        config: Config,
        keys: KeyRing,
        registry: impl Registry + 'static,
        blobs: Blobs,
        spool_directory: PathBuf,
        only_reads: bool,
    ) -> Arc<Self> {
        let limits = Limits {
            uploads: config.max_uploads,
            bytes: if only_reads { u64::MAX } else { config.upload_budget_bytes },
            free_bytes: if only_reads { 0 } else { config.min_free_bytes },
        };
        Arc::new(Self {
            uploads: Uploads::new(limits, &spool_directory),
            pool: Pool::new(config.workers, config.queue, config.memory_budget_bytes),
            known: known::Known::default(),
            unreadable: known::Unreadable::default(),
            hosts: hosts::Hosts::default(),
            host_cache: verify::HostCache::new(),
            in_progress: idempotency::InProgress::default(),
            order: tokio::sync::RwLock::default(),
            tasks: TaskTracker::new(),
            registry: Arc::new(registry),
            keys,
            blobs,
            spool_directory,
            only_reads,
            config,
        })
    }

    fn announce(&self) {
        let data = self.config.data.display();
        info!(data = %data, marks = self.known.len(), "registry and files are open");
        if self.config.master_key.is_some() {
            info!(key_id = self.keys.current(), "the master key comes from the settings");
        } else {
            let file = self.config.master_key_file.display();
            info!(
                key_id = self.keys.current(),
                file = %file,
                "master keys are in this file; without it no mark can be read again: copy it to a \
                 safe place, apart from the data directory's backup"
            );
        }
    }

    fn thresholds(&self) -> verdict::Thresholds {
        verdict::Thresholds {
            certain: self.config.match_threshold_log10,
            inconclusive: self.config.inconclusive_threshold_log10,
        }
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The worker pool, for its figures and for refusing a request before its upload is read.
    #[must_use]
    pub fn pool(&self) -> &Pool {
        &self.pool
    }

    /// Number of marks that are searched.
    #[must_use]
    pub fn marks(&self) -> usize {
        self.known.len()
    }

    /// Number of live marks that cannot be searched for because their master keys are missing.
    #[must_use]
    pub fn unreadable_marks(&self) -> usize {
        self.unreadable.len()
    }

    /// Admits an upload before its bytes are read. `declared` is the length that the request
    /// declares, if any.
    ///
    /// # Errors
    /// [`ServiceError::UploadsFull`], [`ServiceError::StorageFull`].
    pub fn admit_upload(&self, declared: Option<u64>) -> Result<Admission, ServiceError> {
        self.uploads.admit(declared.unwrap_or(0))
    }

    /// Begins to store an upload.
    ///
    /// # Errors
    /// [`ServiceError::Internal`], [`ServiceError::StorageFull`]: the disk.
    pub fn spool(&self, admission: Admission) -> Result<Spool, ServiceError> {
        Ok(Spool::begin(&self.spool_directory, admission)?)
    }

    /// Whether requests can be served.
    ///
    /// # Errors
    /// [`ServiceError`] that names the part that does not answer.
    pub async fn ready(&self) -> Result<(), ServiceError> {
        // A full queue is no reason to take the service out of rotation.
        if self.pool.check() == Err(JobError::ShuttingDown) {
            return Err(JobError::ShuttingDown.into());
        }
        self.uploads.check_disk()?;
        Ok(self.registry.ping().await?)
    }

    /// Accepts no more work and gives running work `grace` to end; then tells the rest to stop.
    /// Returns whether all work ended by itself.
    pub async fn drain(&self, grace: Duration) -> bool {
        self.pool.drain(grace).await
    }

    /// Waits until stopped work has cleaned up, then closes the registry. Returns whether
    /// everything was cleaned up.
    pub async fn close(&self) -> bool {
        self.tasks.close();
        let tidy = tokio::time::timeout(TIDY, self.tasks.wait()).await.is_ok();
        if !self.only_reads {
            self.note_registry().await;
        }
        self.registry.close().await;
        tidy
    }

    /// Writes down how often the registry was written to.
    async fn note_registry(&self) {
        let noted = match self.registry.seen().await {
            Ok(Some(identity)) => seen::write(&self.config.data, &identity),
            Ok(None) => Ok(()),
            Err(error) => Err(error.into()),
        };
        if let Err(error) = noted {
            warn!(%error, "an older registry that is put back would not be noticed");
        }
    }

    /// Takes a slot of the pool for all jobs of one request.
    fn admit(&self) -> Result<Slot, ServiceError> {
        Ok(self.pool.admit(Instant::now() + self.config.request_timeout)?)
    }

    /// Runs a job over an upload of this many bytes on the pool. If the job reports that it needs
    /// more memory than is free now, it is run again once that much memory is reserved.
    async fn run<T: Send + 'static>(
        &self,
        slot: &Slot,
        upload_bytes: u64,
        job: impl Fn(&Allowance) -> Result<T, ServiceError> + Send + Sync + 'static,
    ) -> Result<T, ServiceError> {
        let job = Arc::new(job);
        let mut memory = upload_bytes.saturating_mul(MEMORY_PER_UPLOAD_BYTE);
        loop {
            let job = job.clone();
            let ended =
                self.pool.run(slot, Memory::Of(memory), move |allowed| job(allowed)).await?;
            match ended {
                Err(ServiceError::Job(JobError::Again { bytes })) if bytes > memory => {
                    memory = bytes;
                }
                ended => return ended.map_err(|error| told(error, slot)),
            }
        }
    }

    /// Runs a further job of a request on the pool, with the memory that the request has reserved.
    async fn run_once<T: Send + 'static>(
        &self,
        slot: &Slot,
        job: impl FnOnce(&Allowance) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let ended = self.pool.run(slot, Memory::Beyond(0), move |allowed| job(allowed)).await?;
        ended.map_err(|error| told(error, slot))
    }

    /// Runs work to its end even when the client that asked for it hangs up.
    async fn run_detached<T: Send + 'static>(
        &self,
        work: impl Future<Output = Result<T, ServiceError>> + Send + 'static,
    ) -> Result<T, ServiceError> {
        match self.tasks.spawn(work).await {
            Ok(done) => done,
            Err(error) => Err(ServiceError::Internal(format!("a request's task failed: {error}"))),
        }
    }
}

/// The core reports only that it was stopped; the slot knows the reason.
fn told(error: ServiceError, slot: &Slot) -> ServiceError {
    match error {
        ServiceError::Job(JobError::DeadlinePassed)
        | ServiceError::Format(FormatError::Cancelled)
        | ServiceError::Watermark(WatermarkError::Cancelled) => slot.stop().reason().into(),
        other => other,
    }
}
