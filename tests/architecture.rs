//! The import rules of the design: which module may name which, and which library stays where. They
//! are written down in ARCHITECTURE.md and checked here, by reading the sources.

mod support;

use std::fs;
use std::path::Path;

use support::{files_below, has_extension};

/// For each module (a file or folder of `src`), the modules that it may name. A module that is
/// missing here may name all.
const MAY_SEE: &[(&str, &[&str])] = &[
    ("mesh", &[]),
    ("watermark", &["mesh"]),
    ("formats", &["mesh"]),
    ("sample", &["mesh"]),
    ("registration", &["mesh"]),
    ("relief", &["watermark", "mesh"]),
    ("recognition", &["registration", "relief", "watermark", "mesh"]),
    ("marking", &["formats", "relief", "watermark", "mesh"]),
    ("config", &["formats"]),
    ("durable", &[]),
    ("keys", &["durable"]),
    ("registry", &["durable", "relief", "watermark", "formats"]),
    ("blobs", &["durable", "mesh"]),
    ("jobs", &[]),
    (
        "service",
        &[
            "blobs",
            "config",
            "durable",
            "forecast",
            "formats",
            "jobs",
            "keys",
            "marking",
            "mesh",
            "recognition",
            "registration",
            "registry",
            "relief",
            "watermark",
        ],
    ),
    // One of them writes files from meshes, as `sample` does.
    ("attacks", &["formats", "watermark", "mesh", "sample", "relief"]),
    ("forecast", &["attacks", "formats", "marking", "sample", "watermark", "mesh"]),
    (
        "lab",
        &[
            "attacks",
            "forecast",
            "formats",
            "watermark",
            "mesh",
            "marking",
            "sample",
            "relief",
            "recognition",
            "registration",
        ],
    ),
];

/// For each library, the only parts of `src` that may name it.
const ONLY_IN: &[(&str, &[&str])] = &[
    ("axum", &["http"]),
    ("hyper", &["http"]),
    ("hyper_util", &["http"]),
    ("tower", &["http"]),
    ("tower_http", &["http"]),
    ("utoipa", &["http", "service"]),
    ("sqlx", &["registry"]),
    ("gltf", &["formats"]),
    ("tobj", &["formats"]),
    ("object_store", &["blobs"]),
    ("quick_cache", &["service/verify/host_cache"]),
    ("rand_chacha", &["watermark/codeword", "relief/signs", "attacks/random"]),
    ("meshopt", &["attacks"]),
    ("png", &["lab/report"]),
    ("csv", &["lab/row"]),
    ("hkdf", &["keys"]),
    ("parry3d_f64", &["mesh", "registration"]),
];

/// Words that must not occur in a pure module.
const IMPURE: &[&str] =
    &["std::fs", "std::net", "std::time", "std::env", "tokio", "async fn", "getrandom", "tracing"];
const PURE: &[&str] = &[
    "mesh",
    "watermark",
    "registration",
    "relief",
    "recognition",
    "marking",
    "sample",
    "formats",
    "attacks",
    "forecast",
];

/// Methods whose last bits differ from platform to platform; `libm` has all these functions. Sums,
/// products, quotients and square roots are exact by IEEE 754, and `powers` has the small powers.
const NOT_THE_SAME_EVERYWHERE: &[&str] = &[
    "powi",
    "powf",
    "exp",
    "exp2",
    "exp_m1",
    "ln",
    "ln_1p",
    "log",
    "log2",
    "log10",
    "sin",
    "cos",
    "tan",
    "sin_cos",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "hypot",
    "cbrt",
    "mul_add",
    "from_scaled_axis",
    "to_scaled_axis",
    "from_axis_angle",
    "to_axis_angle",
    "from_euler",
    "to_euler",
    "from_rotation_x",
    "from_rotation_y",
    "from_rotation_z",
    "from_rotation_arc",
    "angle_between",
    "slerp",
    "rotate_towards",
    "exp2_f64",
];
/// Modules where a mark or a reading would differ with them.
const THE_SAME_EVERYWHERE: &[&str] =
    &["mesh", "watermark", "relief", "registration", "recognition", "formats", "marking", "sample"];

