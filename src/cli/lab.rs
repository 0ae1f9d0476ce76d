//! `quadmark lab`.

use std::fs::{File, OpenOptions};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use quadmark::attacks::Attack;
use quadmark::lab::grid::{Choices, Experiment, Grid};
use quadmark::lab::report::{Report, galleries};
use quadmark::lab::row::{Journal, Row, from_csv, merged, to_csv};
use quadmark::lab::run::{Plan, Progress, Subject, Watch};
use quadmark::lab::summary::groups;
use quadmark::watermark::{BitCount, Method, Strength};
use serde_json::json;

use super::{Failure, Outcome, files, limits, names};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The host files (OBJ, GLB or glTF).
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Folder for results.csv, summary.json, report.html, and the report's tables and figures as
    /// files; created if it is missing.
    #[arg(long)]
    out: PathBuf,
    /// The grid of marks and attacks: quick, paper (the tables and figures of Luo and Bors 2009) or
    /// liris (the LIRIS benchmark).
    #[arg(long, default_value_t)]
    grid: Grid,
    /// Methods, separated by commas, instead of the grid's.
    #[arg(long, value_delimiter = ',', value_parser = super::parse_method)]
    methods: Vec<Method>,
    /// Strengths, separated by commas, instead of the grid's.
    #[arg(long, value_delimiter = ',', value_parser = super::parse_strength)]
    strengths: Vec<Strength>,
    /// Numbers of bits, separated by commas, instead of the grid's.
    #[arg(long, value_delimiter = ',', value_parser = super::parse_bits)]
    bits: Vec<BitCount>,
    /// Experiments of the grid, by a part of their names, instead of all.
    #[arg(long)]
    experiments: Vec<String>,
    /// Families of attacks, separated by commas, instead of all (`none` is the mark without an
    /// attack).
    #[arg(long, value_delimiter = ',')]
    attacks: Vec<String>,
    /// results.csv of an earlier run with this seed and these files in this order, or
    /// unfinished.csv, which a killed run leaves. Its rows are reported together with those of this
    /// run, and are not made again, so that a run that was ended can go on. May be repeated.
    #[arg(long)]
    rows: Vec<PathBuf>,
    /// Marks per mesh and setting, each with a random key and message. The default is the grid's
    /// own number: paper 50, liris 5, quick 10.
    #[arg(long)]
    trials: Option<usize>,
    /// Seed of keys, messages and attacks: the same seed gives the same rows.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The bound below which a trial counts as a match, as a decimal logarithm.
    #[arg(long, default_value_t = -9.0, allow_negative_numbers = true)]
    threshold_log10: f64,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let experiments = experiments(arguments)?;
    let subjects = subjects(&arguments.files)?;
    let rows = known_rows(&arguments.rows)?;
    let plan = Plan {
        subjects: &subjects,
        experiments: &experiments,
        trials: arguments.trials.unwrap_or_else(|| arguments.grid.trials()),
        seed: arguments.seed,
        families: &arguments.attacks,
        known: &rows,
    };
    plan.check_known()?;
    std::fs::create_dir_all(&arguments.out)?;
    let kept = Kept::begin(arguments.out.join("unfinished.csv"), &arguments.rows, &rows)?;
    let stopped = stop_on_ctrl_c()?;
    let meter = Meter::new();
    let watch = Watch {
        stop: &|| stopped.load(Ordering::Relaxed),
        progress: &|progress| meter.show(progress),
        kept: &|rows| kept.add(rows),
    };
    let new = plan.run(watch);
    let rows = plan.in_order(merged([rows.as_slice(), &new].concat()));
    meter.end();

    let groups = groups(&rows, arguments.threshold_log10);
    let trials = groups.iter().map(|g| g.trials + g.failed).max().unwrap_or_default();
    let complete = || !stopped.load(Ordering::Relaxed);
    let summary = json!({
        "quadmark": env!("CARGO_PKG_VERSION"),
        "grid": arguments.grid.name(),
        "trials": trials,
        "seed": arguments.seed,
        "threshold_log10": arguments.threshold_log10,
        "complete": complete(),
        "groups": groups,
    });
    let out = |name: &str| arguments.out.join(name);
    // Written before the figures are drawn, which takes long for large meshes.
    files::write(&out("results.csv"), &to_csv(&rows)?)?;
    kept.end();
    files::write(&out("summary.json"), &serde_json::to_vec_pretty(&summary)?)?;
    eprintln!("drawing");
    let complete = complete();
    let galleries = galleries(&plan, watch.stop);
    let report = Report {
        grid: arguments.grid,
        trials,
        seed: plan.seed,
        threshold: arguments.threshold_log10,
        complete,
        groups: &groups,
        galleries: &galleries,
    };
    files::write(&out("report.html"), report.html().as_bytes())?;
    files::write(&out("tables.md"), report.markdown().as_bytes())?;
    for figure in report.figures() {
        files::write(&out(&format!("{}.svg", figure.name)), figure.plot.svg().as_bytes())?;
    }
    eprintln!("{} rows in {}", rows.len(), arguments.out.display());
    Ok(ExitCode::SUCCESS)
}

