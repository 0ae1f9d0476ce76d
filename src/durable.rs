//! Directories and names that survive a power cut.
//!
//! A file that was synced can still be lost together with its name. A name is content of its
//! directory, which must be synced as well, and so must each directory above it. Must not know what
//! is kept where.

use std::fs::{DirBuilder, File};
use std::io;
use std::path::Path;

/// Syncs a directory, so that the names in it are on the disk.
///
/// # Errors
/// The error of the system.
pub fn sync_directory(directory: &Path) -> io::Result<()> {
    #[cfg(unix)]
    return File::open(directory)?.sync_all();
    // Other systems do not let a directory be opened as a file.
    #[cfg(not(unix))]
    return std::fs::metadata(directory).map(drop);
}

/// Syncs the directory that holds a file.
///
/// # Errors
/// The error of the system.
pub fn sync_parent(file: &Path) -> io::Result<()> {
    match file.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => sync_directory(parent),
        None => sync_directory(Path::new(".")),
    }
}

/// Creates a directory and the missing directories above it, for their owner alone. A directory
/// that exists keeps its mode. When this function returns, the names of all of them are on the
/// disk.
///
/// # Errors
/// The error of the system.
pub fn create_directory(directory: &Path) -> io::Result<()> {
    let mut builder = DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    let whole = std::path::absolute(directory)?;
    let missing = whole.ancestors().take_while(|above| !above.exists()).count();
    builder.create(&whole)?;
    for (depth, above) in whole.ancestors().skip(1).enumerate() {
        // An existing name may have been made by a process that did not live to sync it. A failed
        // sync of a directory that was not created here is ignored: that directory is older than
        // this call.
        match sync_directory(above) {
            Err(error) if depth < missing => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Replaces a small file, or creates it: after a crash the path holds the whole old content or the
/// whole new content. `beside` is the name of the new file until it is complete.
///
/// # Errors
/// The error of the system.
pub fn replace(path: &Path, beside: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(beside)?;
    io::Write::write_all(&mut file, bytes)?;
    file.sync_all()?;
    std::fs::rename(beside, path)?;
    sync_parent(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directories_are_made_private_and_kept_as_they_are() {
        let root = tempfile::tempdir().unwrap();
        let deep = root.path().join("a/b/c");
        create_directory(&deep).unwrap();
        create_directory(&deep).unwrap();
        assert!(deep.is_dir());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
            assert_eq!((mode(&deep), mode(&root.path().join("a"))), (0o700, 0o700));
            std::fs::set_permissions(&deep, std::fs::Permissions::from_mode(0o750)).unwrap();
            create_directory(&deep).unwrap();
            assert_eq!(mode(&deep), 0o750);
        }
    }

    #[test]
    fn a_file_is_replaced_whole() {
        let root = tempfile::tempdir().unwrap();
        let (path, beside) = (root.path().join("note"), root.path().join("note.new"));
        for text in ["one", "and two"] {
            replace(&path, &beside, text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        assert!(!beside.exists());
    }
}
