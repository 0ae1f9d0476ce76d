//! Each of the recipients who average their copies is still named.

#![allow(clippy::unwrap_used)]

use glam::DVec3;
use quadmark::formats::{Asset, Limits};
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, Codeword, EmbedParams, MarkKey, Message, Suspect};

/// log10 of the factor on a bound: 100,000 records, and a sixteenth of the error probability.
const COUNTED: f64 = 5.0 + 1.204_12;

/// A recipient's copy, with 256 bits. With 64 bits, two colluders already hide. By
/// `benches/collusion.rs`, with other keys one colluder in six of three is not named.
fn copy(host: &[u8], seed: u8) -> (Mesh, Codeword) {
    let bits = BitCount::new(256).unwrap();
    let key = MarkKey::from_bytes([seed; 32]);
    let message = Message::from_bytes(&[seed.wrapping_mul(37); 32], bits).unwrap();
    let request = MarkRequest {
        key: &key,
        others: &[],
        message: &message,
        params: EmbedParams { bits, ..EmbedParams::default() },
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    let bytes = mark(host, &request).unwrap().bytes;
    let mesh = Asset::read(&bytes, &request.limits).unwrap().into_mesh();
    (mesh, Codeword::new(&key, &message))
}

/// The mean of the copies, vertex by vertex.
fn average(copies: &[(Mesh, Codeword)]) -> Mesh {
    let count = copies.len() as f64;
    let at = |v: usize| copies.iter().map(|(copy, _)| copy.positions()[v]).sum::<DVec3>() / count;
    let first = &copies[0].0;
    let positions = (0..first.positions().len()).map(at).collect();
    Mesh::new(positions, first.triangles().to_vec()).unwrap()
}

#[test]
fn averages_of_two_and_three_copies_name_each_colluder_and_nobody_else() {
    let host = to_obj(&Sample::Blob.mesh(40_000).unwrap());
    let copies: Vec<(Mesh, Codeword)> = (1..=4).map(|seed| copy(&host, seed)).collect();
    for colluders in [&copies[..2], &copies[..3]] {
        let suspect = Suspect::new(&average(colluders)).unwrap();
        for (recipient, (_, codeword)) in copies.iter().enumerate() {
            let modulation = EmbedParams::default().method.modulation();
            let soft = suspect.read(codeword.layout_class(), codeword.bit_count(), modulation);
            let bound = soft.log10_bound(soft.score(codeword).t) + COUNTED;
            let guilty = recipient < colluders.len();
            assert_eq!(bound < -9.0, guilty, "{recipient} of {}: {bound}", colluders.len());
        }
    }
}
