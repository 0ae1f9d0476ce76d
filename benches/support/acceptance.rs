//! The rows of the acceptance table of detection.

use std::collections::BTreeMap;

use quadmark::lab::measures::Detection;
use quadmark::service::{Verdict, Verification};
use uuid::Uuid;

/// One suspect's outcome.
pub struct Outcome {
    pub verification: Verification,
    /// Seconds from handing the file in to the answer, over those that tobj takes to load it, if
    /// measured.
    pub ratio: Option<f64>,
    /// What the paper's detector reads of the mark, if it reads at all.
    pub paper: Option<Detection>,
    /// The record that should be found; none for a file that carries no mark.
    pub expected: Option<Uuid>,
}

impl Outcome {
    /// A match that names a record which the file does not carry.
    pub fn is_wrong(&self) -> bool {
        let named = self.verification.matches.first().map(|best| best.watermark_id);
        self.verification.verdict == Verdict::Match && named != self.expected
    }

    /// The mark found, or nothing where there is nothing.
    pub fn is_right(&self) -> bool {
        let found = self.verification.verdict == Verdict::Match;
        found == self.expected.is_some() && !self.is_wrong()
    }
}

/// Sums over the trials of an attack.
#[derive(Default)]
pub struct Row {
    trials: u32,
    right: u32,
    wrong: u32,
    inconclusive: u32,
    failed: u32,
    log10_fp: Vec<f64>,
    stages: BTreeMap<&'static str, u32>,
    ratios: Vec<f64>,
    bits: Vec<f64>,
}

impl Row {
    pub fn add(&mut self, outcome: &Outcome) {
        let Outcome { verification, ratio, paper, expected } = outcome;
        self.trials += 1;
        self.right += u32::from(outcome.is_right());
        self.wrong += u32::from(outcome.is_wrong());
        self.inconclusive += u32::from(verification.verdict == Verdict::Inconclusive);
        self.ratios.extend(*ratio);
        let theirs = verification.matches.iter().find(|m| Some(m.watermark_id) == *expected);
        self.log10_fp.extend(theirs.map(|found| found.log10_fp));
        if verification.verdict == Verdict::Match {
            let stage = verification.matches[0].how.as_ref().map_or("-", |how| how.stage.name());
            *self.stages.entry(stage).or_default() += 1;
        }
        let bits = |d: &Detection| d.right as f64 / (d.right + d.wrong + d.erased) as f64;
        self.bits.push(paper.as_ref().map_or(0.0, bits));
    }

    /// The attack left no mesh.
    pub fn fail(&mut self) {
        self.failed += 1;
    }

    pub fn wrong(&self) -> u32 {
        self.wrong
    }

    pub fn print(&self, name: &str) {
        let noted =
            [("unclear", self.inconclusive), ("WRONG", self.wrong), ("failed", self.failed)];
        let stages = self.stages.iter().map(|(&stage, &count)| (stage, count));
        let counts: Vec<String> = stages
            .chain(noted.into_iter().filter(|&(_, count)| count > 0))
            .map(|(what, count)| format!("{what} {count}"))
            .collect();
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
        let or_dash = |of: &[f64], digits: usize, unit: f64| {
            if of.is_empty() { "-".to_owned() } else { format!("{:.digits$}", unit * mean(of)) }
        };
        println!(
            "{name:26}{:3} /{:3}{:>9}{:>9}{:>8}  {}",
            self.right,
            self.trials,
            or_dash(&self.log10_fp, 1, 1.0),
            or_dash(&self.ratios, 1, 1.0),
            or_dash(&self.bits, 1, 100.0),
            counts.join(", "),
        );
    }
}

pub fn print_head() {
    println!(
        "{:26}{:>8}{:>9}{:>9}{:>8}  decided by",
        "attack", "right", "log10_fp", "x tobj", "bits %"
    );
}
