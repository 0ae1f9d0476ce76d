//! Marks that are in no registry, and hosts for them, for the benchmarks of several marks on one
//! mesh.
#![allow(dead_code, reason = "not every benchmark uses everything")]

use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkError, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::Rng;

/// A number of bits, a multiple of eight.
pub fn bits(word: &str) -> BitCount {
    BitCount::new(word.parse().unwrap()).unwrap()
}

/// The file marked with a new key and message.
pub fn marked(
    file: &[u8],
    params: EmbedParams,
    random: &mut ChaCha20Rng,
) -> Result<Vec<u8>, MarkError> {
    let mut key = [0; 32];
    let mut message = vec![0; params.bits.get() / 8];
    random.fill_bytes(&mut key);
    random.fill_bytes(&mut message);
    let request = MarkRequest {
        key: &MarkKey::from_bytes(key),
        others: &[],
        message: &Message::from_bytes(&message, params.bits).unwrap(),
        params,
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    mark(file, &request).map(|marked| marked.bytes)
}

/// The mesh of a file.
pub fn parsed(file: &[u8]) -> Mesh {
    Asset::read(file, &Limits::default()).unwrap().into_mesh()
}

/// Files by name; without any, one of each generated mesh.
pub fn hosts(files: Vec<String>) -> Vec<(String, Vec<u8>)> {
    if files.is_empty() {
        let of = |sample: Sample| (sample.to_string(), to_obj(&sample.mesh(40_000).unwrap()));
        return Sample::ALL.into_iter().map(of).collect();
    }
    let read = |name: String| {
        let bytes = std::fs::read(&name).unwrap();
        (name, bytes)
    };
    files.into_iter().map(read).collect()
}
