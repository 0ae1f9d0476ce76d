//! What a registration may spend, in counted work. Uses no clock, so that a registration ends the
//! same on every machine and on any number of threads.
//!
//! The unit is a *test*: a box or a triangle that a search for a closest point visits. Tests are
//! the inner loop of everything that takes long here. Searches add up their tests, and each round
//! is planned by the tests that are left. Plans depend on sums, never on the order of searches.

use std::sync::atomic::{AtomicU64, Ordering};

use super::prepared::Effort;

/// Tests that may still be made.
#[derive(Debug)]
pub struct Budget {
    all: u64,
    spent: AtomicU64,
}

/// The size of a suspect's budget, over all hosts that the suspect is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allowed {
    /// Tests regardless of sizes.
    pub fixed: u64,
    /// Tests per vertex and triangle of the suspect.
    pub per_suspect: u64,
    /// Tests per vertex and triangle of a host.
    pub per_host: u64,
}

impl Default for Allowed {
    /// A test takes 15 ns, so this is 0.45 s, and 6 us per vertex and triangle: what the law of
    /// `benches/effort.rs` leaves beside the detectors. On usual hosts, all searches together take
    /// 10 to 50 million tests.
    fn default() -> Self {
        Self { fixed: 30_000_000, per_suspect: 400, per_host: 400 }
    }
}

/// Factor of the budget for [`Effort::Thorough`].
const THOROUGHLY: u64 = 10;

impl Allowed {
    /// The usual budget for an effort.
    #[must_use]
    pub fn of(effort: Effort) -> Self {
        let Self { fixed, per_suspect, per_host } = Self::default();
        let times = if effort >= Effort::Thorough { THOROUGHLY } else { 1 };
        Self { fixed: times * fixed, per_suspect: times * per_suspect, per_host: times * per_host }
    }

    /// Budgets for a suspect at hosts, in the order in which they are tried. `suspect` and `hosts`
    /// give vertices and triangles together.
    #[must_use]
    pub fn shares(&self, suspect: u64, hosts: Vec<u64>) -> Shares {
        let common = suspect.saturating_mul(self.per_suspect).saturating_add(self.fixed);
        let own: Vec<u64> =
            hosts.into_iter().map(|host| host.saturating_mul(self.per_host)).collect();
        Shares { common, own, next: 0 }
    }
}

/// The budgets of one suspect for host after host, the likeliest first. Each host gets the tests
/// for its own size and half of the common tests; the last host gets all of them. What a host does
/// not spend goes back to the common tests.
#[derive(Debug)]
pub struct Shares {
    common: u64,
    own: Vec<u64>,
    next: usize,
}

impl Shares {
    /// The budget of the next host.
    pub fn deal(&mut self) -> Budget {
        let own = self.own.get(self.next).copied().unwrap_or(0);
        let is_last = self.next + 1 >= self.own.len();
        let part = if is_last { self.common } else { self.common / 2 };
        self.next += 1;
        self.common -= part;
        Budget::new(part.saturating_add(own))
    }

    /// Takes back what the host did not spend.
    pub fn took(&mut self, budget: &Budget) {
        self.common = self.common.saturating_add(budget.left());
    }
}

impl Budget {
    /// A budget of `tests` tests.
    #[must_use]
    pub fn new(tests: u64) -> Self {
        Self { all: tests, spent: AtomicU64::new(0) }
    }

    /// Counts tests that were made.
    pub fn spend(&self, tests: u64) {
        self.spent.fetch_add(tests, Ordering::Relaxed);
    }

    /// Tests that are left. Call it only while no search runs.
    #[must_use]
    pub fn left(&self) -> u64 {
        self.all.saturating_sub(self.spent())
    }

    /// One of `of` equal shares of what is left.
    #[must_use]
    pub fn share(&self, of: usize) -> u64 {
        self.left() / (of.max(1) as u64)
    }

    /// Tests that were made.
    #[must_use]
    pub fn spent(&self) -> u64 {
        self.spent.load(Ordering::Relaxed)
    }
}

/// The limits of a registration: work, and time where somebody waits.
#[derive(Clone, Copy)]
pub struct WorkLimits<'a> {
    /// Work.
    pub budget: &'a Budget,
    /// Called before each search. Once it returns `true`, searches find nothing.
    pub stop: Stop<'a>,
}

/// Whether to give up.
pub use crate::mesh::stop::Stop;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_spent_is_no_longer_left() {
        let budget = Budget::new(320);
        budget.spend(20);
        assert_eq!((budget.left(), budget.share(3), budget.share(0)), (300, 100, 300));
        budget.spend(1000);
        assert_eq!((budget.left(), budget.spent()), (0, 1020));
    }

    #[test]
    fn hosts_have_what_their_size_is_worth_and_what_others_leave() {
        let allowed = Allowed { fixed: 10, per_suspect: 2, per_host: 3 };
        let mut shares = allowed.shares(10, vec![100, 1, 7]);
        let first = shares.deal();
        assert_eq!(first.left(), 15 + 300);
        first.spend(10);
        shares.took(&first);
        // 15 common tests, and 305 that the first host left.
        let second = shares.deal();
        assert_eq!(second.left(), 160 + 3);
        second.spend(1000);
        shares.took(&second);
        assert_eq!(shares.deal().left(), 160 + 21);
        // Sums saturate, whatever the sizes.
        let mut shares = allowed.shares(u64::MAX, vec![u64::MAX; 2]);
        assert_eq!((shares.deal().left(), shares.deal().left()), (u64::MAX, u64::MAX));
    }
}
