//! Any bytes have a format or are refused, and a refused file is refused before it is parsed.
#![no_main]

use libfuzzer_sys::fuzz_target;
use quadmark::formats::{Asset, Limits, sniff};

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_vertices: 10_000, max_triangles: 10_000, max_bytes: 1 << 20 };
    match (sniff(bytes), Asset::read(bytes, &limits)) {
        (Err(refused), read) => assert_eq!(read.err(), Some(refused)),
        (Ok(format), Ok(asset)) => assert_eq!(asset.format(), format),
        (Ok(_), Err(_)) => {}
    }
});
