//! Master keys: where they are stored, how they are named, and how mark keys are derived from them.
//!
//! Secrets stay here (invariant I6). Only two things leave this module: a key id, which reveals
//! nothing about the key, and the mark key of one record. Nothing here logs, and no error or
//! `Debug` text contains key material. This module must not know about the registry or HTTP.

mod file;

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use hkdf::Hkdf;
use sha2::{Digest, Sha256};
use zeroize::{Zeroize, Zeroizing};

use file::{check_mode, parse, write_new};

/// Bytes of a master key, of a mark key and of a salt.
pub const KEY_BYTES: usize = 32;

const KEY_ID_LABEL: &[u8] = b"quadmark/1/key-id";
const MARK_KEY_LABEL: &[u8] = b"quadmark/1/mark";
/// Most bytes of a key file. A key takes a line of 74 bytes, so this is room for thousands of
/// rotations.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Why there is no usable key. The text says what the operator should do.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The system refused access to the file.
    #[error("the master key file {path} cannot be used: {source}")]
    Io {
        /// The key file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The file can be read or written by others than its owner and a group that may read it.
    #[error(
        "the master key file {path} can be read by others, or written by a group (mode \
         {mode:03o}): run chmod 600 {path}, or 640 for a group that may read it",
        path = path.display()
    )]
    Exposed {
        /// The key file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// The file exists, but its content is not valid.
    #[error("the master key file {path}, line {line}: {reason}", path = path.display())]
    Malformed {
        /// The key file.
        path: PathBuf,
        /// One-based line number.
        line: usize,
        /// What is expected; never what was found.
        reason: &'static str,
    },
    /// `QUADMARK_MASTER_KEY` is not a key.
    #[error(
        "master_key must be 64 hexadecimal digits (32 bytes), or several such keys with commas \
         between them, each once and the newest last; make one with: openssl rand -hex 32"
    )]
    BadMasterKey,
    /// A record names a key that is not in the key ring.
    #[error("master key {0} is not in the key file: restore the file from its backup")]
    Unknown(String),
    /// The system gave no random bytes.
    #[error("the system gave no random bytes: {0}")]
    Random(getrandom::Error),
    /// The key ring came from the environment, so there is no file to append to.
    #[error("the master key comes from QUADMARK_MASTER_KEY: unset it to work with the key file")]
    NoFile,
}

struct MasterKey {
    id: String,
    bytes: Zeroizing<[u8; KEY_BYTES]>,
}

impl MasterKey {
    fn new(bytes: Zeroizing<[u8; KEY_BYTES]>) -> Self {
        Self { id: key_id(&bytes), bytes }
    }

    fn random() -> Result<Self, KeyError> {
        let mut bytes = Zeroizing::new([0; KEY_BYTES]);
        getrandom::fill(bytes.as_mut()).map_err(KeyError::Random)?;
        Ok(Self::new(bytes))
    }

    fn line(&self) -> Zeroizing<String> {
        let hex = Zeroizing::new(hex::encode(self.bytes.as_ref()));
        Zeroizing::new(format!("{} {}\n", self.id, hex.as_str()))
    }
}

/// The first 8 hex digits of SHA-256("quadmark/1/key-id" || key): names a key and reveals nothing
/// of it.
fn key_id(key: &[u8; KEY_BYTES]) -> String {
    let mut hash = Sha256::new();
    hash.update(KEY_ID_LABEL);
    hash.update(key);
    hex::encode(hash.finalize().first_chunk::<4>().unwrap_or(&[0; 4]))
}

/// All master keys. The last one makes new marks; the others still verify old ones.
pub struct KeyRing {
    keys: Vec<MasterKey>,
    file: Option<PathBuf>,
}

impl fmt::Debug for KeyRing {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_list().entries(self.ids()).finish()
    }
}

