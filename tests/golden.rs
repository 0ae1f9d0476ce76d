//! Marks outlive versions: what a key means, and what an embedding writes, bit for bit.
//!
//! `tests/golden/vectors.json` is refreshed with `QUADMARK_UPDATE_GOLDEN=1`, and a change there is
//! a change of the scheme that needs a new scheme version. `tests/golden/marked_v1.obj` is never
//! refreshed: it was made once with
//!
//! ```text
//! quadmark sample blob --vertices 2400 -o host.obj
//! quadmark embed host.obj -o marked_v1.obj --bits 32 --message c0ffee42 --key 000102...1f
//! ```
//!
//! and every later release must still read it.
#![expect(clippy::unwrap_used, reason = "test helpers")]

use std::path::{Path, PathBuf};

use quadmark::formats::{Asset, Format, Limits};
use quadmark::marking::{MarkRequest, extract_file, mark};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{
    BitCount, EmbedParams, MarkKey, Message, Method, Modulation, Schedule, Strength,
};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn keys() -> [(&'static str, MarkKey); 3] {
    [
        ("zeros", MarkKey::from_bytes([0; 32])),
        ("counting", MarkKey::from_bytes(counting())),
        ("sha256 of quadmark", MarkKey::from_bytes(Sha256::digest(b"quadmark").into())),
    ]
}

fn counting() -> [u8; 32] {
    std::array::from_fn(|i| u8::try_from(i).unwrap())
}

fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

fn schedules() -> Value {
    let mut cases = Vec::new();
    for (name, key) in keys() {
        for bits in [16, 64, 256] {
            let schedule = Schedule::new(&key, BitCount::new(bits).unwrap());
            // Bins are below 256: one byte each.
            let bins: Vec<u8> =
                schedule.bin_of_bit.iter().map(|&bin| u8::try_from(bin).unwrap()).collect();
            let whitening: Vec<u8> = schedule.whitening.iter().map(|&bit| u8::from(bit)).collect();
            let mut case = json!({
                "key": name,
                "bits": bits,
                "lattice_class": schedule.lattice_class,
                "permutation_sha256": sha256(&bins),
                "whitening_sha256": sha256(&whitening),
            });
            if bits == 16 {
                case["permutation"] = json!(bins);
                case["whitening"] = json!(whitening);
            }
            cases.push(case);
        }
    }
    Value::Array(cases)
}

fn marked_bytes(host: &[u8], method: Method) -> Vec<u8> {
    let (bits, strength) = (BitCount::new(32).unwrap(), Strength::new(0.1).unwrap());
    let request = MarkRequest {
        key: &MarkKey::from_bytes(counting()),
        message: &Message::from_hex("c0ffee42", bits).unwrap(),
        params: EmbedParams { method, strength, bits, closed_loop: true },
        limits: Limits::default(),
        stop: &|| false,
        independent_check_max_bytes: usize::MAX,
    };
    mark(host, &request).unwrap().bytes
}

fn marked_files() -> Value {
    // Six decimals hide what little the sine of one platform differs from that of another; the
    // GLB is made from the text for the same reason.
    let obj = to_obj(&Sample::Blob.mesh(3_000).unwrap());
    let glb = to_glb(Asset::read(&obj, &Limits::default()).unwrap().mesh());
    let of = |host: &[u8], method| json!(sha256(&marked_bytes(host, method)));
    let mut files = json!({ "host.obj": sha256(&obj), "host.glb": sha256(&glb) });
    for method in Method::ALL {
        files[format!("{method}.obj")] = of(&obj, method);
        files[format!("{method}.glb")] = of(&glb, method);
    }
    files
}

#[test]
fn keys_and_marked_files_are_as_they_were() {
    let path = folder().join("vectors.json");
    let now = json!({ "scheme_version": 1, "schedules": schedules(), "marked": marked_files() });
    if std::env::var_os("QUADMARK_UPDATE_GOLDEN").is_some_and(|value| value == "1") {
        std::fs::write(&path, serde_json::to_string_pretty(&now).unwrap() + "\n").unwrap();
    }
    let then: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(now["schedules"], then["schedules"], "what a key means has changed");
    assert_eq!(now["marked"], then["marked"], "what an embedding writes has changed");
}

#[test]
fn the_first_release_s_mark_is_still_read() {
    let bytes = std::fs::read(folder().join("marked_v1.obj")).unwrap();
    let key = MarkKey::from_bytes(counting());
    let bits = BitCount::new(32).unwrap();
    let found = extract_file(&bytes, &key, bits, Modulation::Mean, &Limits::default()).unwrap();
    assert_eq!(found.message().unwrap().to_hex(), "c0ffee42");
    assert!(found.margins.iter().all(|margin| *margin > 0.05), "{:?}", found.margins);
    let format = Asset::read(&bytes, &Limits::default()).unwrap().format();
    assert_eq!(format, Format::Obj);
}
