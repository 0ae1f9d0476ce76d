//! Sets flags for what this machine has beside the toolchain. A test that needs more is then
//! reported as ignored if it is missing, never as passed.
//!
//! - `shared_meshes`: the folder of test meshes exists (`$QUADMARK_MESHES`, else
//!   `../shared/meshes`; they are not part of the repository).
//! - `can_mount`: this user may mount a file system (Linux, root or an equal).
//! - `has_curl`, `has_cc`, `has_strace`, `has_client_generator` (openapi-python-client): these
//!   programs, and `sh`, can be run.
//!
//! Cargo runs this again when the variable or `PATH` changes, but not when a folder or a program
//! appears: then run `touch build.rs`. The program itself does not depend on any of this.

use std::env;
use std::path::{Path, PathBuf};

/// Programs that some tests run, by the name of their flag.
const PROGRAMS: [(&str, &str); 4] = [
    ("has_curl", "curl"),
    ("has_cc", "cc"),
    ("has_strace", "strace"),
    ("has_client_generator", "openapi-python-client"),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=QUADMARK_MESHES");
    println!("cargo::rerun-if-env-changed=PATH");
    flag("shared_meshes", meshes().is_dir());
    flag("can_mount", can_mount() && is_on_path("mount"));
    let shell = is_on_path("sh");
    for (name, program) in PROGRAMS {
        flag(name, shell && is_on_path(program));
    }
}

/// The folder of the test meshes. `tests/support` uses the same one.
fn meshes() -> PathBuf {
    let beside = || {
        let package = env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default();
        Path::new(&package).join("../shared/meshes")
    };
    env::var_os("QUADMARK_MESHES").map_or_else(beside, PathBuf::from)
}

/// Whether this process has `CAP_SYS_ADMIN`, the 22nd of the capabilities in effect.
fn can_mount() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let held = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let held = held.and_then(|digits| u64::from_str_radix(digits.trim(), 16).ok());
    held.is_some_and(|held| held & (1 << 21) != 0)
}

fn is_on_path(program: &str) -> bool {
    let path = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&path).any(|folder| folder.join(program).is_file())
}

fn flag(name: &str, is_set: bool) {
    println!("cargo::rustc-check-cfg=cfg({name})");
    if is_set {
        println!("cargo::rustc-cfg={name}");
    }
}
