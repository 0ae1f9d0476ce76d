//! The start: the data directory is examined, and refused if need be, before anything is written.
//!
//! A registry that is gone, that is older than the note says, or that does not know of files beside
//! it, is mostly an accident. So are missing master keys. A service that went on would look healthy
//! and lose marks. Each refusal says what to do, and a setting can overrule each.

use std::path::{Path, PathBuf};

use tracing::{info, warn};

use super::{StartError, adopt, seen, sweep};
use crate::blobs::{Blobs, Name};
use crate::config::{Config, SecretText};
use crate::durable::create_directory;
use crate::keys::{KeyError, KeyRing};
use crate::registry::{Identity, KeyUse, Lock, Sqlite, Survey};

/// All parts under a data directory, open.
pub(super) struct Opened {
    pub(super) registry: Sqlite,
    pub(super) keys: KeyRing,
    pub(super) blobs: Blobs,
    pub(super) spool_directory: PathBuf,
}

/// Opens a data directory to serve from it, and creates what is missing.
pub(super) async fn open(config: &Config) -> Result<Opened, StartError> {
    let data = &config.data;
    let lock = Lock::take(data)?;
    warn_if_open_to_others(data);
    let (survey, orphans) = survey_directory(data, &lock).await?;
    let noted = seen::read(data)?;
    if let Some(refusal) = refusal(config, noted.as_ref(), &survey, &orphans) {
        if !config.accept_registry {
            return Err(refusal);
        }
        warn!(reason = %refusal, "accepted, as --accept-registry says");
    }
    let keys = keys(config, &survey)?;
    let registry = Sqlite::open_locked(data, lock).await?;
    let blobs = Blobs::local(&data.join("blobs"))?;
    let spool_directory = data.join("uploads");
    create_directory(&spool_directory)
        .map_err(|source| StartError::Directory { path: spool_directory.clone(), source })?;
    sweep::staging(config, &blobs, &spool_directory);
    sweep::quarantine(&blobs, &orphans, data, config.quarantine_days).await?;
    adopt::hosts(config, &registry, &blobs).await?;
    if let Some(identity) = registry.identity().await? {
        seen::write(data, &identity)?;
    }
    Ok(Opened { registry, keys, blobs, spool_directory })
}

/// What the registry holds, and the blobs that it does not know of. Writes nothing.
async fn survey_directory(data: &Path, lock: &Lock) -> Result<(Survey, Vec<Name>), StartError> {
    let blobs = Blobs::there(&data.join("blobs"))?;
    if !Sqlite::is_there(data) {
        let orphans = match &blobs {
            Some(blobs) => sweep::blobs_of_ours(blobs).await?,
            None => Vec::new(),
        };
        return Ok((Survey::default(), orphans));
    }
    let registry = Sqlite::open_to_look(data, lock).await?;
    let survey = registry.survey().await?;
    let orphans = match &blobs {
        // A registry without records owns no blob, and its tables may be missing.
        Some(blobs) if survey.records == 0 => sweep::blobs_of_ours(blobs).await?,
        Some(blobs) => sweep::orphans(blobs, &registry).await?,
        None => Vec::new(),
    };
    registry.end().await;
    Ok((survey, orphans))
}

/// The most blobs without a record that a crash can leave: a file and a host for each mark that was
/// being registered, and no more marks than slots for jobs. More orphans have another cause.
fn few(config: &Config) -> usize {
    config.workers.saturating_add(config.queue).saturating_mul(2)
}

fn refusal(
    config: &Config,
    noted: Option<&Identity>,
    survey: &Survey,
    orphans: &[Name],
) -> Option<StartError> {
    let data = config.data.clone();
    let found = survey.identity.as_ref();
    match (noted, found) {
        (Some(noted), Some(found)) if noted.id != found.id => {
            return Some(StartError::OtherRegistry { data });
        }
        // A registry without an identity is from a release before notes were made.
        (Some(noted), _) if survey.records > 0 || found.is_some() => {
            let found = found.map_or(0, |found| found.changes);
            if found < noted.changes {
                return Some(StartError::OlderRegistry { data, found, noted: noted.changes });
            }
        }
        (Some(noted), _) if noted.changes > 0 || !orphans.is_empty() => {
            return Some(StartError::RegistryGone { data, files: orphans.len() });
        }
        (None, _) if survey.records == 0 && !orphans.is_empty() => {
            return Some(StartError::RegistryGone { data, files: orphans.len() });
        }
        _ => {}
    }
    let few = few(config);
    (orphans.len() > few).then_some(StartError::Orphans { data, files: orphans.len(), few })
}

