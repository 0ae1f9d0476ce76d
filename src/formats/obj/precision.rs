//! How a moved coordinate is rounded and spelled.
//!
//! A marked file should look as if its exporter had written it: each coordinate with as many
//! decimals as in the host, and with more only where the mark needs them. The number of decimals
//! follows from the coordinate's value, so that copies of one vertex stay together however they are
//! spelled. It is the number that represents the value exactly, and not fewer than every coordinate
//! of the file has. Numbers and text follow the same rule, so that what was checked before writing
//! is what will be read.

use std::io::Write as _;

/// 10^0 to 10^22: the powers of ten that a double holds exactly.
pub(super) const POWERS_OF_TEN: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// The finest step, a share of the bounding-box diagonal. It is far below what a mark moves (about
/// 1e-4) and what an eye sees.
const FINEST_STEP: f64 = 1e-7;

/// More decimals than this say nothing about a double near 1, so they are not imitated.
const MOST_DECIMALS: usize = 15;

/// Below this many steps, rounding twice is the same as rounding once: dividing and multiplying
/// again is off by less than `steps * 2^-52`, a quarter of a step here. Up to 2^53 the text would
/// still be exact, but rounding a rounded value could move it again.
const MOST_STEPS: f64 = (1_u64 << 50) as f64;

/// Longest fixed-point text without its sign: a zero, the point and 22 decimals. (2^50 steps are
/// 16 digits.)
const LONGEST: usize = 24;

/// The fewest decimals of moved coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Precision {
    fewest: usize,
}

impl Precision {
    /// As many decimals as every coordinate of the host has (`fewest_of_host`), and enough for steps
    /// of `step` on a mesh of this bounding-box diagonal.
    pub(super) fn choose(fewest_of_host: usize, step: f64, diagonal: f64) -> Self {
        let step = step.max(FINEST_STEP * diagonal);
        let needed = POWERS_OF_TEN.iter().position(|power| 1.0 / power <= step);
        // A point has no diagonal; a mesh of 1e-20 has one, but no fixed-point spelling.
        let beyond = if diagonal > 0.0 { POWERS_OF_TEN.len() } else { 0 };
        Self { fewest: fewest_of_host.min(MOST_DECIMALS).max(needed.unwrap_or(beyond)) }
    }

    /// The spelling of a moved coordinate that is `host` in the host.
    pub(super) fn of(self, host: f64) -> Spelling {
        let mut spelling = Spelling { decimals: self.fewest };
        for decimals in self.fewest..=MOST_DECIMALS {
            let longer = Spelling { decimals };
            // Where fixed point ends, the last spelling within its reach is used.
            let Some((steps, power)) = longer.steps(host) else { break };
            spelling = longer;
            // Adding zero turns -0 into 0.
            if (steps as f64 / power).to_bits() == (host + 0.0).to_bits() {
                break;
            }
        }
        spelling
    }
}

/// How a coordinate is spelled: its number of decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Spelling {
    decimals: usize,
}

impl Spelling {
    /// The value that [`Spelling::spell`] reads back as.
    pub(super) fn round(self, x: f64) -> f64 {
        match self.steps(x) {
            // Two exact doubles: their quotient is the double nearest to the decimal fraction,
            // which is what every correct parser makes of the text.
            Some((steps, power)) => steps as f64 / power,
            // Adding zero turns -0 into 0.
            None => x + 0.0,
        }
    }

    /// Appends the text of a finite `x` with exactly the chosen decimals. For values beyond the
    /// reach of fixed point, this is the shortest text that reads back as `x`. There is never an
    /// exponent, which some OBJ readers do not know.
    pub(super) fn spell(self, x: f64, out: &mut Vec<u8>) {
        match self.steps(x) {
            Some((steps, _)) => spell_fixed(steps, self.decimals, out),
            // Writing to a vector cannot fail.
            None => _ = write!(out, "{}", x + 0.0),
        }
    }

    /// `x` in steps of `10^-decimals`, and the number of steps in 1; `None` beyond the reach of
    /// fixed point.
    fn steps(self, x: f64) -> Option<(i64, f64)> {
        let power = *POWERS_OF_TEN.get(self.decimals)?;
        let steps = (x * power).round();
        if steps.is_nan() || steps.abs() >= MOST_STEPS {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "a whole number below 2^50")]
        let steps = steps as i64;
        Some((steps, power))
    }
}

