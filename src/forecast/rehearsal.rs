//! A rehearsal: a mark is made in memory and attacked, to measure what would be left of a real
//! mark. Where marks begin to fail depends on how far an attack moves the centre by enlarging the
//! area of fine parts. The rehearsal shows that as a real mark would.

use rayon::prelude::*;

use crate::attacks::random::Random;
use crate::attacks::re_mark::{key_and_message, mark_until};
use crate::attacks::{Attack, Context, Target};
use crate::mesh::Mesh;
use crate::watermark::{BitCount, Codeword, EmbedParams, Method, Modulation, SoftBits, Suspect};

/// Seed of the rehearsed mark's key and message, and of the attacks. The value is arbitrary; it is
/// fixed so that the answer repeats.
const SEED: u64 = 20_090_626;

/// Largest number of triangles with which simplification is rehearsed. Simplification is one call
/// of a library that cannot be stopped. At this size, it and the work around it take 70 ms
/// (`benches/stops.rs`).
const MOST_SIMPLIFIED: usize = 80_000;

/// Whether an attack is rehearsed on this number of triangles. Remeshing takes ten times as long as
/// all other attacks together. An attack that changes no norm equals no attack. For further marks,
/// a rehearsal predicted no better than counts do.
fn is_rehearsed(attack: Attack, triangles: usize) -> bool {
    if matches!(attack, Attack::Simplify(_)) {
        return triangles <= MOST_SIMPLIFIED;
    }
    !matches!(
        attack,
        Attack::Remesh(_)
            | Attack::Similarity
            | Attack::Reorder
            | Attack::RoundTrip
            | Attack::Collude(_)
            | Attack::ReMark
    )
}

/// Decimal logarithms of the bounds after each attack; `None` where an attack is not rehearsed or
/// nothing is left. Empty when the mesh does not carry the mark.
///
/// The mark has the requested modulation, strength and number of bits. It has the paper's
/// placement, which takes a tenth of the time of the `exact` one and fades in the same way.
#[must_use]
pub fn rehearse(
    host: &Mesh,
    params: &EmbedParams,
    attacks: &[Attack],
    stop: &(dyn Fn() -> bool + Sync),
) -> Vec<Option<f64>> {
    let modulation = params.method.modulation();
    let method = match modulation {
        Modulation::Mean => Method::QspMean,
        Modulation::Variance => Method::QspVar,
    };
    let params = EmbedParams { method, closed_loop: true, ..*params };
    let Ok((key, message)) = key_and_message(&params, &mut Random::new(SEED)) else {
        return Vec::new();
    };
    let codeword = Codeword::new(&key, &message);
    let marked = mark_until(host, &codeword, &params, &|| stop())
        .ok()
        .and_then(|made| Mesh::new(made.positions, host.triangles().to_vec()).ok());
    let Some(marked) = marked else { return Vec::new() };
    let context = Context { host, params: &params, amplitude: None };
    let after = |(place, &attack): (u64, &Attack)| {
        if stop() || !is_rehearsed(attack, host.triangles().len()) {
            return None;
        }
        let attacked = attack.apply(&Target::until(&marked, stop), &context, SEED ^ place).ok()?;
        if stop() {
            return None;
        }
        bound(&attacked, &codeword, params.bits, modulation, stop)
    };
    let numbered: Vec<(u64, &Attack)> = (1..).zip(attacks).collect();
    numbered.into_par_iter().with_max_len(1).map(after).collect()
}

/// The false-positive bound of a blind reading.
fn bound(
    suspect: &Mesh,
    codeword: &Codeword,
    bits: BitCount,
    modulation: Modulation,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<f64> {
    let suspect = Suspect::new_until(suspect, stop).ok()?;
    let read: SoftBits = suspect.read(codeword.layout_class(), bits, modulation);
    Some(read.log10_bound(read.score(codeword).t))
}