/// The master keys. A new key is made only if no record could need another one.
fn keys(config: &Config, survey: &Survey) -> Result<KeyRing, StartError> {
    let ring = match &config.master_key {
        Some(text) => KeyRing::from_hex(SecretText::reveal(text))?,
        None => match KeyRing::open(&config.master_key_file) {
            Err(KeyError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                if survey.records > 0 && !config.allow_unreadable_marks {
                    return Err(missing(config, survey.keys.clone()));
                }
                make(config)?
            }
            opened => opened?,
        },
    };
    check_keys(config, &ring, survey)?;
    Ok(ring)
}

fn make(config: &Config) -> Result<KeyRing, StartError> {
    let (ring, created) = KeyRing::open_or_create(&config.master_key_file)?;
    if created {
        let file = config.master_key_file.display();
        info!(file = %file, key_id = ring.current(), "made a new master key");
    }
    Ok(ring)
}

/// Refuses a start when live marks cannot be read with the available keys.
pub(super) fn check_keys(
    config: &Config,
    ring: &KeyRing,
    survey: &Survey,
) -> Result<(), StartError> {
    let absent = |key: &&KeyUse| key.live > 0 && ring.ids().all(|id| id != key.key_id);
    let absent: Vec<KeyUse> = survey.keys.iter().filter(absent).cloned().collect();
    if absent.is_empty() {
        return Ok(());
    }
    let error = missing(config, absent);
    if !config.allow_unreadable_marks {
        return Err(error);
    }
    warn!(reason = %error, "accepted, as --allow-unreadable-marks says");
    Ok(())
}

fn missing(config: &Config, keys: Vec<KeyUse>) -> StartError {
    let from = match &config.master_key {
        Some(_) => "QUADMARK_MASTER_KEY".to_owned(),
        None => config.master_key_file.display().to_string(),
    };
    StartError::MissingKeys { keys, from }
}

/// The data directory holds marked files and hosts, and whoever can write to it can remove the
/// registry.
fn warn_if_open_to_others(data: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = std::fs::metadata(data).map_or(0, |found| found.permissions().mode() & 0o777);
        if mode & 0o077 != 0 {
            let (data, mode) = (data.display(), format!("{mode:03o}"));
            warn!(%data, mode, "other users can look into the data directory: run chmod 700 on it");
        }
    }
    #[cfg(not(unix))]
    let _ = data;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;

    fn decided(
        noted: Option<(&str, u64)>,
        (records, found): (u64, Option<(&str, u64)>),
        orphans: usize,
    ) -> Option<&'static str> {
        let settings = Settings { workers: Some(2), queue: Some(3), ..Settings::default() };
        let config = Config::decide(settings).unwrap();
        let identity = |(id, changes): (&str, u64)| Identity { id: id.to_owned(), changes };
        let survey = Survey { records, keys: Vec::new(), identity: found.map(identity) };
        let orphan = |index: usize| Name { directory: "files".to_owned(), name: index.to_string() };
        let orphans: Vec<Name> = (0..orphans).map(orphan).collect();
        refusal(&config, noted.map(identity).as_ref(), &survey, &orphans).map(|error| match error {
            StartError::RegistryGone { .. } => "gone",
            StartError::OlderRegistry { .. } => "older",
            StartError::OtherRegistry { .. } => "other",
            StartError::Orphans { .. } => "orphans",
            _ => "something else",
        })
    }

    #[test]
    fn what_is_refused() {
        // A new directory; one after a crash in its first start, or in its first registration.
        assert_eq!(decided(None, (0, None), 0), None);
        assert_eq!(decided(None, (0, Some(("a", 0))), 0), None);
        assert_eq!(decided(Some(("a", 0)), (0, Some(("a", 0))), 1), None);
        // As the last service left it, or with changes after the note; with the few orphans of a
        // crash.
        assert_eq!(decided(Some(("a", 7)), (7, Some(("a", 7))), 0), None);
        assert_eq!(decided(Some(("a", 7)), (9, Some(("a", 9))), 10), None);
        assert_eq!(decided(Some(("a", 7)), (9, Some(("a", 9))), 11), Some("orphans"));
        // From a release before notes were made.
        assert_eq!(decided(None, (9, None), 10), None);
        assert_eq!(decided(None, (9, None), 11), Some("orphans"));
        // The registry is gone, with and without the note; emptied; an older one; another one.
        assert_eq!(decided(Some(("a", 7)), (0, None), 0), Some("gone"));
        assert_eq!(decided(Some(("a", 0)), (0, None), 1), Some("gone"));
        assert_eq!(decided(None, (0, None), 1), Some("gone"));
        assert_eq!(decided(None, (0, Some(("a", 0))), 1), Some("gone"));
        assert_eq!(decided(Some(("a", 7)), (6, Some(("a", 6))), 0), Some("older"));
        assert_eq!(decided(Some(("a", 7)), (6, None), 0), Some("older"));
        assert_eq!(decided(Some(("a", 7)), (9, Some(("b", 9))), 0), Some("other"));
    }
}