/// The experiments that are requested, each with all its attacks: the random numbers of an attack
/// depend on its position among them.
///
/// # Errors
/// When a name matches nothing: a run without it would look like one with it.
fn experiments(arguments: &Arguments) -> Result<Vec<Experiment>, Failure> {
    let choices = Choices {
        methods: arguments.methods.clone(),
        strengths: arguments.strengths.clone(),
        bits: arguments.bits.clone(),
    };
    let (grid, wanted) = (arguments.grid.name(), &arguments.experiments);
    let mut experiments = arguments.grid.experiments(&choices);
    let names: Vec<&str> = experiments.iter().map(|e| e.name).collect();
    if let Some(part) = wanted.iter().find(|part| !names.iter().any(|n| n.contains(part.as_str())))
    {
        let names = names.join(", ");
        return Err(Failure(format!(
            "no experiment of the {grid} grid is called {part}; there are: {names}"
        )));
    }
    experiments.retain(|e| wanted.is_empty() || wanted.iter().any(|part| e.name.contains(part)));
    let mut families: Vec<&str> =
        experiments.iter().flat_map(|e| &e.attacks).map(Attack::family).collect();
    families.sort_unstable();
    families.dedup();
    match arguments.attacks.iter().find(|family| !families.contains(&family.as_str())) {
        Some(family) => {
            let families = families.join(", ");
            Err(Failure(format!(
                "no attack of the {grid} grid is called {family}; there are: {families}"
            )))
        }
        None => Ok(experiments),
    }
}

/// The hosts.
fn subjects(paths: &[PathBuf]) -> Result<Vec<Subject>, Failure> {
    let read = |(path, name): (&PathBuf, String)| {
        Subject::read(name, files::read(path)?, &limits())
            .map_err(|error| Failure(format!("{}: {error}", path.display())))
    };
    paths.iter().zip(names::of(paths)?).map(read).collect()
}

/// The rows of earlier runs.
fn known_rows(paths: &[PathBuf]) -> Result<Vec<Row>, Failure> {
    let mut rows = Vec::new();
    for path in paths {
        let found = from_csv(&files::read(path)?)
            .map_err(|error| Failure(format!("{}: {error}", path.display())))?;
        rows.extend(found);
    }
    Ok(rows)
}

/// The rows made so far, in a file of their own until the run ends.
struct Kept {
    path: PathBuf,
    /// `None` after a failed write: a line that is cut off must stay the last one.
    journal: Mutex<Option<Journal<File>>>,
}

impl Kept {
    /// Begins the file with the rows of earlier runs, which were read from the files `read`.
    /// Refuses to overwrite rows that were not read.
    fn begin(path: PathBuf, read: &[PathBuf], rows: &[Row]) -> Result<Self, Failure> {
        let same = |other: &PathBuf| match (other.canonicalize(), path.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => false,
        };
        let holds_rows = std::fs::metadata(&path).is_ok_and(|file| file.len() > 0);
        if holds_rows && !read.iter().any(same) {
            return Err(Failure(format!(
                "{0} holds the rows of a run that was killed, or still goes on: once it has ended, \
                 take it up with --rows {0} (the same seed, the same files in the same order), or \
                 delete that file",
                path.display()
            )));
        }
        files::write(&path, &if rows.is_empty() { Vec::new() } else { to_csv(rows)? })?;
        let failed = |error| Failure(format!("cannot write {}: {error}", path.display()));
        let file = OpenOptions::new().append(true).open(&path).map_err(failed)?;
        let journal = Mutex::new(Some(Journal::new(file, !rows.is_empty())));
        Ok(Self { path, journal })
    }

    fn add(&self, rows: &[Row]) {
        let Ok(mut kept) = self.journal.lock() else { return };
        let Some(journal) = kept.as_mut() else { return };
        if let Err(error) = journal.add(rows) {
            eprintln!(
                "cannot write {}: {error}; the run goes on, and keeps its rows in memory until it ends",
                self.path.display()
            );
            *kept = None;
        }
    }

    /// Removes the file, after its rows were written to results.csv.
    fn end(&self) {
        match std::fs::remove_file(&self.path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                eprintln!(
                    "cannot remove {}: {error}; all its rows are in results.csv, delete it",
                    self.path.display()
                );
            }
            _ => {}
        }
    }
}

/// A flag that Ctrl-C sets. A second Ctrl-C ends the process.
fn stop_on_ctrl_c() -> Result<&'static AtomicBool, Failure> {
    static STOPPED: AtomicBool = AtomicBool::new(false);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
                if STOPPED.swap(true, Ordering::Relaxed) {
                    std::process::exit(130);
                }
                eprintln!("\nending; what is done is kept (Ctrl-C again: only as unfinished.csv)");
            }
        });
    });
    Ok(&STOPPED)
}

/// Progress on standard error: rewritten in place on a terminal, otherwise a line now and then.
struct Meter {
    started: Instant,
    shown: Mutex<Instant>,
    terminal: bool,
}

impl Meter {
    fn new() -> Self {
        let now = Instant::now();
        Self { started: now, shown: Mutex::new(now), terminal: std::io::stderr().is_terminal() }
    }

    fn show(&self, progress: Progress) {
        let Progress { done, trials, share } = progress;
        let pause = Duration::from_millis(if self.terminal { 200 } else { 10_000 });
        let Ok(mut shown) = self.shown.lock() else { return };
        if shown.elapsed() < pause && done < trials {
            return;
        }
        *shown = Instant::now();
        let left = self.started.elapsed().mul_f64((1.0 - share).max(0.0) / share.max(1e-9));
        let line = format!("{done} of {trials} trials, about {} left", duration(left));
        let mut stderr = std::io::stderr().lock();
        // It does not matter whether anyone reads it.
        let _ = if self.terminal {
            write!(stderr, "\r{line:60}").and_then(|()| stderr.flush())
        } else {
            writeln!(stderr, "{line}")
        };
    }

    fn end(&self) {
        if self.terminal {
            eprintln!();
        }
        eprintln!("took {}", duration(self.started.elapsed()));
    }
}

fn duration(time: Duration) -> String {
    let seconds = time.as_secs();
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        _ => format!("{} h {} min", seconds / 3600, seconds % 3600 / 60),
    }
}
