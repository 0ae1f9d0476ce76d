//! A directory on a disk that can lose power: the journal that `disk.c` keeps, read back.

use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::process::Command;

const SOURCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/power_cut/disk.c");

/// A directory, and the part of it that would survive a power cut.
pub(crate) struct Disk {
    directory: tempfile::TempDir,
}

/// What one `fsync` made durable.
enum Synced {
    File(Vec<u8>),
    /// Name, inode, whether it is a directory.
    Directory(Vec<(String, u64, bool)>),
}

impl Disk {
    /// An empty disk. Builds the library: a machine that built quadmark has a C compiler, since
    /// `SQLite` and zstd are C.
    pub(crate) fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        for part in ["root", "journal"] {
            fs::create_dir(directory.path().join(part)).unwrap();
        }
        let library = directory.path().join("disk.so");
        let compiler = std::env::var_os("CC").unwrap_or_else(|| "cc".into());
        let built = Command::new(compiler)
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(&library)
            .args([SOURCE, "-ldl", "-lpthread"])
            .output()
            .unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        Self { directory }
    }

    pub(crate) fn root(&self) -> PathBuf {
        self.directory.path().join("root")
    }

    fn journal(&self) -> PathBuf {
        self.directory.path().join("journal")
    }

    /// Lets a command run on this disk.
    pub(crate) fn carries(&self, command: &mut Command) {
        command
            .env("LD_PRELOAD", self.directory.path().join("disk.so"))
            .env("POWER_CUT_ROOT", self.root())
            .env("POWER_CUT_JOURNAL", self.journal());
    }

    /// Number of syncs so far.
    pub(crate) fn syncs(&self) -> usize {
        self.entries().len()
    }

    /// Number, kind and inode of each synced file or directory, in order.
    fn entries(&self) -> Vec<(String, char, u64)> {
        let names = fs::read_dir(self.journal()).unwrap().map(|entry| entry.unwrap().file_name());
        let mut entries: Vec<(String, char, u64)> = names
            .filter_map(|name| {
                let name = name.into_string().unwrap();
                let mut parts = name.split('-').skip(1);
                let kind = parts.next()?.chars().next()?;
                let inode = parts.next()?.parse().unwrap();
                Some((name, kind, inode))
            })
            .collect();
        entries.sort();
        entries
    }

    /// Writes to the empty directory `to` what survives a power cut after `syncs` syncs.
    pub(crate) fn survivors(&self, syncs: usize, to: &Path) {
        let mut synced = HashMap::new();
        for (name, kind, inode) in self.entries().into_iter().take(syncs) {
            let bytes = fs::read(self.journal().join(name)).unwrap();
            let entry = if kind == 'f' { Synced::File(bytes) } else { directory(&bytes) };
            synced.insert(inode, entry);
        }
        let root = fs::metadata(self.root()).unwrap().ino();
        write(&synced, root, to);
    }
}

fn directory(listing: &[u8]) -> Synced {
    let listing = std::str::from_utf8(listing).unwrap();
    let entry = |line: &str| {
        let mut parts = line.splitn(3, ' ');
        let is_directory = parts.next().unwrap() == "d";
        let inode = parts.next().unwrap().parse().unwrap();
        (parts.next().unwrap().to_owned(), inode, is_directory)
    };
    Synced::Directory(listing.lines().map(entry).collect())
}

fn write(synced: &HashMap<u64, Synced>, inode: u64, to: &Path) {
    let Some(Synced::Directory(entries)) = synced.get(&inode) else { return };
    for (name, inode, is_directory) in entries {
        let path = to.join(name);
        if *is_directory {
            fs::create_dir(&path).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
            write(synced, *inode, &path);
        } else {
            // An entry whose content was never synced is an empty file.
            let bytes = match synced.get(inode) {
                Some(Synced::File(bytes)) => bytes.as_slice(),
                _ => &[],
            };
            fs::write(&path, bytes).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        }
    }
}
