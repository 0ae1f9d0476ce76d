//! Any bytes are read or refused; what is read can be left alone, moved, written and read back.
#![no_main]

use glam::DVec3;
use libfuzzer_sys::fuzz_target;
use quadmark::formats::{Asset, Format, Limits};

fn bits(positions: &[DVec3]) -> Vec<[u64; 3]> {
    positions.iter().map(|position| position.to_array().map(f64::to_bits)).collect()
}

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_vertices: 10_000, max_triangles: 10_000, max_bytes: 1 << 20 };
    let Ok(asset) = Asset::read(bytes, &limits) else { return };
    if asset.format() != Format::Obj {
        return;
    }
    let host = asset.mesh().positions();
    assert_eq!(asset.write(bytes, host).as_deref(), Ok(bytes));

    // Every other vertex moves. The vertex number determines the move.
    let mut positions = host.to_vec();
    for (index, position) in positions.iter_mut().enumerate().step_by(2) {
        let moved = *position * 1.001 + DVec3::new(0.1, -1e-3, 1e-8) * (index % 7) as f64;
        if moved.is_finite() {
            *position = moved;
        }
    }
    asset.round(&mut positions);
    let written = asset.write(bytes, &positions).unwrap();
    let again = Asset::read(&written, &Limits::default()).unwrap();
    assert_eq!(bits(again.mesh().positions()), bits(&positions));
    assert_eq!(again.mesh().triangles(), asset.mesh().triangles());
});
