//! The check of a data directory: whether everything that the records promise is there and
//! unchanged, and nothing else is. It only reads; a service may be running.
//!
//! Blobs are listed before the records are read, so that a mark that is registered meanwhile is not
//! taken for an orphan. A mark whose blobs are written and whose record is not yet written is still
//! taken for one.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use futures::TryStreamExt as _;
use serde::Serialize;
use sha2::{Digest as _, Sha256};

use super::{StartError, seen, sweep};
use crate::blobs::{BlobError, Blobs, Kind, geometry};
use crate::config::{Config, SecretText};
use crate::keys::KeyRing;
use crate::registry::{Record, RegistryError, Sqlite};

/// Records per query.
const ROWS: u32 = 1024;

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What kind of thing: `file_missing`, `file_damaged`, `host_missing`, `host_damaged`,
    /// `blob_without_record`, `unfinished`, `key_missing`, `keys_unusable`, `record_unreadable`,
    /// `registry_older`, `registry_other`, `database`.
    pub kind: &'static str,
    /// The file, key or directory that it is about.
    pub what: String,
    /// What is wrong with it.
    pub detail: String,
}

/// What a check covered, and what it found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Checked {
    /// Records, revoked ones included.
    pub records: u64,
    /// Marked files whose hash was compared.
    pub files: u64,
    /// Hosts whose hash was compared; records with one geometry share a host.
    pub hosts: u64,
    /// What is wrong.
    pub findings: Vec<Finding>,
}

impl Checked {
    fn add(&mut self, kind: &'static str, what: &dyn Display, detail: &dyn Display) {
        let (what, detail) = (what.to_string(), detail.to_string());
        self.findings.push(Finding { kind, what, detail });
    }
}

/// Checks the data directory of these settings.
///
/// # Errors
/// [`StartError`] when there is nothing to check, or the directory cannot be read.
pub async fn check(config: &Config) -> Result<Checked, StartError> {
    let data = &config.data;
    let mut checked = Checked::default();
    let blobs = Blobs::there(&data.join("blobs"))?;
    let registry = Sqlite::open_to_read(data).await?;
    let looked = check_all(config, &registry, blobs.as_ref(), &mut checked).await;
    registry.end().await;
    match looked {
        // A file that is no longer a database is a finding of the check.
        Err(StartError::Registry(error @ RegistryError::Database(_))) => {
            checked.add("database", &data.join("registry.sqlite").display(), &error);
        }
        looked => looked?,
    }
    Ok(checked)
}

async fn check_all(
    config: &Config,
    registry: &Sqlite,
    blobs: Option<&Blobs>,
    checked: &mut Checked,
) -> Result<(), StartError> {
    for fault in registry.integrity().await? {
        checked.add("database", &"registry.sqlite", &fault);
    }
    if let Some(blobs) = blobs {
        for orphan in sweep::orphans(blobs, registry).await? {
            checked.add("blob_without_record", &orphan, &"no record owns it");
        }
        for path in blobs.staging() {
            checked.add("unfinished", &path.display(), &"a write that did not end");
        }
    }
    check_identity(config, registry, checked).await?;
    check_keys(config, registry, checked).await?;
    let mut hosts = BTreeSet::new();
    let mut after = 0;
    loop {
        let rows = registry.rows(after, ROWS).await?;
        let Some((last, _)) = rows.last() else { break };
        after = *last;
        for (_, row) in rows {
            checked.records += 1;
            match row {
                Ok(record) => check_record(config, blobs, &record, &mut hosts, checked).await?,
                Err(error) => checked.add("record_unreadable", &"registry.sqlite", &error),
            }
        }
    }
    Ok(())
}

async fn check_identity(
    config: &Config,
    registry: &Sqlite,
    checked: &mut Checked,
) -> Result<(), StartError> {
    let (Some(noted), Some(found)) = (seen::read(&config.data)?, registry.identity().await?) else {
        return Ok(());
    };
    if noted.id != found.id {
        checked.add("registry_other", &"registry.sqlite", &"another one served here last");
    } else if found.changes < noted.changes {
        let detail = format!("{} changes of {} that were noted", found.changes, noted.changes);
        checked.add("registry_older", &"registry.sqlite", &detail);
    }
    Ok(())
}

