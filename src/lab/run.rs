//! All trials of a grid, on all cores.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, OnceLock};

use super::grid::Experiment;
use super::measures;
use super::queue::in_order;
use super::row::Row;
use super::trial::Trial;
use crate::formats::{Asset, FormatError, Limits};
use crate::mesh::distortion::Measured;
use crate::mesh::surface::Surface;
use crate::recognition::HostModel;

/// A host file.
pub struct Subject {
    /// Its name in rows.
    pub name: String,
    /// The file.
    pub bytes: Vec<u8>,
    /// The same, parsed.
    pub asset: Asset,
    /// Its welded surface.
    pub surface: Surface,
    measured: OnceLock<Option<Measured>>,
    host_model: OnceLock<HostModel>,
}

impl Subject {
    /// Reads a file.
    ///
    /// # Errors
    /// [`FormatError`].
    pub fn read(name: String, bytes: Vec<u8>, limits: &Limits) -> Result<Self, FormatError> {
        let asset = Asset::read(&bytes, limits)?;
        let surface = Surface::new(asset.mesh());
        Ok(Self {
            name,
            bytes,
            asset,
            surface,
            measured: OnceLock::new(),
            host_model: OnceLock::new(),
        })
    }

    /// Its surface, prepared for measuring attacked meshes against it. It is prepared at first use,
    /// in parallel. Other workers wait, each in its own pool.
    pub(super) fn measured(&self) -> Option<&Measured> {
        self.measured.get_or_init(|| measures::measured(&self.surface)).as_ref()
    }

    /// The host model, prepared likewise.
    pub(super) fn host_model(&self) -> &HostModel {
        self.host_model.get_or_init(|| HostModel::new(self.asset.mesh().clone()))
    }
}

/// What is run.
#[derive(Clone, Copy)]
pub struct Plan<'a> {
    /// The hosts.
    pub subjects: &'a [Subject],
    /// Marks and attacks.
    pub experiments: &'a [Experiment],
    /// Trials per host and mark.
    pub trials: usize,
    /// Seed of keys, messages and attacks.
    pub seed: u64,
    /// Families of attacks that are made; empty for all. A result does not depend on what else is
    /// run.
    pub families: &'a [String],
    /// Rows of earlier runs. Their results are not made again.
    pub known: &'a [Row],
}

/// For each mark and trial, the attacks that have rows.
type Known<'a> = BTreeMap<(String, usize), BTreeSet<&'a str>>;

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Trials done.
    pub done: usize,
    /// Trials in all.
    pub trials: usize,
    /// Share of the work that is done, between 0 and 1, by vertices and attacks.
    pub share: f64,
}

/// How a run is watched and ended.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Called between attacks; `true` ends the run with the trials that are done.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called after each trial.
    pub progress: &'a (dyn Fn(Progress) + Sync),
    /// Called with the rows of each trial as soon as it is done, in any order.
    pub kept: &'a (dyn Fn(&[Row]) + Sync),
}

/// Rough cost of making a mark, in attacks, for the estimate of the time left.
const COST_OF_MARK: f64 = 4.0;

/// Rough cost of measuring the distance of an attacked mesh, likewise.
const COST_OF_DAMAGE: f64 = 3.0;

