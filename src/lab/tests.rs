//! Whole runs on small generated meshes.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::grid::{Choices, Experiment, Grid, Setting};
use super::report::{Report, galleries};
use super::row::{Journal, Row, from_csv, merged, to_csv};
use super::run::{Plan, Progress, Subject, Watch};
use super::summary::{Group, groups};
use crate::attacks::Attack;
use crate::attacks::crop::Of;
use crate::formats::Limits;
use crate::marking::Layers;
use crate::sample::{Sample, to_obj};
use crate::watermark::{BitCount, Method, Strength};

fn subject(sample: Sample, vertices: u32) -> Subject {
    let bytes = to_obj(&sample.mesh(vertices).unwrap());
    Subject::read(sample.to_string(), bytes, &Limits::default()).unwrap()
}

fn setting(method: Method) -> Setting {
    Setting {
        method,
        strength: Strength::default(),
        bits: BitCount::new(16).unwrap(),
        closed_loop: true,
        budget: None,
        layers: Layers::Blind,
    }
}

fn experiment(methods: &[Method], attacks: &[Attack]) -> Experiment {
    Experiment {
        name: "test",
        settings: methods.iter().map(|&m| setting(m)).collect(),
        attacks: attacks.to_vec(),
        first_mesh_only: false,
    }
}

/// A plan of all families, without known rows.
fn plan_of<'a>(
    subjects: &'a [Subject],
    experiments: &'a [Experiment],
    trials: usize,
    seed: u64,
) -> Plan<'a> {
    Plan { subjects, experiments, trials, seed, families: &[], known: &[] }
}

const ATTACKS: [Attack; 5] =
    [Attack::None, Attack::Noise(0.001), Attack::Noise(0.01), Attack::Noise(0.2), Attack::Midpoint];

#[test]
fn each_trial_is_kept_as_soon_as_it_is_done() {
    let subjects = [subject(Sample::Blob, 4000)];
    let experiments = [experiment(&[Method::QspMean], &ATTACKS)];
    let plan = plan_of(&subjects, &experiments, 3, 1);
    let file = Mutex::new(Vec::new());
    let kept = |rows: &[Row]| Journal::new(&mut *file.lock().unwrap(), false).add(rows).unwrap();
    let (first, later) = (AtomicUsize::new(0), &file);
    let keep = |rows: &[Row]| match first.fetch_add(1, Ordering::SeqCst) {
        0 => kept(rows),
        _ => Journal::new(&mut *later.lock().unwrap(), true).add(rows).unwrap(),
    };
    // On one thread, since this test identifies the first trial by counting.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let watch = Watch { stop: &|| false, progress: &|_| {}, kept: &keep };
    let rows = pool.install(|| plan.run(watch));
    let mut bytes = file.into_inner().unwrap();
    assert!(from_csv(&bytes).unwrap() == rows);
    // A run that was killed while it wrote: complete lines are read.
    bytes.truncate(bytes.len() - 7);
    assert!(from_csv(&bytes).unwrap() == rows[..rows.len() - 1]);
    // A file that somebody ended without a line feed loses nothing. Another table is refused.
    let whole = to_csv(&rows).unwrap();
    assert!(from_csv(&whole[..whole.len() - 1]).unwrap() == rows);
    assert!(from_csv(b"name,price\n").is_err() && from_csv(b"name,price\nx,1\n").is_err());
    assert_eq!(from_csv(b"").unwrap(), []);
}

fn rows_of(plan: &Plan<'_>) -> Vec<Row> {
    plan.run(Watch { stop: &|| false, progress: &|_| {}, kept: &|_| {} })
}

fn find<'a>(groups: &'a [Group], attack: &Attack) -> &'a Group {
    groups.iter().find(|g| g.attack == attack.to_string()).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_rows_on_any_number_of_threads() {
    let subjects = [subject(Sample::Blob, 5000), subject(Sample::Knot, 4000)];
    let experiments = [experiment(&[Method::QspMean, Method::ChoVar], &ATTACKS)];
    let plan = plan_of(&subjects, &experiments, 2, 7);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        to_csv(&pool.install(|| rows_of(&plan))).unwrap()
    };
    let one = on(1);
    assert!(one == on(3));
    let text = String::from_utf8(one).unwrap();
    assert_eq!(text.lines().count(), 1 + 2 * 2 * 2 * ATTACKS.len());
    let other = Plan { seed: 8, ..plan };
    assert!(to_csv(&rows_of(&other)).unwrap() != text.as_bytes());
}