async fn check_keys(
    config: &Config,
    registry: &Sqlite,
    checked: &mut Checked,
) -> Result<(), StartError> {
    let ring = match &config.master_key {
        Some(text) => KeyRing::from_hex(SecretText::reveal(text)),
        None => KeyRing::open(&config.master_key_file),
    };
    let known: BTreeSet<String> = match ring {
        Ok(ring) => ring.ids().map(str::to_owned).collect(),
        Err(error) => {
            checked.add("keys_unusable", &config.master_key_file.display(), &error);
            BTreeSet::new()
        }
    };
    for key in registry.survey().await?.keys {
        if !known.contains(&key.key_id) {
            let detail = format!("{} records need it, {} of them live", key.records, key.live);
            checked.add("key_missing", &key.key_id, &detail);
        }
    }
    Ok(())
}

async fn check_record(
    config: &Config,
    blobs: Option<&Blobs>,
    record: &Record,
    hosts: &mut BTreeSet<[u8; 32]>,
    checked: &mut Checked,
) -> Result<(), StartError> {
    if record.file_kept {
        let name = format!("files/{}", record.id);
        let hash = match blobs {
            Some(blobs) => hash_of_file(blobs, record).await?,
            None => None,
        };
        match hash {
            None => checked.add("file_missing", &name, &"its record says that it is kept"),
            Some(Err(error)) => checked.add("file_damaged", &name, &error),
            Some(Ok(hash)) if hash != record.marked_sha256 => {
                checked.add("file_damaged", &name, &"its SHA-256 is not its record's");
            }
            Some(Ok(_)) => checked.files += 1,
        }
    }
    if !record.host_kept {
        return Ok(());
    }
    let (name, packed) = match (record.host_geometry, blobs) {
        (Some(key), _) if !hosts.insert(key) => return Ok(()),
        (Some(key), Some(blobs)) => {
            (format!("hosts/{}", hex::encode(key)), blobs.host(&key).await?)
        }
        (None, Some(blobs)) => {
            (format!("hosts/{}", record.id), blobs.get(Kind::Host, record.id).await?)
        }
        (_, None) => (format!("host of {}", record.id), None),
    };
    let Some(packed) = packed else {
        checked.add("host_missing", &name, &format!("{} says that it is kept", record.id));
        return Ok(());
    };
    let limits = config.limits;
    let key = tokio::task::spawn_blocking(move || {
        let mesh = geometry::unpack(&packed, limits.max_vertices, limits.max_triangles);
        mesh.map(|mesh| geometry::key(&mesh))
    });
    match key.await.map_err(|error| StartError::Load(error.to_string()))? {
        Err(error) => checked.add("host_damaged", &name, &error),
        Ok(key) if record.host_geometry.is_some_and(|expected| expected != key) => {
            checked.add("host_damaged", &name, &"its geometry is not what its name says");
        }
        Ok(_) => checked.hosts += 1,
    }
    Ok(())
}

/// The SHA-256 of a marked file as it would be handed out; `None` if the file is missing.
async fn hash_of_file(
    blobs: &Blobs,
    record: &Record,
) -> Result<Option<Result<[u8; 32], String>>, StartError> {
    let damaged = |error: BlobError| match error {
        BlobError::Marked(error) => Ok(Some(Err(error.to_string()))),
        error => Err(error.into()),
    };
    let file = match blobs.open_file(record.id).await {
        Ok(None) => return Ok(None),
        Ok(Some(file)) => file,
        Err(error) => return damaged(error),
    };
    let bytes = file.bytes();
    let parts = file.stream(0..bytes);
    let hashed = parts.try_fold(Sha256::new(), |mut hash, part| {
        hash.update(&part);
        std::future::ready(Ok(hash))
    });
    match hashed.await {
        Ok(hash) => Ok(Some(Ok(hash.finalize().into()))),
        Err(error) => damaged(error),
    }
}

impl Checked {
    /// Number of findings of each kind.
    #[must_use]
    pub fn kinds(&self) -> BTreeMap<&'static str, usize> {
        let mut kinds = BTreeMap::new();
        for finding in &self.findings {
            *kinds.entry(finding.kind).or_default() += 1;
        }
        kinds
    }
}