impl Plan<'_> {
    /// All trials. The first trial of each mark comes before any second one, so that a run that is
    /// ended early has some trials of each.
    #[must_use]
    pub fn all(&self) -> Vec<Trial<'_>> {
        let mut all = Vec::new();
        for trial in 0..self.trials {
            for experiment in self.experiments {
                for (number, subject) in self.subjects.iter().enumerate() {
                    if experiment.first_mesh_only && number > 0 {
                        break;
                    }
                    let attacks = experiment.attacks.as_slice();
                    all.extend(experiment.settings.iter().enumerate().map(|(k, &setting)| Trial {
                        experiment: experiment.name,
                        subject,
                        number,
                        setting,
                        attacks,
                        families: self.families,
                        trial,
                        seed: self.seed,
                        known: None,
                        damage: trial == 0 && k == 0,
                    }));
                }
            }
        }
        all
    }

    /// Those of [`Plan::all`] with attacks that are not known yet.
    fn open<'a>(&'a self, known: &'a Known<'a>) -> Vec<Trial<'a>> {
        let mut all = self.all();
        all.retain_mut(|trial| {
            let Some(first) = trial.attacks.first() else { return false };
            trial.known = known.get(&(trial.blank(*first).mark(), trial.trial));
            trial.met().next().is_some()
        });
        all
    }

    /// Rows of several runs in the order of [`Plan::all`]. Rows of other plans keep their order, at
    /// the end. So a run in parts gives the rows in the order of a run at once.
    #[must_use]
    pub fn in_order(&self, mut rows: Vec<Row>) -> Vec<Row> {
        let mut places = BTreeMap::new();
        let one_each = Plan { trials: 1, ..*self };
        for trial in one_each.all() {
            for attack in trial.attacks {
                let row = trial.blank(*attack);
                let next = places.len();
                places.entry((row.mark(), row.attack)).or_insert(next);
            }
        }
        let place = |row: &Row| match places.get(&(row.mark(), row.attack.clone())) {
            Some(&place) => (false, row.trial, place),
            None => (true, 0, 0),
        };
        rows.sort_by_cached_key(place);
        rows
    }

    /// Runs the trials that are not known, and gives the rows of the trials that were done, in the
    /// order of [`Plan::all`] whatever the number of threads.
    #[must_use]
    pub fn run(&self, watch: Watch<'_>) -> Vec<Row> {
        let mut known = Known::new();
        for row in self.known {
            known.entry((row.mark(), row.trial)).or_default().insert(&row.attack);
        }
        let all = self.open(&known);
        let total: f64 = all.iter().map(cost).sum();
        let passed = Mutex::new((0, 0.0));
        let tell = |trial: &Trial<'_>, rows: &[Row]| {
            (watch.kept)(rows);
            if let Ok(mut passed) = passed.lock() {
                passed.0 += 1;
                passed.1 += cost(trial);
                let (done, share) = (passed.0, passed.1 / total);
                (watch.progress)(Progress { done, trials: all.len(), share });
            }
        };
        let budgets = by_budget(&all);
        let made: Vec<Vec<(usize, Vec<Row>)>> = in_order(budgets.len(), |number| {
            let mut made: Vec<(usize, Vec<Row>)> = Vec::new();
            for &place in &budgets[number] {
                let trial = &all[place];
                let same = made.last().and_then(|(_, rows)| trial.of_larger_budget(rows));
                let run = || if (watch.stop)() { None } else { trial.run(watch.stop) };
                let Some(rows) = same.or_else(run) else { break };
                tell(trial, &rows);
                made.push((place, rows));
            }
            made
        });
        let mut rows: Vec<(usize, Vec<Row>)> = made.into_iter().flatten().collect();
        rows.sort_unstable_by_key(|(place, _)| *place);
        rows.into_iter().flat_map(|(_, rows)| rows).collect()
    }
}

/// Rough cost of a trial.
fn cost(trial: &Trial<'_>) -> f64 {
    let vertices = trial.subject.asset.mesh().positions().len();
    let attack = if trial.damage { 1.0 + COST_OF_DAMAGE } else { 1.0 };
    vertices as f64 * (COST_OF_MARK + attack * trial.met().count() as f64)
}

/// Indices of the trials. Trials that differ only in their budgets are grouped, the largest budget
/// first: often its mark is also that of the smaller budgets.
fn by_budget(all: &[Trial<'_>]) -> Vec<Vec<usize>> {
    let mut places: BTreeMap<(usize, String), usize> = BTreeMap::new();
    let mut together: Vec<Vec<usize>> = Vec::new();
    for (place, trial) in all.iter().enumerate() {
        let kind = trial.but_for_budget().unwrap_or_else(|| format!("{place}"));
        let slot = *places.entry((trial.trial, kind)).or_insert(together.len());
        match together.get_mut(slot) {
            Some(others) => others.push(place),
            None => together.push(vec![place]),
        }
    }
    let budget = |&place: &usize| all[place].setting.budget.unwrap_or_default();
    for places in &mut together {
        places.sort_by(|a, b| budget(b).total_cmp(&budget(a)));
    }
    together
}
