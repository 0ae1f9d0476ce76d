//! When trials may stop: Wald's sequential test of a share.

/// Wald's sequential probability ratio test (*Sequential tests of statistical hypotheses*, Annals of
/// Mathematical Statistics 16(2), 1945) of "the share of successes is `wanted`" against "it is
/// `tolerance` less", with the same probability of either error. After each outcome the logarithm of
/// the likelihood ratio is compared with `+/- ln((1 - error) / error)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sequential {
    success: f64,
    failure: f64,
    limit: f64,
    ratio: f64,
}

/// What the outcomes so far say of the share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// It is the requested one.
    Met,
    /// It is less.
    Missed,
    /// Not yet decided.
    Open,
}

/// Largest share that is tested. A share of 1 would be missed at the first failure.
const MOST: f64 = 0.99;

impl Sequential {
    /// A test between shares that differ by `tolerance`, which errs with a probability of at most
    /// about `error`.
    #[must_use]
    pub fn new(wanted: f64, tolerance: f64, error: f64) -> Self {
        let good = wanted.clamp(0.02, MOST);
        let bad = (good - tolerance).clamp(0.01, good);
        Self {
            success: libm::log(good / bad),
            failure: libm::log((1.0 - good) / (1.0 - bad)),
            limit: libm::log((1.0 - error) / error),
            ratio: 0.0,
        }
    }

    /// Adds an outcome. A decision that was made stays.
    pub fn add(&mut self, success: bool) {
        if self.decision() == Decision::Open {
            self.ratio += if success { self.success } else { self.failure };
        }
    }

    /// The decision so far.
    #[must_use]
    pub fn decision(&self) -> Decision {
        if self.ratio >= self.limit {
            Decision::Met
        } else if self.ratio <= -self.limit {
            Decision::Missed
        } else {
            Decision::Open
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attacks::random::Random;

    /// Share of runs that end in `Met`, and the mean number of outcomes.
    fn met(share: f64, test: Sequential) -> (f64, f64) {
        let mut random = Random::new(5);
        let (mut met, mut outcomes) = (0.0, 0.0);
        for _ in 0..2000 {
            let mut test = test;
            while test.decision() == Decision::Open {
                test.add(random.share() < share);
                outcomes += 1.0;
            }
            met += if test.decision() == Decision::Met { 1.0 } else { 0.0 };
        }
        (met / 2000.0, outcomes / 2000.0)
    }

    #[test]
    fn it_errs_no_more_often_than_stated() {
        for wanted in [0.99, 0.95, 0.6] {
            let test = Sequential::new(wanted, 0.15, 0.05);
            let (good, few) = met(wanted, test);
            let (bad, _) = met(wanted - 0.15, test);
            assert!(good > 0.94 && bad < 0.06, "{wanted}: {good} {bad}");
            assert!(few < 80.0, "{wanted}: {few}");
        }
    }

    #[test]
    fn what_is_plain_is_decided_early_and_stays() {
        let mut test = Sequential::new(1.0, 0.15, 0.05);
        let mut count = 0;
        while test.decision() == Decision::Open {
            test.add(true);
            count += 1;
        }
        assert_eq!(count, 18);
        for _ in 0..100 {
            test.add(false);
        }
        assert_eq!(test.decision(), Decision::Met);
        let mut test = Sequential::new(1.0, 0.15, 0.05);
        test.add(false);
        assert_eq!(test.decision(), Decision::Open);
        test.add(false);
        assert_eq!(test.decision(), Decision::Missed);
    }
}