fn spell_fixed(steps: i64, decimals: usize, out: &mut Vec<u8>) {
    let mut text = [b'0'; LONGEST];
    let mut left = steps.unsigned_abs();
    let mut written = 0;
    // One digit stands before the point, even if it is a zero.
    let least = if decimals == 0 { 1 } else { decimals + 2 };
    for slot in text.iter_mut().rev() {
        if written >= least && left == 0 {
            break;
        }
        if decimals > 0 && written == decimals {
            *slot = b'.';
        } else {
            *slot = b'0' + u8::try_from(left % 10).unwrap_or(0);
            left /= 10;
        }
        written += 1;
    }
    if steps < 0 {
        out.push(b'-');
    }
    out.extend_from_slice(text.get(LONGEST - written..).unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn spell(decimals: usize, x: f64) -> String {
        let mut text = Vec::new();
        Spelling { decimals }.spell(x, &mut text);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn spelling() {
        let table = [
            (6, 0.5, "0.500000"),
            (6, -0.5, "-0.500000"),
            (6, -0.000_000_1, "0.000000"),
            (6, -0.0, "0.000000"),
            (6, 12.345_678_9, "12.345679"),
            (3, 1234.5, "1234.500"),
            (1, 10.0, "10.0"),
            (1, 9.96, "10.0"),
            (0, 1204.4, "1204"),
            (0, -7.0, "-7"),
            (0, 0.2, "0"),
            (22, 1e-9, "0.0000000010000000000000"),
            (6, 1e15, "1000000000000000"),
            (6, -1.5e300, &(String::from("-15") + &"0".repeat(299))),
            (23, 1.5e-25, "0.00000000000000000000000015"),
            (23, -0.0, "0"),
        ];
        for (decimals, x, expected) in table {
            assert_eq!(spell(decimals, x), expected);
        }
    }

    #[test]
    fn decimals_follow_the_mark_and_the_size_of_the_mesh() {
        let table = [
            // Fewest decimals of the host, step, diagonal, and the decimals that are chosen.
            (6, 0.0, 0.25, 8),
            (6, 0.0, 1.0, 7),
            (6, 0.0, 10.0, 6),
            (6, 2e-6, 1.0, 6),
            (6, 1e-6, 1.0, 6),
            (6, 9e-7, 1.0, 7),
            (0, 2e-6, 1.0, 6),
            (6, 1e-3, 1.0, 6),
            (9, 0.0, 10.0, 9),
            (20, 0.0, 10.0, MOST_DECIMALS),
            (2, 0.0, 1e7, 2),
            (0, 0.0, 1e7, 0),
            (0, 0.0, 1e300, 0),
            (0, 0.0, f64::INFINITY, 0),
            (3, 0.0, 0.0, 3),
            (3, 0.0, 1e-15, 22),
            (3, 0.0, 1e-30, 23),
        ];
        for (of_host, step, diagonal, fewest) in table {
            let chosen = Precision::choose(of_host, step, diagonal);
            assert_eq!(chosen, Precision { fewest }, "{of_host} {step} {diagonal}");
        }
    }

    #[test]
    fn a_coordinate_keeps_its_decimals() {
        let table = [
            (4, 0.5, 4),
            (4, 0.123_456, 6),
            (4, -0.123_456_78, 8),
            (4, 1_234.123_456, 6),
            (6, 0.1, 6),
            (0, 7.0, 0),
            (0, -0.0, 0),
            // More decimals than are imitated, more than fixed point reaches, more than either.
            (4, 0.123_456_789_012_345_67, MOST_DECIMALS),
            (4, 12_345.678_901_234_567, 10),
            (4, 1.0e15, 4),
            (22, 1e-20, 22),
        ];
        for (fewest, host, decimals) in table {
            assert_eq!(Precision { fewest }.of(host), Spelling { decimals }, "{fewest} {host}");
        }
    }

    fn any_finite() -> impl Strategy<Value = f64> {
        prop_oneof![
            -10.0..10.0_f64,
            -1e6..1e6_f64,
            -1e-6..1e-6_f64,
            (-2e15..2e15_f64),
            any::<f64>().prop_filter("finite", |x| x.is_finite()),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn text_reads_back_as_the_rounded_value(x in any_finite(), decimals in 0..24_usize) {
            let precision = Spelling { decimals };
            let rounded = precision.round(x);
            let text = spell(decimals, x);
            prop_assert_eq!(text.parse::<f64>().unwrap().to_bits(), rounded.to_bits());
            let fast: f64 = fast_float2::parse(&text).unwrap();
            prop_assert_eq!(fast.to_bits(), rounded.to_bits());
            prop_assert!(!text.contains(['e', 'E', '+']));
            prop_assert!(rounded != 0.0 || !text.starts_with('-'));
            if precision.steps(x).is_some() {
                prop_assert_eq!(text.split_once('.').map_or(0, |(_, after)| after.len()), decimals);
                // Half a step, and the rounding of the product and the quotient.
                prop_assert!((rounded - x).abs() <= 0.5 / POWERS_OF_TEN[decimals]
                    + x.abs() * f64::EPSILON);
            }
        }

        /// A coordinate gets no more decimals than it was written with, unless the mark needs them.
        #[test]
        fn no_more_decimals_than_the_host_s(
            digits in -999_999_999_999_i64..999_999_999_999,
            decimals in 0..15_usize,
            fewest in 0..15_usize,
        ) {
            let host = digits as f64 / POWERS_OF_TEN[decimals];
            let spelling = Precision { fewest }.of(host);
            prop_assert!(spelling.decimals <= decimals.max(fewest));
        }

        #[test]
        fn rounding_twice_is_rounding_once(x in any_finite(), decimals in 0..24_usize) {
            let precision = Spelling { decimals };
            let once = precision.round(x);
            prop_assert_eq!(precision.round(once).to_bits(), once.to_bits());
        }
    }
}
