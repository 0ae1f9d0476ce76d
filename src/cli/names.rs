//! Names of hosts: the names of their files without the extension, with as many of the folders
//! above as make them different.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::Failure;

/// One name per file, all different.
///
/// # Errors
/// When a file is given twice, however it is spelled, or two names cannot be made different.
pub(super) fn of(paths: &[PathBuf]) -> Result<Vec<String>, Failure> {
    // A file that cannot be found is reported when it is read.
    let found = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
    let found: Vec<PathBuf> = paths.iter().map(found).collect();
    for (number, (path, file)) in paths.iter().zip(&found).enumerate() {
        if found.iter().take(number).any(|earlier| earlier == file) {
            return Err(Failure(format!("{} is named twice: once is enough", path.display())));
        }
    }
    // Named by the path that the user gave, not by the target of a link.
    let whole = |path: &PathBuf| std::path::absolute(path).unwrap_or_else(|_| path.clone());
    let whole: Vec<PathBuf> = paths.iter().map(whole).collect();
    let names: Vec<String> = whole.iter().map(|path| shortest(path, &whole)).collect();
    let mut known = BTreeSet::new();
    match names.iter().find(|name| !known.insert(name.as_str())) {
        Some(name) => Err(Failure(format!("two files would be called {name}: rename one"))),
        None => Ok(names),
    }
}

/// The shortest end of a path that no other path has, without the extension if that is enough.
fn shortest(path: &Path, all: &[PathBuf]) -> String {
    let own = |end: &dyn Fn(&Path) -> String| {
        let text = end(path);
        let shared = all.iter().filter(|other| end(other) == text).count() > 1;
        (!shared).then_some(text)
    };
    let count = path.components().count();
    let without = (1..=count).find_map(|n| own(&|path| end(&path.with_extension(""), n)));
    without
        .or_else(|| (1..=count).find_map(|n| own(&|path| end(path, n))))
        .unwrap_or_else(|| end(path, count))
}

/// The last `count` parts of a path.
fn end(path: &Path, count: usize) -> String {
    let parts: Vec<_> =
        path.components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect();
    let first = parts.len().saturating_sub(count);
    parts.get(first..).unwrap_or_default().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(paths: &[&str]) -> Result<Vec<String>, String> {
        let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
        of(&paths).map_err(|Failure(text)| text)
    }

    #[test]
    fn names_are_short_and_tell_files_apart() {
        let cases: [(&[&str], &[&str]); 6] = [
            (&["m/bunny.obj", "m/gear.obj"], &["bunny", "gear"]),
            (&["one/blob.obj", "two/blob.obj"], &["one/blob", "two/blob"]),
            (&["a/x/blob.obj", "b/x/blob.obj", "c.obj"], &["a/x/blob", "b/x/blob", "c"]),
            (&["m/blob.obj", "m/blob.glb"], &["blob.obj", "blob.glb"]),
            (&["scan.v2.obj"], &["scan.v2"]),
            (&["blob.obj.glb", "blob.obj"], &["blob.obj", "blob"]),
        ];
        for (paths, expected) in cases {
            assert_eq!(named(paths).unwrap(), expected);
        }
        assert!(named(&["a/blob.obj", "a/blob.obj"]).unwrap_err().contains("named twice"));
        // The first two files differ by their extensions; the third has the same name without its
        // extension.
        let clash = ["m/blob.obj", "m/blob.glb", "n/blob.obj.glb"];
        assert!(named(&clash).unwrap_err().contains("would be called blob.obj"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_called_by_its_own_name_and_is_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link] = ["5fe2.obj", "bunny.obj"].map(|name| folder.path().join(name));
        std::fs::write(&file, "").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let [file, link] = [&file, &link].map(|path| path.to_string_lossy().into_owned());
        assert_eq!(named(&[&link]).unwrap(), ["bunny"]);
        assert!(named(&[&file, &link]).unwrap_err().contains("bunny.obj is named twice"));
    }
}