/// Whether `code` calls a method or an associated function of this name.
fn calls(code: &str, name: &str) -> bool {
    let call = format!("{name}(");
    code.match_indices(&call).any(|(at, _)| {
        let before = &code[..at];
        before.ends_with('.') || (before.ends_with("::") && !before.ends_with("libm::"))
    }) || code.contains(&format!("f64::{name})"))
}

/// The code without comments, strings and tests. Tests may use samples and libraries freely.
fn code_of(source: &str) -> String {
    // `mod tests`, or a test module that other tests use.
    let begins = |at: &str| source.find(at).unwrap_or(source.len());
    let tests = begins("\n#[cfg(test)]\nmod ").min(begins("\n#[cfg(test)]\npub"));
    let source = &source[..tests];
    let mut code = String::with_capacity(source.len());
    let mut rest = source.chars().peekable();
    while let Some(letter) = rest.next() {
        match letter {
            '/' if rest.peek() == Some(&'/') => {
                rest.by_ref().find(|&letter| letter == '\n');
                code.push('\n');
            }
            // A quoted quote ('"') is a character, not the start of a text.
            '"' if !code.ends_with('\'') => {
                while let Some(inside) = rest.next() {
                    match inside {
                        '\\' => drop(rest.next()),
                        '"' => break,
                        _ => {}
                    }
                }
                code.push_str("\"\"");
            }
            _ => code.push(letter),
        }
    }
    code
}

/// Whether `word` occurs in `code` as a whole path, followed by `after`.
fn names(code: &str, word: &str, after: &str) -> bool {
    let is_name = |letter: char| letter.is_alphanumeric() || letter == '_';
    code.match_indices(&format!("{word}{after}")).any(|(at, _)| {
        let before = code[..at].chars().next_back();
        // `formats::gltf::` and `self::gltf::` are modules of ours, not the library.
        !before.is_some_and(|letter| is_name(letter) || letter == ':')
    })
}

/// The modules of this crate that a file names: `crate::x` and every x of `crate::{x, y::z}`.
fn seen_modules(code: &str, root: &str) -> Vec<String> {
    let mut seen = Vec::new();
    for (at, prefix) in code.match_indices(&format!("{root}::")) {
        if code[..at].ends_with(|letter: char| letter.is_alphanumeric() || letter == '_') {
            continue;
        }
        let rest = &code[at + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            seen.push(first_name(rest));
            continue;
        };
        let mut depth = 0_i32;
        let mut start = 0;
        for (at, letter) in group.char_indices() {
            match letter {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    seen.push(first_name(group[start..at].trim()));
                    start = at + 1;
                    if letter == '}' {
                        break;
                    }
                }
                _ => {}
            }
        }
    }
    seen.retain(|name| !name.is_empty());
    seen
}

fn first_name(path: &str) -> String {
    path.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
}

/// The faults of one file of `src`, named by its path without `src/`.
fn faults(path: &str, source: &str) -> Vec<String> {
    let module = path.split('/').next().unwrap_or(path).trim_end_matches(".rs");
    let code = code_of(source);
    let mut faults = Vec::new();
    if let Some((_, allowed)) = MAY_SEE.iter().find(|(name, _)| *name == module) {
        for seen in seen_modules(&code, "crate") {
            if seen != module && !allowed.contains(&seen.as_str()) {
                faults.push(format!("{path}: {module} may not see {seen}"));
            }
        }
    }
    for (library, places) in ONLY_IN {
        let inside =
            places.iter().any(|place| path.strip_suffix(".rs").unwrap_or(path).starts_with(place));
        let named = names(&code, library, "::") || names(&code, &format!("use {library}"), ";");
        if !inside && named {
            faults.push(format!("{path}: {library} is for {places:?} only"));
        }
    }
    if PURE.iter().any(|pure| *pure == module || path.starts_with(pure)) {
        for word in IMPURE {
            if code.contains(word) {
                faults.push(format!("{path}: this is pure, {word} is not"));
            }
        }
    }
    if THE_SAME_EVERYWHERE.contains(&module) {
        for name in NOT_THE_SAME_EVERYWHERE {
            if calls(&code, name) {
                faults.push(format!("{path}: {name} is not the same on every platform, libm's is"));
            }
        }
    }
    for word in ["unsafe", "todo!", "dbg!"] {
        if names(&code, word, " ") || names(&code, word, "(") {
            faults.push(format!("{path}: {word}"));
        }
    }
    faults
}

