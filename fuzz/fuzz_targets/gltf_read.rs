//! Any bytes as glTF or GLB: no panic, and what can be read must round, write and read back
//! exactly.
#![no_main]

use libfuzzer_sys::fuzz_target;
use quadmark::formats::{Asset, Limits};

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_vertices: 100_000, max_triangles: 200_000, max_bytes: 1 << 22 };
    let Ok(asset) = Asset::read(bytes, &limits) else { return };
    let mut positions = asset.mesh().positions().to_vec();
    assert_eq!(asset.write(bytes, &positions).as_deref(), Ok(bytes), "nothing moved");
    for position in &mut positions {
        *position += 0.01;
    }
    asset.round(&mut positions);
    let written = asset.write(bytes, &positions).expect("rounded positions can be written");
    let back = Asset::read(&written, &limits).expect("what was written reads back");
    assert_eq!(back.mesh().positions(), positions);
    assert_eq!(back.mesh().triangles(), asset.mesh().triangles());
});
