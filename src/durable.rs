//! Directories and names that survive a power cut.
//!
//! A file that was synced can still be lost with its name: what a name stands for is content of its
//! directory, which has to be synced as well, and so on upward. Must not know what is kept where.

use std::fs::{DirBuilder, File};
use std::io;
use std::path::Path;

/// Syncs a directory: the names in it are on the disk.
///
/// # Errors
/// What the system said.
pub fn sync_directory(directory: &Path) -> io::Result<()> {
    #[cfg(unix)]
    return File::open(directory)?.sync_all();
    // Elsewhere a directory cannot be opened as a file.
    #[cfg(not(unix))]
    return std::fs::metadata(directory).map(drop);
}

/// Syncs the directory in which a file stands.
///
/// # Errors
/// What the system said.
pub fn sync_parent(file: &Path) -> io::Result<()> {
    match file.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => sync_directory(parent),
        None => sync_directory(Path::new(".")),
    }
}

/// Makes a directory and what lies above it, for its owner alone; one that is there keeps its mode.
/// When this returns, the names of all of them are on the disk.
///
/// # Errors
/// What the system said.
pub fn create_directory(directory: &Path) -> io::Result<()> {
    let mut builder = DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    let whole = std::path::absolute(directory)?;
    let missing = whole.ancestors().take_while(|above| !above.exists()).count();
    builder.create(&whole)?;
    for (depth, above) in whole.ancestors().skip(1).enumerate() {
        // Names that were there may have been made by a process that did not come to sync them. Where
        // that is not allowed or not possible, they are older than we can help.
        match sync_directory(above) {
            Err(error) if depth < missing => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Writes a whole small file in the place of an old one, if there is one: after a crash there is one
/// of the two. `beside` is the name of the new file until it is whole.
///
/// # Errors
/// What the system said.
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
