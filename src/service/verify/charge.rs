//! Charges: what the bound of one record is multiplied by because of what was tried before, beside
//! the hypotheses of this verification (`count`).
//!
//! **A series of tries.** Somebody who may try again and again, and stop when he likes, has as many
//! chances to be wrong as he has tries. So the error probability of one is dealt out to all: the
//! n-th has a share, the shares of all, however many, add up to at most 1, and a bound is divided by
//! its share. The first has three quarters; the n-th of the others a quarter of
//! `1 / log2(n) - 1 / log2(n + 1)`, which adds up to that quarter: about `2.8 n log2(n)^2` times, 2.5
//! decades at the tenth, 4.1 at the hundredth. (`n` times alone would not do: the sum of `1 / n` has no
//! end. `n (n + 1)` times would cost as much at the tenth, but twice as many decades far out.)
//!
//! **Refused marks.** A record exists because its codeword could be embedded, perhaps where others
//! could not, at a strength that others of the same codeword could not have: it has been chosen. The
//! n-th that was tried for a host and an owner since their last record is the n-th of a series.
//!
//! **Siblings.** Who registers n marks of a host and revokes all but one has tried n. With `m` of
//! them live, each of these is multiplied by `n - m + 1`, which together with the `m` that are counted
//! anyhow is at least `n`: `m (n - m + 1) - n = (m - 1) (n - m)`. Where one is asked about by its id,
//! the others are not counted anyhow, and it is multiplied by `n`.
//!
//! **Questions.** Each verification has an error probability of its own. So many that are all about
//! one record, each perhaps made after the answer to the one before, are a series. They are counted
//! per record where the request named it (alone or beside at most [`NEARLY`] in all: among more,
//! hypotheses are counted that are not worth as much as one name), and where the answer does, as a match
//! or nearly: from an answer that does not name a record, nobody learns anything about its codeword.
//! The same file asked about in the same way is one question, however often, for it has one answer.

use std::collections::HashMap;
use std::sync::Arc;

use uuid::Uuid;

use crate::registry::Tally;

/// Where a filter selects at most so many records, each is named.
pub(super) const NEARLY: usize = 8;

/// What the `n`-th of a series of tries is multiplied by, from 1.
pub(super) fn nth(n: u64) -> f64 {
    if n <= 1 {
        return 4.0 / 3.0;
    }
    let n = n as f64;
    // log2(n + 1) - log2(n), without cancellation.
    let step = libm::log1p(1.0 / n) / std::f64::consts::LN_2;
    4.0 * libm::log2(n) * libm::log2(n + 1.0) / step
}

/// What a record is charged for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) struct Charge {
    /// Which try it was for its host and owner, from 1.
    pub(super) tries: u64,
    /// Marks of its host and owner that are counted with it: itself, and those that this verification
    /// does not count anyhow.
    pub(super) siblings: u64,
    /// Which question about it this is, from 1; 0 where questions are not counted.
    pub(super) questions: u64,
}

impl Default for Charge {
    fn default() -> Self {
        Self { tries: 1, siblings: 1, questions: 0 }
    }
}

impl Charge {
    /// Of a record, where its `question` is counted; `alone` where it is asked about by its id.
    pub(in super::super) fn new(tally: &Tally, question: Option<u64>, alone: bool) -> Self {
        let siblings = if alone { tally.siblings } else { tally.revoked_siblings };
        Self {
            tries: tally.refused_before.saturating_add(1),
            siblings: siblings.saturating_add(1),
            questions: question.unwrap_or(0),
        }
    }

    /// What the bound is multiplied by.
    pub(in super::super) fn factor(&self) -> f64 {
        let questions = if self.questions == 0 { 1.0 } else { nth(self.questions) };
        nth(self.tries) * self.siblings as f64 * questions
    }
}

/// What a record is charged for, asked when it is first found; `None` where that cannot be told.
pub(super) type Lookup = Arc<dyn Fn(Uuid) -> Option<Charge> + Send + Sync>;

/// The charges of records: those that are known, and a way to ask for others. A detector cascade that
/// ended at a bound without its charge would leave a verdict open that later stages could close.
#[derive(Clone, Default)]
pub(super) struct Charges {
    known: HashMap<Uuid, Charge>,
    lookup: Option<Lookup>,
}

impl Charges {
    /// Asks `lookup` for all records; on the pool only, for it may wait for the registry.
    pub(super) fn asking(lookup: Lookup) -> Self {
        Self { known: HashMap::new(), lookup: Some(lookup) }
    }

    /// What a record is charged for.
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
        // What is left for those after the last: the series telescopes.
        let rest = 0.25 / libm::log2(2_000_001.0);
        assert!((sum + rest - 1.0).abs() < 1e-9, "{sum} {rest}");
        assert!(nth(0) >= 1.0 && nth(u64::MAX).is_finite());
        // A plain client who asks ten times has decades to spare.
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
