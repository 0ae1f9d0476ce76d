//! The rows of the acceptance table of detection.

use std::collections::BTreeMap;

use quadmark::lab::sequential::{Decision, Sequential};

/// The sequential test distinguishes shares that differ by this, with at most this probability of
/// either error.
const TOLERANCE: f64 = 0.15;
const ERROR: f64 = 0.05;

/// One judgement: whether one record was named that must be named.
#[derive(Debug, Clone)]
pub struct Outcome {
    pub right: bool,
    /// Number of records that were named and must not be.
    pub wrong: u32,
    /// The bound of the right record, if it was reported at all.
    pub log10_fp: Option<f64>,
    /// The stage that decided.
    pub stage: &'static str,
    /// Share of the bits that the blind reader reads right.
    pub blind: Option<f64>,
}

/// How often one mesh was recognised under one attack.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    right: u32,
    wrong: u32,
    none: u32,
}

/// The outcomes of one attack.
pub struct Row {
    cells: BTreeMap<usize, Cell>,
    failed: u32,
    bounds: Vec<f64>,
    blind: Vec<f64>,
    stages: BTreeMap<&'static str, u32>,
    test: Option<Sequential>,
    wanted: Option<f64>,
}

impl Row {
    pub fn new(wanted: Option<f64>) -> Self {
        Self {
            cells: BTreeMap::new(),
            failed: 0,
            bounds: Vec::new(),
            blind: Vec::new(),
            stages: BTreeMap::new(),
            test: wanted.map(|wanted| Sequential::new(wanted, TOLERANCE, ERROR)),
            wanted,
        }
    }

    pub fn add(&mut self, mesh: usize, outcome: &Outcome) {
        let cell = self.cells.entry(mesh).or_default();
        cell.right += u32::from(outcome.right);
        cell.wrong += outcome.wrong;
        cell.none += u32::from(!outcome.right);
        self.bounds.extend(outcome.log10_fp);
        self.blind.extend(outcome.blind);
        if outcome.right {
            *self.stages.entry(outcome.stage).or_default() += 1;
        }
        if let Some(test) = &mut self.test {
            test.add(outcome.right);
        }
    }

    /// The attack left no mesh.
    pub fn fail(&mut self) {
        self.failed += 1;
    }

    /// Whether the sequential test is decided, so that more trials would change nothing.
    pub fn is_plain(&self) -> bool {
        self.test.is_some_and(|test| test.decision() != Decision::Open)
    }

    pub fn wrong(&self) -> u32 {
        self.cells.values().map(|cell| cell.wrong).sum()
    }

    /// A line of Markdown: right / wrong / none per mesh, then all of them.
    pub fn print(&self, name: &str, meshes: usize) {
        let cell = |mesh: usize| match self.cells.get(&mesh) {
            Some(cell) => format!("{} / {} / {}", cell.right, cell.wrong, cell.none),
            None => "-".to_owned(),
        };
        let each: Vec<String> = (0..meshes).map(cell).collect();
        let right: u32 = self.cells.values().map(|cell| cell.right).sum();
        let none: u32 = self.cells.values().map(|cell| cell.none).sum();
        let decision = match (self.wanted, self.test.map(|test| test.decision())) {
            (Some(wanted), Some(Decision::Met)) => format!("{wanted}: met"),
            (Some(wanted), Some(Decision::Missed)) => format!("{wanted}: MISSED"),
            (Some(wanted), _) => format!("{wanted}: open"),
            (None, _) => String::new(),
        };
        let mean = |of: &[f64], digits: usize, unit: f64| {
            let mean = unit * of.iter().sum::<f64>() / of.len() as f64;
            if of.is_empty() { "-".to_owned() } else { format!("{mean:.digits$}") }
        };
        let stages = self.stages.iter().map(|(stage, count)| format!("{stage} {count}"));
        let failed = (self.failed > 0).then(|| format!("no mesh {}", self.failed));
        println!(
            "| {name} | {} | {right} of {} | {decision} | {} | {} | {} |",
            each.join(" | "),
            right + none,
            mean(&self.bounds, 1, 1.0),
            mean(&self.blind, 0, 100.0),
            stages.chain(failed).collect::<Vec<_>>().join(", "),
        );
    }
}

/// The head of the table, with a column per mesh.
pub fn print_head(meshes: &[&str]) {
    println!(
        "\n| attack | {} | right | wanted | log10 of the bound | blind bits, % | decided by |",
        meshes.join(" | ")
    );
    println!("|{}", "---|".repeat(meshes.len() + 6));
}