impl KeyRing {
    /// Reads keys of 64 hex digits each (`QUADMARK_MASTER_KEY`) in place of a key file. Commas or
    /// white space separate them, and the last one is the current key.
    ///
    /// # Errors
    /// [`KeyError::BadMasterKey`].
    pub fn from_hex(text: &str) -> Result<Self, KeyError> {
        let mut keys: Vec<MasterKey> = Vec::new();
        let words = text.split(|letter: char| letter == ',' || letter.is_whitespace());
        for hex in words.filter(|word| !word.is_empty()) {
            let key = MasterKey::new(key_from_hex(hex).ok_or(KeyError::BadMasterKey)?);
            if keys.iter().any(|known| known.id == key.id) {
                return Err(KeyError::BadMasterKey);
            }
            keys.push(key);
        }
        if keys.is_empty() {
            return Err(KeyError::BadMasterKey);
        }
        Ok(Self { keys, file: None })
    }

    /// Reads the key file. If there is none, creates one with a fresh key, mode 0600.
    ///
    /// The flag says whether the file was just created, so that the caller can tell the operator to
    /// back it up.
    ///
    /// # Errors
    /// [`KeyError`] when the file is unreadable, readable by others, or malformed.
    pub fn open_or_create(path: &Path) -> Result<(Self, bool), KeyError> {
        // Syncs the name of the file too: a process that made it may not have lived to do so. Where
        // that is not allowed, mostly for a mounted secret, the service did not make the file.
        let opened = Self::open(path).inspect(|_| drop(crate::durable::sync_parent(path)));
        match opened {
            Err(KeyError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                Ok((Self::create(path)?, true))
            }
            other => other.map(|ring| (ring, false)),
        }
    }

    /// Reads an existing key file.
    ///
    /// # Errors
    /// [`KeyError`] when the file is missing, unreadable, readable by others, or malformed.
    pub fn open(path: &Path) -> Result<Self, KeyError> {
        let failed = |source| KeyError::Io { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        check_mode(&file, path)?;
        let mut text = Zeroizing::new(String::with_capacity(4096));
        file.take(MAX_FILE_BYTES).read_to_string(&mut text).map_err(failed)?;
        let keys = parse(&text).map_err(|(line, reason)| KeyError::Malformed {
            path: path.to_owned(),
            line,
            reason,
        })?;
        Ok(Self { keys, file: Some(path.to_owned()) })
    }

    fn create(path: &Path) -> Result<Self, KeyError> {
        let key = MasterKey::random()?;
        write_new(path, &key.line())
            .map_err(|source| KeyError::Io { path: path.to_owned(), source })?;
        // Reads the file that is there now: another process may have created it first.
        Self::open(path)
    }

    /// Removes what a crash left of a key file that was being written. Returns the number of files.
    #[must_use]
    pub fn remove_staging(path: &Path) -> usize {
        file::lock(path).map_or(0, |locked| locked.remove_staging())
    }

    /// Appends a fresh key to the file, which keeps its owner and mode, and makes it the current
    /// key. Keys that other processes have appended meanwhile stay. Returns the id of the new key.
    ///
    /// # Errors
    /// [`KeyError::NoFile`] for a ring from the environment; [`KeyError::Io`].
    pub fn rotate(&mut self) -> Result<String, KeyError> {
        let path = self.file.clone().ok_or(KeyError::NoFile)?;
        let failed = |source| KeyError::Io { path: path.clone(), source };
        let locked = file::lock(&path).map_err(failed)?;
        let mut now = Self::open(&locked.path)?;
        now.keys.push(MasterKey::random()?);
        let mut text = Zeroizing::new(String::with_capacity(now.keys.len() * 80));
        for key in &now.keys {
            text.push_str(&key.line());
        }
        locked.replace(&text).map_err(failed)?;
        std::mem::swap(&mut self.keys, &mut now.keys);
        Ok(self.current().to_owned())
    }

    /// The key ids, oldest first; the last one is current.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.keys.iter().map(|key| key.id.as_str())
    }

    /// The id of the key that new marks use.
    #[must_use]
    pub fn current(&self) -> &str {
        self.keys.last().map_or("", |key| key.id.as_str())
    }

