//! Which tables a report shows.

use super::claims::claims;
use super::table::{Cell, Table};
use super::{paper, reasons};
use crate::lab::grid::Grid;
use crate::lab::summary::Group;

/// All tables, those of the grid's source first.
#[must_use]
pub fn tables(grid: Grid, groups: &[Group]) -> Vec<Table> {
    let mut all = vec![trials(groups)];
    if grid == Grid::Paper {
        all.extend(table_1(groups));
        all.extend(table_2(groups));
        all.extend(claims(groups));
    }
    for experiment in distinct(groups.iter().map(|g| g.experiment.as_str())) {
        let own: Vec<&Group> = groups.iter().filter(|g| g.experiment == experiment).collect();
        all.push(cost(experiment, &own));
        for mesh in distinct(own.iter().map(|g| g.mesh.as_str())) {
            let own: Vec<&Group> = own.iter().copied().filter(|g| g.mesh == mesh).collect();
            if own.iter().any(|g| g.family != "none") {
                all.push(survival(experiment, mesh, &own));
            }
            if grid == Grid::Liris {
                all.push(bit_errors(experiment, mesh, &own));
            }
        }
    }
    all
}

/// Number of trials per mesh and experiment. Remeshing may have fewer on large meshes.
fn trials(groups: &[Group]) -> Table {
    let mut rows = Vec::new();
    for experiment in distinct(groups.iter().map(|g| g.experiment.as_str())) {
        for mesh in distinct(groups.iter().map(|g| g.mesh.as_str())) {
            let own = |g: &&Group| g.experiment == experiment && g.mesh == mesh;
            let own: Vec<&Group> = groups.iter().filter(own).collect();
            let span = |groups: &[&Group]| {
                let counts = || groups.iter().map(|g| g.trials + g.failed);
                match (counts().min(), counts().max()) {
                    (Some(least), Some(most)) if least < most => format!("{least} to {most}"),
                    (Some(least), _) => least.to_string(),
                    _ => "none".to_owned(),
                }
            };
            let (remeshing, others): (Vec<&Group>, Vec<&Group>) =
                own.into_iter().partition(|g| g.family == "remeshing");
            if !others.is_empty() || !remeshing.is_empty() {
                let cells = [mesh, experiment, &span(&others), &span(&remeshing)];
                rows.push(cells.map(Cell::plain).to_vec());
            }
        }
    }
    Table {
        title: "Trials per mark".into(),
        note: "Each with a random key and message.".into(),
        head: ["mesh", "experiment", "trials", "remeshing"].map(str::to_owned).to_vec(),
        rows,
    }
}

/// Items in the order of first appearance, each once.
pub fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut list = Vec::new();
    for item in items {
        if !list.contains(&item) {
            list.push(item);
        }
    }
    list
}

/// A mark's name: its method, with strength and bits only where they differ among `all`.
pub fn label(group: &Group, all: &[&Group]) -> String {
    let differs = |other: &&&Group| other.strength.to_bits() != group.strength.to_bits();
    let strength = all.iter().find(differs).map(|_| format!(" {}", group.strength));
    let differs = |other: &&&Group| other.bits != group.bits;
    let bits = all.iter().find(differs).map(|_| format!(" {} bits", group.bits));
    [group.method.as_str(), &strength.unwrap_or_default(), &bits.unwrap_or_default()].concat()
}

fn percent(share: f64, digits: usize) -> String {
    format!("{:.digits$}", 100.0 * share)
}

/// Table 1 of the paper: MRMS in the meshes' unit.
fn table_1(groups: &[Group]) -> Option<Table> {
    let own: Vec<&Group> = groups.iter().filter(|g| g.experiment == "table 1").collect();
    let head = [
        "mesh",
        "method",
        "MRMS x 10^-4",
        "paper",
        "ours / paper",
        "% of the diagonal",
        "why they differ",
    ];
    let row = |g: &&Group| {
        let ours = 1e4 * g.mark_mrms * g.diagonal;
        if g.trials == 0 {
            let error = g.error.clone().unwrap_or_default();
            return vec![
                Cell::plain(g.mesh.clone()),
                Cell::plain(label(g, &own)),
                Cell::plain(error),
            ];
        }
        let theirs = paper::mrms(g);
        let why = theirs.zip(paper::vertices(&g.mesh));
        vec![
            Cell::plain(g.mesh.clone()),
            Cell::plain(label(g, &own)),
            Cell::plain(format!("{ours:.2}")),
            Cell::plain(theirs.map_or_else(String::new, |t| format!("{t:.2}"))),
            Cell::plain(theirs.map_or_else(String::new, |t| format!("{:.2}", ours / t))),
            Cell::plain(percent(g.mark_mrms, 4)),
            Cell::plain(why.map_or_else(String::new, |(t, n)| reasons::of_distortion(g, t, n))),
        ]
    };
    (!own.is_empty()).then(|| Table {
        title: "Table 1 of the paper: distortion of the mark, single pass".into(),
        note: "MRMS as Metro samples it, in the mesh's own unit.".into(),
        head: head.map(str::to_owned).to_vec(),
        rows: own.iter().map(row).collect(),
    })
}

