//! The key file: its lines, its permissions, and how it is written whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::{KeyError, MasterKey, key_from_hex};
use crate::durable::{create_directory, sync_parent};

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
        // A mistyped or bit-rotten key would silently verify nothing.
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
    if mode & 0o077 != 0 {
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

/// A whole new file beside `path`, on the disk before it gets its name.
fn written_beside(path: &Path, text: &str) -> io::Result<PathBuf> {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".new-{}", uuid::Uuid::now_v7().simple()));
    let beside = PathBuf::from(name);
    let mut file = private_file(&beside)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    Ok(beside)
}

/// Creates the file whole or not at all; keeps one that is already there.
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

pub(super) fn replace(path: &Path, text: &str) -> io::Result<()> {
    let beside = written_beside(path, text)?;
    std::fs::rename(&beside, path)?;
    sync_parent(path)
}
