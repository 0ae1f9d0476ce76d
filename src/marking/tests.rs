//! Marks with several keys.

use super::*;
use crate::sample::{Sample, to_obj};

fn key(number: u8) -> MarkKey {
    MarkKey::from_bytes([number; 32])
}

/// A codeword that distorts too much is followed by the next key's, whose mark is the one that this key
/// makes by itself; the refusal is reported, for it is charged.
#[test]
fn where_a_codeword_is_refused_the_next_key_marks() {
    let host = to_obj(&Sample::Gear.mesh(8000).unwrap());
    let bits = BitCount::new(32).unwrap();
    let message = Message::from_bytes(&[0x5a; 4], bits).unwrap();
    let limits = Limits::default();
    let strength = Strength::new(0.1).unwrap();
    let params = EmbedParams { strength, bits, ..EmbedParams::default() };
    let with = |keys: &[MarkKey], limit: f64| {
        let (first, others) = keys.split_first().unwrap();
        let request = MarkRequest {
            key: first,
            others,
            message: &message,
            params,
            layers: Layers::Blind,
            amplitude: Amplitude::default(),
            limits,
            stop: &|| false,
            independent_check_max_bytes: 0,
        };
        mark_within(&host, &request, MaxDistortion::new(limit).unwrap(), strength)
    };
    // A limit at which some of the codewords are refused at the first strength, and some are not.
    let pair = [1e-4, 7e-5, 5e-5, 4e-5, 3e-5, 2e-5].into_iter().find_map(|limit| {
        let refused = |number: &u8| with(&[key(*number)], limit).map_or(1, |m| m.report.refused);
        let (kept, refused): (Vec<u8>, Vec<u8>) = (1..9).partition(|number| refused(number) == 0);
        Some((limit, *refused.first()?, *kept.first()?))
    });
    let (limit, refused, kept) = pair.unwrap();
    let alone = with(&[key(kept)], limit).unwrap();
    let both = with(&[key(refused), key(kept)], limit).unwrap();
    assert_eq!((both.key, both.report.refused), (1, 1));
    assert!(both.bytes == alone.bytes && both.report.quality.mrms <= limit);
    assert_eq!(alone.key, 0);
}