/// Table 2 of the paper: subdivision.
fn table_2(groups: &[Group]) -> Option<Table> {
    let families = ["butterfly", "loop", "midpoint"];
    let own: Vec<&Group> = groups
        .iter()
        .filter(|g| g.experiment.contains("table 2") && families.contains(&g.family.as_str()))
        .collect();
    let single_pass = |of: &Group| {
        let same = |g: &&Group| {
            g.experiment == "table 1" && g.trials > 0 && reasons::same_but_for_loop(g, of)
        };
        groups.iter().find(same).map(|g| g.detection_ratio)
    };
    let before = |of: &Group| {
        groups.iter().find(|g| g.family == "none" && g.trials > 0 && reasons::same_mark(g, of))
    };
    let cell = |g: &Group| {
        let paper = paper::subdivided(g);
        let paper = paper.map_or_else(String::new, |p| format!(" (paper {p})"));
        Cell::rated(format!("{:.3}{paper}", g.detection_ratio), 2.0 * g.detection_ratio - 1.0)
    };
    let why = |g: &Group| {
        let paper = paper::subdivided(g)?;
        let reason = reasons::of_ratio(g, paper, before(g), single_pass(g));
        let more = g.detection_ratio - paper;
        (!reason.is_empty()).then(|| format!("{} {more:+.2}: {reason}", g.family))
    };
    let mut rows = Vec::new();
    for mesh in distinct(own.iter().map(|g| g.mesh.as_str())) {
        for name in distinct(own.iter().map(|g| label(g, &own))) {
            let found = families.map(|family| {
                own.iter().find(|g| {
                    g.mesh == mesh && g.family == family && label(g, &own) == name && g.trials > 0
                })
            });
            let mut row = vec![Cell::plain(mesh), Cell::plain(name.clone())];
            row.extend(found.iter().map(|g| g.map_or_else(Cell::default, |g| cell(g))));
            let reasons: Vec<String> = found.iter().flatten().filter_map(|g| why(g)).collect();
            row.push(Cell::plain(reasons.join("; ")));
            rows.push(row);
        }
    }
    (!rows.is_empty()).then(|| Table {
        title: "Table 2 of the paper: detection ratio after subdivision".into(),
        note: "Closed loop: every bit is right before the attack; the paper embeds in a single \
               pass. Differences below 0.03 count as none."
            .into(),
        head: ["mesh", "method", "butterfly", "Loop", "midpoint", "where they differ, why"]
            .map(str::to_owned)
            .to_vec(),
        rows,
    })
}

/// What the marks of an experiment do to their hosts.
fn cost(experiment: &str, groups: &[&Group]) -> Table {
    let head = [
        "mesh",
        "method",
        "strength",
        "bits",
        "MRMS, % of diagonal",
        "Hausdorff, %",
        "normals turned, degrees",
        "flipped, %",
        "perceived (MSDM2)",
        "bits right, %",
        "bound, log10",
        "trials",
        "refused",
        "other placement",
    ];
    let row = |g: &&Group| {
        vec![
            Cell::plain(g.mesh.clone()),
            Cell::plain(g.method.clone()),
            Cell::plain(format!("{:.3}", g.strength_used)),
            Cell::plain(g.bits.to_string()),
            Cell::plain(percent(g.mark_mrms, 4)),
            Cell::plain(percent(g.mark_hausdorff, 3)),
            Cell::plain(format!("{:.2}", g.mark_normal_deviation)),
            Cell::plain(percent(g.mark_flipped, 3)),
            Cell::plain(g.mark_perceived.map_or_else(String::new, |p| format!("{p:.3}"))),
            Cell::plain(percent(g.detection_ratio, 1)),
            Cell::plain(format!("{:.1}", g.log10_bound)),
            Cell::plain(g.trials.to_string()),
            Cell::plain(match &g.error {
                Some(error) => format!("{}: {error}", g.failed),
                None => "0".to_owned(),
            }),
            Cell::plain(g.fell_back.to_string()),
        ]
    };
    Table {
        title: format!("Cost of the marks: {experiment}"),
        note:
            "Means over trials. \"Other placement\": trials in which an exact method fell back on \
               the paper's placement."
                .into(),
        head: head.map(str::to_owned).to_vec(),
        rows: groups.iter().filter(|g| g.family == "none").map(row).collect(),
    }
}