    /// The mark key of one record:
    /// HKDF-SHA256(master key, salt, "quadmark/1/mark" || owner id).
    ///
    /// # Errors
    /// [`KeyError::Unknown`] when the ring does not hold the master key.
    pub fn mark_key(
        &self,
        key_id: &str,
        salt: &[u8; KEY_BYTES],
        owner_id: &str,
    ) -> Result<Zeroizing<[u8; KEY_BYTES]>, KeyError> {
        let unknown = || KeyError::Unknown(key_id.to_owned());
        let master = self.keys.iter().find(|key| key.id == key_id).ok_or_else(unknown)?;
        let mut mark_key = Zeroizing::new([0; KEY_BYTES]);
        Hkdf::<Sha256>::new(Some(salt), master.bytes.as_ref())
            .expand_multi_info(&[MARK_KEY_LABEL, owner_id.as_bytes()], mark_key.as_mut())
            // Only lengths over 8160 bytes fail; this length is 32.
            .map_err(|_| unknown())?;
        Ok(mark_key)
    }
}

/// Random bytes from the system, for salts and messages.
///
/// # Errors
/// [`KeyError::Random`].
pub fn random_bytes<const N: usize>() -> Result<[u8; N], KeyError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(KeyError::Random)?;
    Ok(bytes)
}

fn key_from_hex(text: &str) -> Option<Zeroizing<[u8; KEY_BYTES]>> {
    let mut bytes = Zeroizing::new([0; KEY_BYTES]);
    hex::decode_to_slice(text, bytes.as_mut()).ok()?;
    Some(bytes)
}

impl Drop for KeyRing {
    fn drop(&mut self) {
        for key in &mut self.keys {
            key.bytes.zeroize();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f";

    #[test]
    fn golden_derivation() {
        // Computed independently of this code, with Python's hmac and hashlib.
        let ring = KeyRing::from_hex(KEY).unwrap();
        assert_eq!(ring.current(), "7f2971a5");
        let key = ring.mark_key(ring.current(), &[7; 32], "acme").unwrap();
        assert_eq!(
            hex::encode(key.as_ref()),
            "0533412e5111fde2d35eed8de188fa8b3ded73fbd757ac0570d51fab17239232"
        );
    }

    #[test]
    fn every_input_changes_the_mark_key() {
        let ring = KeyRing::from_hex(KEY).unwrap();
        let other = KeyRing::from_hex(&"ab".repeat(32)).unwrap();
        let key =
            |ring: &KeyRing, salt, owner| ring.mark_key(ring.current(), &salt, owner).unwrap();
        let all = [
            key(&ring, [7; 32], "acme"),
            key(&ring, [8; 32], "acme"),
            key(&ring, [7; 32], "acmf"),
            key(&other, [7; 32], "acme"),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all.iter().skip(i + 1).all(|b| a.as_ref() != b.as_ref()));
        }
        assert!(matches!(ring.mark_key("00000000", &[7; 32], "acme"), Err(KeyError::Unknown(_))));
    }

    #[test]
    fn created_once_private_and_read_again() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("deep/er/master.keys");
        let (ring, created) = KeyRing::open_or_create(&path).unwrap();
        assert!(created);
        let (again, created) = KeyRing::open_or_create(&path).unwrap();
        assert!(!created);
        assert_eq!(ring.current(), again.current());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
            assert_eq!(mode(&path), 0o600);
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
            let error = KeyRing::open_or_create(&path).unwrap_err().to_string();
            assert!(error.contains("chmod 600"), "{error}");
        }
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn several_keys_by_environment_the_last_is_current() {
        let other = "ab".repeat(32);
        let (old, new) = (KeyRing::from_hex(KEY).unwrap(), KeyRing::from_hex(&other).unwrap());
        for between in [",", ", ", "\n", " "] {
            let ring = KeyRing::from_hex(&format!("{KEY}{between}{other}")).unwrap();
            assert_eq!(ring.ids().collect::<Vec<_>>(), [old.current(), new.current()]);
            assert_eq!(ring.current(), new.current());
        }
        for text in ["", " , ", &format!("{KEY},{KEY}"), &format!("{KEY},ab"), &KEY.repeat(2)] {
            assert!(matches!(KeyRing::from_hex(text), Err(KeyError::BadMasterKey)), "{text}");
        }
    }