/// Whether a file is a test module, which may use samples and libraries freely.
fn is_test(path: &str) -> bool {
    path.split('/').any(|part| part == "tests" || part == "tests.rs" || part == "test_support.rs")
}

#[test]
fn imports_run_downward_only() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    let files = files_below(&src);
    assert!(files.len() > 40);
    for path in files.iter().filter(|path| has_extension(path, "rs")) {
        let name = path.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/");
        if !is_test(&name) {
            found.extend(faults(&name, &fs::read_to_string(path).unwrap()));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn the_checker_sees_each_crossed_line() {
    let crossed = [
        ("mesh/weld.rs", "use crate::watermark::bins;", "mesh may not see watermark"),
        ("mesh/weld.rs", "use crate::{mesh::sum, formats::Limits};", "mesh may not see formats"),
        ("watermark/a.rs", "fn f() { crate::formats::sniff(b) }", "may not see formats"),
        ("formats/obj/parse.rs", "use crate::watermark::Frame;", "formats may not see watermark"),
        ("marking.rs", "use crate::registry::Record;", "marking may not see registry"),
        ("service/embed.rs", "use crate::http::ApiError;", "service may not see http"),
        ("service/embed.rs", "use axum::Json;", "axum is for"),
        ("jobs/mod.rs", "tower::ServiceBuilder::new()", "tower is for"),
        ("service/known.rs", "sqlx::query(\"SELECT 1\")", "sqlx is for"),
        ("marking.rs", "tobj::load_obj_buf(x)", "tobj is for"),
        ("watermark/embed.rs", "use rand_chacha::ChaCha20Rng;", "rand_chacha is for"),
        ("watermark/embed.rs", "let now = std::time::Instant::now();", "is pure"),
        ("formats/mod.rs", "std::fs::read(path)", "is pure"),
        ("watermark/embed.rs", "let x = y.exp2();", "libm's is"),
        ("registration/newton.rs", "DQuat::from_scaled_axis(v)", "libm's is"),
        ("mesh/weld.rs", "let x = (a + b).powi(2);", "libm's is"),
        ("marking/within.rs", "f64::powf(a, b)", "libm's is"),
        ("sample/mod.rs", "angles.map(f64::sin)", "libm's is"),
        ("keys.rs", "unsafe { x() }", "unsafe"),
    ];
    for (path, source, expected) in crossed {
        let found = faults(path, source);
        assert!(found.iter().any(|fault| fault.contains(expected)), "{path}: {source}: {found:?}");
    }
}

#[test]
fn the_checker_does_not_cry_wolf() {
    let fine = [
        ("mesh/weld.rs", "use super::Mesh;\n// not like crate::watermark::bins\n"),
        ("mesh/weld.rs", "//! [`crate::watermark`] uses this."),
        (
            "mesh/weld.rs",
            "fn f() {}\n\n#[cfg(test)]\nmod tests {\n    use crate::sample::Sample;\n",
        ),
        ("formats/mod.rs", "fn f() { let c = '\"'; self::gltf::read() }"),
        ("formats/gltf/mod.rs", "gltf::Gltf::from_slice(b)"),
        ("watermark/codeword.rs", "use rand_chacha::ChaCha20Rng;"),
        ("http/mod.rs", "use axum::Router; use crate::service::Service;"),
        ("service/text.rs", "let text = \"crate::http:: and sqlx:: and std::fs\";"),
        ("marking.rs", "use crate::{formats::{Asset, Limits}, mesh, watermark::{self, embed}};"),
        ("service/mod.rs", "let not_unsafe = 1; my_axum::f()"),
        ("watermark/embed.rs", "let x = libm::exp2(y) + squared(z.sqrt()); tail.exponent()"),
        ("service/verify/judge.rs", "counted.log10()"),
    ];
    for (path, source) in fine {
        assert_eq!(faults(path, source), Vec::<String>::new(), "{source}");
    }
}