#[test]
fn a_run_in_parts_gives_the_rows_of_the_whole() {
    let subjects = [subject(Sample::Blob, 5000)];
    let experiments = [experiment(&[Method::QspMean, Method::ChoVar], &ATTACKS)];
    let whole = plan_of(&subjects, &experiments, 2, 7);
    let rows = rows_of(&whole);
    let midpoint = rows_of(&Plan { families: &["midpoint".to_owned()], ..whole });
    let expected: Vec<&Row> = rows.iter().filter(|row| row.family == "midpoint").collect();
    assert!(expected.len() == 4 && midpoint.iter().eq(expected.iter().copied()));
    // Rows of an earlier run, read back, are not made again. Missing rows are made.
    let half = from_csv(&to_csv(&rows[..=rows.len() / 2]).unwrap()).unwrap();
    assert!(half == rows[..half.len()]);
    let rest = rows_of(&Plan { known: &half, ..whole });
    assert!(merged([half.as_slice(), &rest].concat()) == rows);
    assert_eq!(half.len() + rest.len(), rows.len());
    // The order in which they were kept does not matter.
    let mut shuffled = half.clone();
    shuffled.reverse();
    let all = whole.in_order(merged([shuffled.as_slice(), &rest].concat()));
    assert!(to_csv(&all).unwrap() == to_csv(&rows).unwrap());
    let stranger = Row { mesh: "another".into(), ..rows[0].clone() };
    let with_it = whole.in_order([std::slice::from_ref(&stranger), &shuffled].concat());
    assert!(with_it[..half.len()] == half && with_it[half.len()] == stranger);
    // Of a mark with some rows, only the missing ones are made.
    let without: Vec<Row> = rows.iter().filter(|row| row.family != "midpoint").cloned().collect();
    assert!(rows_of(&Plan { known: &without, ..whole }) == midpoint);
}