    #[test]
    fn rotations_at_once_lose_no_key() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("master.keys");
        KeyRing::open_or_create(&path).unwrap();
        let rotate = || {
            // Every thread begins with the file as it was before any rotation.
            let mut ring = KeyRing::open(&path).unwrap();
            (0..4).map(|_| ring.rotate().unwrap()).collect::<Vec<String>>()
        };
        let made: Vec<String> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(rotate)).collect();
            threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
        });
        let ring = KeyRing::open(&path).unwrap();
        assert_eq!((made.len(), ring.ids().count()), (32, 33));
        assert!(made.iter().all(|id| ring.ids().any(|known| known == id)));
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn rotation_keeps_mode_and_symbolic_link_and_owner() {
        use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown, symlink};
        let directory = tempfile::tempdir().unwrap();
        let (real, link) = (directory.path().join("real.keys"), directory.path().join("link.keys"));
        KeyRing::open_or_create(&real).unwrap();
        symlink(&real, &link).unwrap();
        let set = |mode| {
            std::fs::set_permissions(&real, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        // Only root can give files away.
        let given = chown(&real, Some(12345), Some(23456)).is_ok();
        for mode in [0o600, 0o640, 0o440] {
            set(mode);
            // Another user could not read it.
            KeyRing::open(&link).unwrap().rotate().unwrap();
            let found = std::fs::metadata(&real).unwrap();
            assert_eq!(found.permissions().mode() & 0o777, mode);
            assert!(!given || (found.uid(), found.gid()) == (12345, 23456));
        }
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(KeyRing::open(&link).unwrap().ids().count(), 4);
        for mode in [0o660, 0o644, 0o604, 0o620, 0o601] {
            set(mode);
            assert!(matches!(KeyRing::open(&link), Err(KeyError::Exposed { .. })), "{mode:o}");
        }
        set(0o600);
        let left = directory.path().join("real.keys.new-0123");
        std::fs::write(&left, "half").unwrap();
        assert_eq!((KeyRing::remove_staging(&link), left.exists()), (1, false));
    }

    #[test]
    fn rotation_keeps_old_keys() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("master.keys");
        let (mut ring, _) = KeyRing::open_or_create(&path).unwrap();
        let first = ring.current().to_owned();
        let old = ring.mark_key(&first, &[1; 32], "acme").unwrap();
        let second = ring.rotate().unwrap();
        let again = KeyRing::open(&path).unwrap();
        assert_eq!(again.ids().collect::<Vec<_>>(), [first.as_str(), second.as_str()]);
        assert_eq!(again.current(), second);
        assert_eq!(again.mark_key(&first, &[1; 32], "acme").unwrap().as_ref(), old.as_ref());
        assert!(matches!(KeyRing::from_hex(KEY).unwrap().rotate(), Err(KeyError::NoFile)));
    }

    #[test]
    fn damaged_files_are_refused_without_showing_keys() {
        let good = MasterKey::new(key_from_hex(KEY).unwrap());
        let cases = [
            String::new(),
            "nonsense\n".to_owned(),
            format!("12345678 {KEY}\n"),
            format!("{} {}\n", good.id, KEY.get(..62).unwrap()),
            format!("{}{}", good.line().as_str(), good.line().as_str()),
        ];
        for text in cases {
            assert!(parse(&text).is_err(), "{text}");
        }
        assert!(KeyRing::from_hex("abc").is_err());
        let ring = KeyRing::from_hex(KEY).unwrap();
        assert!(!format!("{ring:?}").contains("0001"));
    }
}
