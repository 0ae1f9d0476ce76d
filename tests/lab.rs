//! `quadmark lab` as a user runs it: files in a folder, and what remains after Ctrl-C.
#![expect(clippy::unwrap_used, reason = "test helpers")]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

fn quadmark() -> Command {
    Command::new(env!("CARGO_BIN_EXE_quadmark"))
}

fn sample(folder: &Path) {
    let made = quadmark()
        .args(["sample", "blob", "--vertices", "3000", "-o"])
        .arg(folder.join("blob.obj"))
        .status();
    assert!(made.unwrap().success());
}

/// The grid that costs least.
fn lab(folder: &Path, trials: &str) -> Command {
    let mut command = lab_of(folder, &["blob.obj"], trials, "3");
    command.args(["--grid", "blind"]);
    command
}

fn lab_of(folder: &Path, files: &[&str], trials: &str, seed: &str) -> Command {
    let mut command = quadmark();
    command.arg("lab").args(files).arg("--out").arg(folder.join("out")).current_dir(folder);
    command.args(["--bits", "16", "--trials", trials, "--seed", seed]);
    command
}

#[test]
fn hosts_of_one_name_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    for (place, vertices) in [("one", "2000"), ("two", "3000")] {
        let mut made = quadmark();
        made.args(["sample", "blob", "--vertices", vertices, "-o"]);
        let path = folder.path().join(place).join("blob.obj");
        fs::create_dir(path.parent().unwrap()).unwrap();
        assert!(made.arg(&path).status().unwrap().success());
    }
    let files = ["one/blob.obj", "two/blob.obj"];
    let run = |files: &[&str]| {
        let mut command = lab_of(folder.path(), files, "1", "3");
        command.args(["--attacks", "none,noise"]).output().unwrap()
    };
    assert!(run(&files).status.success());
    let rows = fs::read_to_string(folder.path().join("out/results.csv")).unwrap();
    let of = |name: &str| rows.lines().filter(|row| row.contains(name)).count();
    assert!(of("one/blob,") > 0 && of("one/blob,") == of("two/blob,"), "{rows}");
    for place in ["one", "two"] {
        assert!(folder.path().join(format!("out/quick-noise-{place}-blob.svg")).exists());
    }
    let twice = run(&[files[0], "./one/../one/blob.obj"]);
    assert_eq!(twice.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&twice.stderr).contains("named twice"));
}

#[test]
fn names_that_stand_for_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    sample(folder.path());
    let cases = [
        (["--experiments", "figure"], "is called figure; there are: blind"),
        (["--attacks", "noise,nois"], "is called nois; there are: "),
        (["--attacks", "quantization"], "quantisation"),
    ];
    for (arguments, said) in cases {
        let refused = lab(folder.path(), "1").args(arguments).output().unwrap();
        assert_eq!(refused.status.code(), Some(2));
        let error = String::from_utf8_lossy(&refused.stderr);
        assert!(error.contains(said), "{error}");
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn a_run_leaves_rows_a_summary_and_a_page_that_stands_alone() {
    let folder = tempfile::tempdir().unwrap();
    sample(folder.path());
    assert!(lab(folder.path(), "1").output().unwrap().status.success());
    let read = |name: &str| fs::read_to_string(folder.path().join("out").join(name)).unwrap();
    let rows = read("results.csv");
    let lines = rows.lines().count();
    assert!(lines > 15, "{rows}");
    let summary: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(summary["complete"], true);
    assert_eq!(summary["trials"], 1);
    assert_eq!(summary["groups"].as_array().unwrap().len(), lines - 1);
    let page = read("report.html");
    assert!(page.contains("What the marks survive: blob") && page.contains("data:image/png"));
    for outside in ["src=\"http", "href=", "<script", "@import", "url("] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(lab(folder.path(), "1").output().unwrap().status.success());
    assert!(rows == read("results.csv"), "the same seed gives the same rows");
    let known = folder.path().join("known.csv");
    fs::rename(folder.path().join("out/results.csv"), &known).unwrap();
    let redrawn = lab(folder.path(), "0").arg("--rows").arg(&known).output().unwrap();
    assert!(redrawn.status.success() && rows == read("results.csv"));
    let again: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert!(again == summary, "a summary of rows is that of their run");
}

#[cfg(unix)]
fn lines(path: &Path) -> usize {
    fs::read_to_string(path).map_or(0, |text| text.lines().count())
}

/// A run without end, which ends at the latest with the test.
#[cfg(unix)]
struct Running(std::process::Child);

#[cfg(unix)]
impl Running {
    fn begin(folder: &Path) -> Self {
        Self(lab(folder, "100000").stderr(Stdio::null()).spawn().unwrap())
    }
}

#[cfg(unix)]
impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Waits until a run has more than `count` rows, for a minute at most.
#[cfg(unix)]
fn wait_for_rows(folder: &Path, count: usize) {
    let enough = || lines(&folder.join("out/unfinished.csv")) > count;
    for _ in 0..600 {
        std::thread::sleep(Duration::from_millis(100));
        if enough() {
            break;
        }
    }
    assert!(enough(), "no {count} rows in a minute");
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    sample(folder.path());
    let mut running = Running::begin(folder.path());
    wait_for_rows(folder.path(), 20);
    let interrupted = Command::new("kill").args(["-INT", &running.0.id().to_string()]).status();
    assert!(interrupted.unwrap().success());
    assert!(running.0.wait().unwrap().success());
    let out = folder.path().join("out");
    let summary = fs::read(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&summary).unwrap();
    assert_eq!(summary["complete"], false);
    assert!(fs::read_to_string(out.join("results.csv")).unwrap().lines().count() > 15);
    assert!(out.join("report.html").exists() && !out.join("unfinished.csv").exists());
}

#[cfg(unix)]
#[test]
fn what_a_killed_run_had_made_is_there_to_go_on_with() {
    let folder = tempfile::tempdir().unwrap();
    sample(folder.path());
    let mut running = Running::begin(folder.path());
    let out = folder.path().join("out");
    let unfinished = out.join("unfinished.csv");
    wait_for_rows(folder.path(), 60);
    running.0.kill().unwrap();
    running.0.wait().unwrap();
    let rows = || lines(&unfinished);
    let made = rows();
    assert!(made > 60 && !out.join("results.csv").exists());
    // A run that does not continue it does not overwrite it.
    let refused = lab(folder.path(), "2").output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(said.contains("unfinished.csv") && said.contains("--rows"), "{said}");
    assert_eq!(rows(), made);
    let mut of_another_seed = lab_of(folder.path(), &["blob.obj"], "2", "9");
    of_another_seed.args(["--grid", "blind"]);
    let refused = of_another_seed.arg("--rows").arg(&unfinished).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("are of seed 3"));
    assert_eq!(rows(), made);
    let went_on = lab(folder.path(), "2").arg("--rows").arg(&unfinished).output().unwrap();
    assert!(went_on.status.success());
    assert!(!unfinished.exists());
    let results = fs::read_to_string(out.join("results.csv")).unwrap();
    // The kill may have cut off less than a trial.
    assert!(results.lines().count() + 25 > made);
}
