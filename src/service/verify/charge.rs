//! Charges: the factors on the bound of one record for what was tried before, beside the hypotheses
//! of this verification (`count`).
//!
//! **A series of tries.** Whoever may try again and stop at any time has as many chances of an
//! error as tries. So the error probability of one try is shared out to all tries of the series.
//! The n-th try has a share, all shares together, however many, add up to at most 1, and a bound is
//! divided by its share. The first try has three quarters. The n-th of the others has a quarter of
//! `1 / log2(n) - 1 / log2(n + 1)`, and these add up to the last quarter. The factor on the bound
//! is about `2.8 n log2(n)^2`: 2.5 decades at the tenth try, 4.1 at the hundredth. A factor of `n`
//! alone would not do, because the sum of `1 / n` diverges. A factor of `n (n + 1)` would cost as
//! much at the tenth try, but twice as many decades for large n.
//!
//! **Refused marks.** A record exists because its codeword could be embedded, perhaps where other
//! codewords were refused, at a strength at which the same codeword might have been refused. So the
//! record was chosen. If it is the n-th try for a host and an owner since their last record, it is
//! the n-th of a series.
//!
//! **Siblings.** Whoever registers n marks of a host and revokes all but one has tried n. With `m`
//! of them live, the factor on each live one is `n - m + 1`. Together with the `m` marks that are
//! counted anyway, this is at least `n`: `m (n - m + 1) - n = (m - 1) (n - m)`. If a request asks
//! about one mark by its id, the other marks are not counted anyway, and the factor is `n`.
//!
//! **Questions.** Each verification has an error probability of its own. Several verifications
//! about one record, each perhaps made after the answer to the one before, are a series. They are
//! counted for a record in two cases. The first is a request that names the record, alone or among
//! at most [`NEARLY`]: with more records, more hypotheses are counted than one name is worth. The
//! second is an answer that names it as a match or as nearly one: an answer that does not name a
//! record reveals nothing about its codeword. The same file, asked about in the same way, is one
//! question however often, because it has one answer.

use std::collections::HashMap;
use std::sync::Arc;

use uuid::Uuid;

use crate::registry::Tally;

/// Most records that a filter selects for each of them to count as named.
pub(super) const NEARLY: usize = 8;

/// The factor on the bound of the `n`-th try of a series, from 1.
pub(super) fn nth(n: u64) -> f64 {
    if n <= 1 {
        return 4.0 / 3.0;
    }
    let n = n as f64;
    // log2(n + 1) - log2(n), without cancellation.
    let step = libm::log1p(1.0 / n) / std::f64::consts::LN_2;
    4.0 * libm::log2(n) * libm::log2(n + 1.0) / step
}

/// What the bound of a record is charged for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) struct Charge {
    /// The number of the try for its host and owner, from 1.
    pub(super) tries: u64,
    /// Marks of its host and owner that are counted with it: itself, and those that this
    /// verification does not count anyway.
    pub(super) siblings: u64,
    /// The number of this question about it, from 1; 0 if questions are not counted.
    pub(super) questions: u64,
}

impl Default for Charge {
    fn default() -> Self {
        Self { tries: 1, siblings: 1, questions: 0 }
    }
}

impl Charge {
    /// The charge of a record. `question` is the number of the question if it is counted; `alone`
    /// says that the request asks about the record by its id.
    pub(in super::super) fn new(tally: &Tally, question: Option<u64>, alone: bool) -> Self {
        let siblings = if alone { tally.siblings } else { tally.revoked_siblings };
        Self {
            tries: tally.refused_before.saturating_add(1),
            siblings: siblings.saturating_add(1),
            questions: question.unwrap_or(0),
        }
    }

    /// The factor on the bound.
    pub(in super::super) fn factor(&self) -> f64 {
        let questions = if self.questions == 0 { 1.0 } else { nth(self.questions) };
        nth(self.tries) * self.siblings as f64 * questions
    }
}

/// Finds the charge of a record when the record is first found; `None` if the charge is not known.
pub(super) type Lookup = Arc<dyn Fn(Uuid) -> Option<Charge> + Send + Sync>;

/// The charges of records: those that are known, and a way to look up others. If the cascade ended
/// at a bound without its charge, the verdict might stay open although later stages could close it.
#[derive(Clone, Default)]
pub(super) struct Charges {
    known: HashMap<Uuid, Charge>,
    lookup: Option<Lookup>,
}

impl Charges {
    /// Looks all charges up with `lookup`. Used on the pool only, because a lookup may wait for the
    /// registry.
    pub(super) fn asking(lookup: Lookup) -> Self {
        Self { known: HashMap::new(), lookup: Some(lookup) }
    }

    /// The charge of a record.
    pub(super) fn of(&mut self, id: Uuid) -> Charge {
        let lookup = &self.lookup;
        let ask = || lookup.as_ref().and_then(|lookup| lookup(id)).unwrap_or_default();
        *self.known.entry(id).or_insert_with(ask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_has_no_more_than_one_try_may() {
        let mut sum = 0.0;
        let mut before = 0.0;
        for n in 1..=2_000_000 {
            let cost = nth(n);
            assert!(cost >= before, "{n}");
            before = cost;
            sum += 1.0 / cost;
        }
        // The rest, for all later tries: the series telescopes.
        let rest = 0.25 / libm::log2(2_000_001.0);
        assert!((sum + rest - 1.0).abs() < 1e-9, "{sum} {rest}");
        assert!(nth(0) >= 1.0 && nth(u64::MAX).is_finite());
        // A client who asks ten times has decades to spare.
        assert!(libm::log10(nth(10)) < 2.6 && libm::log10(nth(100)) < 4.2);
    }

    #[test]
    fn who_registers_many_and_keeps_few_gains_nothing() {
        for n in 1..60_u64 {
            for live in 1..=n {
                let tally =
                    Tally { siblings: n - 1, revoked_siblings: n - live, ..Tally::default() };
                let among = Charge::new(&tally, None, false).factor() / nth(1) * live as f64;
                assert!(among >= n as f64 - 1e-9, "{n} {live}");
                let alone = Charge::new(&tally, None, true).factor() / nth(1);
                assert!((alone - n as f64).abs() < 1e-9, "{n} {live}");
            }
        }
    }

    #[test]
    fn each_record_is_asked_about_once_and_charged_as_usual_where_nobody_knows() {
        let asked = Arc::new(std::sync::atomic::AtomicU64::new(0));
        let counter = asked.clone();
        let known = Uuid::from_u128(7);
        let mut charges = Charges::asking(Arc::new(move |id| {
            counter.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            (id == known).then_some(Charge { questions: 3, ..Charge::default() })
        }));
        for _ in 0..3 {
            assert_eq!(charges.of(known).questions, 3);
            assert_eq!(charges.of(Uuid::nil()), Charge::default());
        }
        assert_eq!(asked.load(std::sync::atomic::Ordering::Relaxed), 2);
        assert_eq!(Charges::default().of(known), Charge::default());
    }
}
