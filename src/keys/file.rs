//! The key file: its lines, its permissions, and writing it whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::{KeyError, MasterKey, key_from_hex};
use crate::durable::{create_directory, sync_parent};

/// Appended to the name of the key file, with a random id, for a new file until it is complete.
const STAGING_SUFFIX: &str = ".new-";

pub(super) fn parse(text: &str) -> Result<Vec<MasterKey>, (usize, &'static str)> {
    let mut keys: Vec<MasterKey> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line_number = index + 1;
        if line.trim().is_empty() {
            continue;
        }
        let (id, hex) = line.trim().split_once(' ').ok_or((
            line_number,
            "expected a key id of 8 hex digits, a space, and the key as 64 hex digits",
        ))?;
        let bytes = key_from_hex(hex.trim())
            .ok_or((line_number, "the key is not 64 hexadecimal digits"))?;
        let key = MasterKey::new(bytes);
        // A mistyped or damaged key would verify nothing, without an error.
        if key.id != id {
            return Err((line_number, "the key does not belong to its id: it was damaged"));
        }
        if keys.iter().any(|known| known.id == key.id) {
            return Err((line_number, "this key stands in the file twice"));
        }
        keys.push(key);
    }
    if keys.is_empty() {
        return Err((
            1,
            "the file holds no key: restore it from its backup, or delete it to start anew",
        ));
    }
    Ok(keys)
}

#[cfg(unix)]
pub(super) fn check_mode(file: &File, path: &Path) -> Result<(), KeyError> {
    use std::os::unix::fs::PermissionsExt;
    let metadata =
        file.metadata().map_err(|source| KeyError::Io { path: path.to_owned(), source })?;
    let mode = metadata.permissions().mode() & 0o777;
    // A group may read the file, because a mounted secret mostly belongs to one. Only the owner may
    // write.
    if mode & 0o027 != 0 {
        return Err(KeyError::Exposed { path: path.to_owned(), mode });
    }
    Ok(())
}

#[cfg(not(unix))]
pub(super) fn check_mode(_: &File, _: &Path) -> Result<(), KeyError> {
    Ok(())
}

fn private_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// Writes a new file beside `path`, complete and on the disk before it gets that name.
fn written_beside(path: &Path, text: &str) -> io::Result<PathBuf> {
    let mut name = path.as_os_str().to_owned();
    name.push(format!("{STAGING_SUFFIX}{}", uuid::Uuid::now_v7().simple()));
    let beside = PathBuf::from(name);
    let mut file = private_file(&beside)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    Ok(beside)
}

/// Creates the file whole or not at all. A file that exists is kept.
pub(super) fn write_new(path: &Path, text: &str) -> io::Result<()> {
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_directory(parent)?;
    }
    let beside = written_beside(path, text)?;
    let linked = std::fs::hard_link(&beside, path);
    let removed = std::fs::remove_file(&beside);
    match linked {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => removed,
        other => other.and(removed).and_then(|()| sync_parent(path)),
    }
}

/// The key file, locked against changes by other processes.
pub(super) struct Locked {
    file: File,
    /// The file itself, where `path` is a symbolic link.
    pub(super) path: PathBuf,
}

/// Waits for the lock of an existing key file.
pub(super) fn lock(path: &Path) -> io::Result<Locked> {
    loop {
        let path = std::fs::canonicalize(path)?;
        let file = File::open(&path)?;
        file.lock()?;
        // The process that had the lock before may have replaced the file.
        if is_same(&file, &path)? {
            return Ok(Locked { file, path });
        }
    }
}

#[cfg(unix)]
fn is_same(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    let (open, named) = (file.metadata()?, std::fs::metadata(path)?);
    Ok((open.dev(), open.ino()) == (named.dev(), named.ino()))
}

#[cfg(not(unix))]
fn is_same(_: &File, _: &Path) -> io::Result<bool> {
    Ok(true)
}

impl Locked {
    /// Replaces the file by a new one with the same owner, group and mode. A crash leaves one of
    /// the two.
    pub(super) fn replace(&self, text: &str) -> io::Result<()> {
        let beside = written_beside(&self.path, text)?;
        let replaced = copy_owner_and_mode(&beside, &self.file)
            .and_then(|()| std::fs::rename(&beside, &self.path));
        if replaced.is_err() {
            let _ = std::fs::remove_file(&beside);
        }
        replaced?;
        sync_parent(&self.path)
    }

    /// Removes new files beside the key file that a crash left before they got its name. Returns
    /// their number.
    pub(super) fn remove_staging(&self) -> usize {
        let Some(parent) = self.path.parent() else { return 0 };
        let Some(name) = self.path.file_name().and_then(std::ffi::OsStr::to_str) else { return 0 };
        let beginning = format!("{name}{STAGING_SUFFIX}");
        let Ok(entries) = std::fs::read_dir(parent) else { return 0 };
        let is_staging = |entry: &std::fs::DirEntry| {
            entry.file_name().to_str().is_some_and(|name| name.starts_with(&beginning))
        };
        let staging = entries.filter_map(Result::ok).filter(is_staging);
        staging.filter(|entry| std::fs::remove_file(entry.path()).is_ok()).count()
    }
}

#[cfg(unix)]
fn copy_owner_and_mode(beside: &Path, model: &File) -> io::Result<()> {
    use std::os::unix::fs::{MetadataExt, fchown};
    let file = OpenOptions::new().write(true).open(beside)?;
    let (new, old) = (file.metadata()?, model.metadata()?);
    if (new.uid(), new.gid()) != (old.uid(), old.gid()) {
        fchown(&file, Some(old.uid()), Some(old.gid())).map_err(|error| {
            let what = "its new version cannot be given the owner and group of the old one; run this \
                        as that owner, or as root";
            io::Error::new(error.kind(), format!("{what} ({error})"))
        })?;
    }
    file.set_permissions(old.permissions())?;
    file.sync_all()
}

#[cfg(not(unix))]
fn copy_owner_and_mode(_: &Path, _: &File) -> io::Result<()> {
    Ok(())
}
