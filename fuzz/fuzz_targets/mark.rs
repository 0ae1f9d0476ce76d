//! Marks any bytes, with method and strength drawn from them. They are refused, or marked with no
//! wrong bit in a file that reads back.
#![no_main]

use libfuzzer_sys::fuzz_target;
use quadmark::formats::Limits;
use quadmark::marking::{Amplitude, Layers, MarkError, MarkRequest, extract_file, inspect, mark};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Strength};

fuzz_target!(|bytes: &[u8]| {
    let Some((&choice, host)) = bytes.split_last() else { return };
    let limits = Limits { max_vertices: 10_000, max_triangles: 20_000, max_bytes: 1 << 20 };
    let method = Method::ALL[usize::from(choice) % Method::ALL.len()];
    let strength = Strength::new(if choice & 0x80 == 0 { 0.1 } else { 0.25 }).unwrap_or_default();
    // Few bits, so that small meshes can carry them.
    let Ok(bits) = BitCount::new(16) else { return };
    let params = EmbedParams { method, strength, bits, ..EmbedParams::default() };
    let key = MarkKey::from_bytes([choice; 32]);
    let Ok(message) = Message::from_bytes(&[0x5a, choice], bits) else { return };
    let request = MarkRequest {
        key: &key,
        others: &[],
        message: &message,
        params,
        limits,
        stop: &|| false,
        layers: Layers::ALL[usize::from(choice >> 3) % Layers::ALL.len()],
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    let _ = inspect(host, &params, &limits);
    match mark(host, &request) {
        Ok(marked) if marked.report.layers.has_blind() => {
            let found = extract_file(&marked.bytes, &key, bits, method.modulation(), &limits)
                .expect("a marked file can be read");
            for (read, meant) in found.bits.iter().zip(message.bits()) {
                assert!(read.is_none_or(|bit| bit == *meant));
            }
        }
        Err(MarkError::Check(reason)) => panic!("{reason}"),
        Ok(_) | Err(_) => {}
    }
});