/// One row per attack, one column per mark.
fn matrix(
    groups: &[&Group],
    cell: impl Fn(&Group) -> Cell,
    more: &[&str],
    extra: impl Fn(&[&Group]) -> Vec<String>,
) -> (Vec<String>, Vec<Vec<Cell>>) {
    let marks = distinct(groups.iter().map(|g| label(g, groups)));
    let mut head = vec!["attack".to_owned()];
    head.extend(marks.iter().cloned());
    head.extend(more.iter().map(|&name| name.to_owned()));
    let row = |attack: &str| {
        let own = || groups.iter().filter(|g| g.attack == attack);
        let mut row = vec![Cell::plain(attack)];
        row.extend(marks.iter().map(|mark| {
            own().find(|g| label(g, groups) == *mark).map_or_else(Cell::default, |g| cell(g))
        }));
        let own: Vec<&Group> = own().copied().collect();
        row.extend(extra(&own).into_iter().map(Cell::plain));
        row
    };
    let rows = distinct(groups.iter().map(|g| g.attack.as_str())).into_iter().map(row).collect();
    (head, rows)
}

fn survival(experiment: &str, mesh: &str, groups: &[&Group]) -> Table {
    let cell = |g: &Group| {
        if g.trials == 0 {
            return Cell::plain(g.error.clone().unwrap_or_default());
        }
        let text = format!(
            "{:.3} \u{b7} {:.1} \u{b7} {:.0} % \u{b7} {:.0} %",
            g.detection_ratio,
            g.log10_bound,
            100.0 * g.matches,
            100.0 * g.matches_in_place
        );
        match g.log10_bound_relief {
            None => Cell::rated(text, g.matches),
            Some(bound) => {
                let share = g.matches_with_host;
                let text = format!("{text} \u{b7} {bound:.1} \u{b7} {:.0} %", 100.0 * share);
                Cell::rated(text, share)
            }
        }
    };
    // Measured on one of the marks.
    let damage = |own: &[&Group]| {
        let mrms = own.iter().find_map(|g| g.attacked_mrms);
        vec![mrms.map_or_else(String::new, |mrms| percent(mrms, 3))]
    };
    let (head, rows) = matrix(groups, cell, &["attacked mesh, MRMS %"], damage);
    Table {
        title: format!("What the marks survive: {mesh} ({experiment})"),
        note:
            "Per mark: mean share of bits right, mean log10 of the false-positive bound, share of \
               trials that match, all three read blindly; share that match when the host's \
               own frame is tried too, as for a record that the request names. Where the mark has a \
               relief: mean log10 of the bound of the relief, read against the host, and share that \
               match blind, in the host's frame or by the relief."
                .into(),
        head,
        rows,
    }
}

fn bit_errors(experiment: &str, mesh: &str, groups: &[&Group]) -> Table {
    let cell = |g: &Group| {
        if g.trials == 0 {
            return Cell::plain(g.error.clone().unwrap_or_default());
        }
        Cell::rated(format!("{:.2}", g.bit_error_rate), 1.0 - 2.0 * g.bit_error_rate)
    };
    let published =
        |own: &[&Group]| match own.first().and_then(|g| paper::liris(&g.family, g.amount)) {
            Some(rates) => rates.map(|rate| format!("{rate:.2}")).to_vec(),
            None => vec![String::new(); 2],
        };
    let names = ["Cho 2007, Venus", "Wang 2011, Venus"];
    let (head, rows) = matrix(groups, cell, &names, published);
    Table {
        title: format!("Bit error rate: {mesh}, {experiment}"),
        note:
            "Mean share of bits read wrong (one that is not read counts half), in the benchmark's \
               row order. The last columns are \
               published for the benchmark's own Venus (100,759 vertices) with 64 bits and the \
               perceptual budget: another mesh has other rates."
                .into(),
        head,
        rows,
    }
}
