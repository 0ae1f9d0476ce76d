//! The size of marked files in the store, and the time for compressing them compared with marking.
//!
//! ```text
//! cargo bench --bench at_rest -- FILE...
//! ```
//!
//! Per file: bytes plain and stored, seconds for marking (from bytes to checked bytes) and for
//! packing, best of three. Without files: a generated mesh as OBJ and as GLB.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::time::{Duration, Instant};

use quadmark::blobs::marked::pack;
use quadmark::formats::Limits;
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message};
use sha2::{Digest, Sha256};

/// The best time of three runs, and the result of the last.
fn timed<T>(work: impl Fn() -> T) -> (T, Duration) {
    let run = || {
        let start = Instant::now();
        (work(), start.elapsed())
    };
    let best = run().1.min(run().1);
    let (made, last) = run();
    (made, best.min(last))
}

fn main() {
    let names: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let mut files: Vec<(String, Vec<u8>)> =
        names.into_iter().map(|name| (name.clone(), std::fs::read(name).unwrap())).collect();
    if files.is_empty() {
        let mesh = Sample::Blob.mesh(100_000).unwrap();
        files = vec![("obj".to_owned(), to_obj(&mesh)), ("glb".to_owned(), to_glb(&mesh))];
    }
    let params = EmbedParams::default();
    let request = MarkRequest {
        key: &MarkKey::from_bytes([7; 32]),
        others: &[],
        message: &Message::from_bytes(&[0x5a; 8], BitCount::default()).unwrap(),
        params,
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 16 << 20,
    };
    println!(
        "{:>12} {:>12} {:>6} {:>9} {:>9} {:>7}",
        "plain", "stored", "share", "mark", "pack", "cost"
    );
    for (name, host) in files {
        let (marked, marking) = timed(|| mark(&host, &request).unwrap().bytes);
        let sha256 = Sha256::digest(&marked).into();
        let (packed, packing) = timed(|| pack(&marked, &sha256).unwrap());
        let share = packed.len() as f64 / marked.len() as f64;
        let cost = packing.as_secs_f64() / marking.as_secs_f64();
        println!(
            "{:>12} {:>12} {share:>6.3} {:>7.3} s {:>7.4} s {cost:>7.3}  {name}",
            marked.len(),
            packed.len(),
            marking.as_secs_f64(),
            packing.as_secs_f64(),
        );
    }
}