#[test]
fn rows_that_cannot_be_of_a_run_are_refused() {
    let subjects = [subject(Sample::Blob, 3000), subject(Sample::Knot, 3000)];
    let experiments = [experiment(&[Method::QspMean], &ATTACKS[..1])];
    let plan = plan_of(&subjects, &experiments, 1, 7);
    let rows = rows_of(&plan);
    let check = |rows: &[Row], plan: Plan<'_>| Plan { known: rows, ..plan }.check_known();
    assert_eq!(check(&rows, plan), Ok(()));
    // Rows of versions without the columns for seed and place.
    let csv = String::from_utf8(to_csv(&rows).unwrap()).unwrap();
    let older =
        csv.replacen(",seed,place,", ",", 1).replace(",0,7,0,", ",0,").replace(",0,7,1,", ",0,");
    let older = from_csv(older.as_bytes()).unwrap();
    assert!(older.len() == 2 && older.iter().all(|row| (row.seed, row.place) == (None, None)));
    assert_eq!(check(&older, Plan { seed: 8, ..plan }), Ok(()));
    // Older rows continued by newer ones: the newer ones decide.
    let gone_on_with = [older.as_slice(), &rows].concat();
    let other_mesh = [subject(Sample::Blob, 4000), subject(Sample::Knot, 3000)];
    let turned = [subject(Sample::Knot, 3000), subject(Sample::Blob, 3000)];
    let elsewhere = [subject(Sample::Gear, 3000)];
    let mut renamed = [subject(Sample::Blob, 3000), subject(Sample::Knot, 3000)];
    renamed[0].name = "one/blob".into();
    let in_another_order = rows_of(&Plan { subjects: &turned, ..plan });
    let mixed = [rows.as_slice(), &in_another_order].concat();
    let larger = Row { diagonal: 2.0 * rows[0].diagonal, ..rows[0].clone() };
    let scaled = [rows.as_slice(), std::slice::from_ref(&larger)].concat();
    let cases: [(&[Row], Plan<'_>, &str); 8] = [
        (&rows, Plan { seed: 8, ..plan }, "--seed 7"),
        (&rows, Plan { subjects: &elsewhere, seed: 8, ..plan }, "--seed 7"),
        (&rows, Plan { subjects: &turned, ..plan }, "was file 1"),
        (&gone_on_with, Plan { subjects: &turned, ..plan }, "was file 1"),
        (&rows, Plan { subjects: &other_mesh, ..plan }, "another mesh"),
        (&rows, Plan { subjects: &renamed, ..plan }, "name of then"),
        (&mixed, plan, "of one run"),
        (&scaled, plan, "another mesh"),
    ];
    for (rows, plan, said) in cases {
        let error = check(rows, plan).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
    // Rows of hosts that are not among the files.
    assert_eq!(check(&rows, Plan { subjects: &elsewhere, ..plan }), Ok(()));
}

#[test]
fn marks_fade_with_noise_and_the_summary_says_so() {
    let subjects = [subject(Sample::Blob, 5000)];
    let experiments = [experiment(&[Method::QspMean], &ATTACKS)];
    let plan = plan_of(&subjects, &experiments, 3, 1);
    let all = groups(&rows_of(&plan), -4.0);
    assert_eq!(all.len(), ATTACKS.len());
    let [none, weak, _, strong, midpoint] = ATTACKS.each_ref().map(|a| find(&all, a));
    for sound in [none, weak, midpoint] {
        assert!((sound.detection_ratio - 1.0).abs() < 1e-12, "{sound:?}");
        assert!((sound.matches - 1.0).abs() < 1e-12 && sound.log10_bound < -4.7, "{sound:?}");
    }
    assert!(strong.detection_ratio < 0.9 && strong.matches < 0.5, "{strong:?}");
    assert!(none.mark_mrms > 1e-6 && none.mark_mrms < 1e-3, "{none:?}");
    assert!(strong.attacked_mrms.unwrap() > 30.0 * none.attacked_mrms.unwrap());
    assert_eq!((none.trials, none.failed), (3, 0));
}

#[test]
fn a_mesh_that_carries_nothing_is_told_of_and_does_not_end_the_run() {
    let subjects = [subject(Sample::Gear, 450)];
    let experiments = [experiment(&[Method::QspMean], &ATTACKS)];
    let plan = plan_of(&subjects, &experiments, 1, 1);
    let rows = rows_of(&plan);
    assert_eq!(rows.len(), ATTACKS.len());
    assert!(rows.iter().all(|row| row.error.is_some() && row.bits_right.is_none()));
    assert_eq!(groups(&rows, -9.0)[0].failed, 1);
}

#[test]
fn a_stopped_run_keeps_what_is_done() {
    let subjects = [subject(Sample::Blob, 4000)];
    let experiments = [experiment(&[Method::QspMean], &ATTACKS)];
    let plan = plan_of(&subjects, &experiments, 12, 1);
    let done = AtomicUsize::new(0);
    let count = |progress: Progress| {
        assert!(progress.share > 0.0 && progress.share <= 1.0 && progress.trials == 12);
        done.store(progress.done, Ordering::SeqCst);
    };
    let stop = || done.load(Ordering::SeqCst) >= 2;
    let rows = plan.run(Watch { stop: &stop, progress: &count, kept: &|_| {} });
    assert!(rows.len() >= 2 * ATTACKS.len() && rows.len() < 12 * ATTACKS.len(), "{}", rows.len());
    assert_eq!(rows.len() % ATTACKS.len(), 0, "whole trials");
}

#[test]
fn a_budget_is_kept() {
    let subjects = [subject(Sample::Blob, 5000)];
    let free = [experiment(&[Method::QspMean], &[Attack::None])];
    let plan = plan_of(&subjects, &free, 1, 3);
    let budget = 0.6 * rows_of(&plan)[0].mark_mrms.unwrap();
    let bounded = Setting { budget: Some(budget), ..free[0].settings[0] };
    let experiments = [Experiment { settings: vec![bounded], ..free[0].clone() }];
    let rows = rows_of(&Plan { experiments: &experiments, ..plan });
    let mrms = rows[0].mark_mrms.unwrap();
    assert!((0.7 * budget..=budget).contains(&mrms), "{mrms:e} of {budget:e}");
    assert!(rows[0].strength_used.unwrap() < rows[0].strength);
}

/// A mark that also stays within a smaller budget is not made again for it.
#[test]
fn budgets_share_the_marks_that_they_can() {
    let subjects = [subject(Sample::Blob, 5000)];
    let attacks = [Attack::None, Attack::Noise(0.003)];
    let base = experiment(&[Method::QspMean, Method::ChoMean], &attacks);
    let with = |name, budget| {
        let settings = base.settings.iter().map(|&s| Setting { budget: Some(budget), ..s });
        Experiment { name, settings: settings.collect(), ..base.clone() }
    };
    let plan = |experiments| plan_of(&subjects, experiments, 2, 3);
    let free = [Experiment { name: "free", ..base.clone() }];
    let mrms = rows_of(&plan(&free)).into_iter().filter(|r| r.method == "cho-mean");
    let least = mrms.filter_map(|row| row.mark_mrms).fold(f64::INFINITY, f64::min);
    // Only the first budget limits marks, and only those of Cho.
    let all = [with("tight", 0.7 * least), with("loose", 3.0 * least), with("looser", 4.0 * least)];
    let mut alone: Vec<Row> =
        all.iter().flat_map(|e| rows_of(&plan(std::slice::from_ref(e)))).collect();
    let mut together = rows_of(&plan(&all));
    let order =
        |row: &Row| (row.experiment.clone(), row.trial, row.method.clone(), row.attack.clone());
    alone.sort_by_key(order);
    together.sort_by_key(order);
    assert!(alone == together);
    let strength = |experiment: &str, method: &str| {
        let own = |r: &&Row| r.experiment == experiment && r.method == method;
        together.iter().find(own).unwrap().strength_used.unwrap()
    };
    assert!(strength("loose", "cho-mean") > strength("tight", "cho-mean"));
    assert!((strength("tight", "qsp-mean") - strength("looser", "qsp-mean")).abs() < 1e-12);
}

#[test]
fn the_report_stands_alone_and_shows_each_mesh() {
    let subjects = [subject(Sample::Blob, 4000)];
    let choices = Choices {
        methods: vec![Method::QspMean, Method::ChoMean],
        bits: vec![BitCount::new(16).unwrap()],
        ..Choices::default()
    };
    let mut experiments = Grid::Paper.experiments(&choices);
    experiments.retain(|e| !matches!(e.name, "figure 10b" | "figure 11"));
    for experiment in &mut experiments {
        // Noise and nothing that takes long.
        experiment.attacks.retain(|a| matches!(a, Attack::None | Attack::Noise(_) | Attack::Loop));
    }
    let plan = plan_of(&subjects, &experiments, 1, 1);
    let groups = groups(&rows_of(&plan), -4.0);
    let galleries = galleries(&plan, &|| false);
    let report = Report {
        grid: Grid::Paper,
        trials: 1,
        seed: 1,
        threshold: -4.0,
        complete: true,
        groups: &groups,
        galleries: &galleries,
    };
    let page = report.html();
    for part in [
        "Table 1 of the paper",
        "Table 2 of the paper",
        "What the paper's text says",
        "Figure 5, blob",
        "Figure 10a, blob",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // Host, two methods, and noise on the first.
    assert_eq!(page.matches("<img ").count(), 4);
    let outside = |link: &str| page.contains(&format!("src=\"{link}")) || page.contains("<script");
    assert!(!outside("http") && !outside("//") && !page.contains("@import"));
    let names: Vec<String> = report.figures().into_iter().map(|f| f.name).collect();
    assert!(names.contains(&"figure-5-blob".to_owned()), "{names:?}");
    assert!(report.markdown().contains("| blob | qsp-mean |"));
}

/// The blind reader finds nothing in a new tessellation. The relief does, and the report shows
/// both.
#[test]
fn a_relief_is_read_against_the_host_beside_the_blind_reader() {
    let subjects = [subject(Sample::Blob, 6000)];
    let attacks = [0.1, 0.3, 0.5].map(|share| Attack::Crop(share, Of::Vertices));
    let attacks = [&[Attack::None, Attack::Remesh(0.5)], attacks.as_slice()].concat();
    let with_relief = Setting {
        layers: Layers::Both,
        strength: Strength::BESIDE_A_RELIEF,
        budget: Some(1e-4),
        ..setting(Method::ExactMean)
    };
    let both = Experiment { settings: vec![with_relief], ..experiment(&[], &attacks) };
    let blind = experiment(&[Method::ExactMean], &attacks[..2]);
    let rows = rows_of(&plan_of(&subjects, &[both], 2, 1));
    assert!(rows.iter().all(|row| row.error.is_none() && row.mark_mrms.unwrap() <= 1e-4));
    let summary = groups(&rows, -9.0);
    for attack in &attacks[1..] {
        let group = find(&summary, attack);
        assert!(group.matches.abs() < 1e-12, "{attack}: {}", group.log10_bound);
        assert!((group.matches_with_host - 1.0).abs() < 1e-12, "{attack}");
        assert!(group.log10_bound_relief.unwrap() < -15.0, "{attack}");
    }
    let figures = super::report::figures::figures(Grid::Quick, &summary);
    let names = |name: &str| -> Vec<String> {
        let figure = figures.iter().find(|figure| figure.name == name).unwrap();
        figure.plot.series.iter().map(|series| series.name.clone()).collect()
    };
    assert_eq!(
        names("test-cropping-blob-matches"),
        ["exact-mean, with the host", "exact-mean, blind"]
    );
    assert_eq!(names("test-cropping-blob"), ["exact-mean"]);
    let rows = rows_of(&plan_of(&subjects, &[blind], 1, 1));
    assert!(rows.iter().all(|row| row.log10_bound_relief.is_none()));
}
