//! The note about the registry that served last from a data directory: its identity, and how often
//! it had been written to. The note is a file beside the registry, so that it stays when the
//! registry is replaced.

use std::path::Path;

use super::StartError;
use crate::durable;
use crate::registry::Identity;

const NAME: &str = "registry.seen";

fn failed(path: &Path, source: std::io::Error) -> StartError {
    StartError::Directory { path: path.to_owned(), source }
}

/// Reads the note; `None` if there is none, or if it cannot be parsed.
pub(super) fn read(data: &Path) -> Result<Option<Identity>, StartError> {
    let path = data.join(NAME);
    match std::fs::read_to_string(&path) {
        Ok(text) => Ok(parse(&text)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(failed(&path, error)),
    }
}

fn parse(text: &str) -> Option<Identity> {
    let (id, changes) = text.trim().split_once(' ')?;
    Some(Identity { id: id.to_owned(), changes: changes.parse().ok()? })
}

/// Writes the note anew, durably.
pub(super) fn write(data: &Path, identity: &Identity) -> Result<(), StartError> {
    let (path, beside) = (data.join(NAME), data.join(format!("{NAME}.new")));
    let text = format!("{} {}\n", identity.id, identity.changes);
    durable::replace(&path, &beside, text.as_bytes()).map_err(|source| failed(&path, source))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_read_back() {
        let data = tempfile::tempdir().unwrap();
        assert_eq!(read(data.path()).unwrap(), None);
        let identity = Identity { id: "abc".to_owned(), changes: 7 };
        write(data.path(), &identity).unwrap();
        assert_eq!(read(data.path()).unwrap(), Some(identity));
        for text in ["", "abc", "abc -1", "abc x"] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
