//! What the paper's text says about its figures, beside what was measured. The curves themselves
//! are not in the text.

use super::paper;
use super::reasons::{self, ALIKE, Bounds};
use super::table::{Cell, Table};
use super::tables::distinct;
use crate::lab::summary::Group;

/// Which marks are averaged.
#[derive(Clone, Copy)]
enum Marks {
    Mean,
    Variance,
    Qsp,
    Cho,
}

impl Marks {
    fn has(self, method: &str) -> bool {
        match self {
            Self::Mean => matches!(method, "qsp-mean" | "cho-mean"),
            Self::Variance => matches!(method, "qsp-var" | "cho-var"),
            Self::Qsp => matches!(method, "qsp-mean" | "qsp-var"),
            Self::Cho => matches!(method, "cho-mean" | "cho-var"),
        }
    }
}

/// A comparison that the text makes: the first marks do better than the second, or equally well.
struct Comparison {
    family: &'static str,
    text: &'static str,
    first: Marks,
    second: Marks,
    alike: bool,
}

const COMPARISONS: [Comparison; 7] = [
    Comparison {
        family: "noise",
        text: "Figure 5: mean methods slightly better than variance methods",
        first: Marks::Mean,
        second: Marks::Variance,
        alike: false,
    },
    Comparison {
        family: "noise",
        text: "Figure 5: QSP similar to Cho",
        first: Marks::Qsp,
        second: Marks::Cho,
        alike: true,
    },
    Comparison {
        family: "smoothing",
        text: "Figure 6: QSP similar to Cho",
        first: Marks::Qsp,
        second: Marks::Cho,
        alike: true,
    },
    Comparison {
        family: "simplification",
        text: "Figure 7: QSP similar to Cho",
        first: Marks::Qsp,
        second: Marks::Cho,
        alike: true,
    },
    Comparison {
        family: "simplification",
        text: "Figure 7: variance methods slightly better than mean methods",
        first: Marks::Variance,
        second: Marks::Mean,
        alike: false,
    },
    Comparison {
        family: "quantisation",
        text: "Figure 8: mean methods better than variance methods",
        first: Marks::Mean,
        second: Marks::Variance,
        alike: false,
    },
    Comparison {
        family: "remeshing",
        text: "Figure 9: Cho slightly better than QSP",
        first: Marks::Cho,
        second: Marks::Qsp,
        alike: false,
    },
];

/// A level that the text gives: every method reaches at least `least` at this amount, or at any if
/// there is none.
struct Level {
    family: &'static str,
    amount: Option<f64>,
    least: f64,
    text: &'static str,
    /// Prefixes of the names of the meshes that the text speaks of; empty for all.
    meshes: &'static [&'static str],
}

const LEVELS: [Level; 4] = [
    Level {
        family: "similarity",
        amount: None,
        least: 1.0,
        text: "All four methods: perfectly robust against similarity transformations",
        meshes: &[],
    },
    Level {
        family: "reordering",
        amount: None,
        least: 1.0,
        text: "All four methods: perfectly robust against reordering",
        meshes: &[],
    },
    Level {
        family: "simplification",
        amount: Some(90.0),
        least: 0.9,
        text: "Figure 7: more than 0.9 at 90 %",
        meshes: &["gear", "dragon"],
    },
    Level {
        family: "quantisation",
        amount: Some(8.0),
        least: 0.8,
        text: "Figure 8: fairly robust up to 8 bits (taken as 0.8)",
        meshes: &[],
    },
];

/// The table of the text's claims. `None` if none of them can be checked.
pub fn claims(groups: &[Group]) -> Option<Table> {
    let own: Vec<&Group> =
        groups.iter().filter(|g| g.experiment.contains("figures 5-9") && g.trials > 0).collect();
    let mut rows = Vec::new();
    for mesh in distinct(own.iter().map(|g| g.mesh.as_str())) {
        let own: Vec<&Group> = own.iter().copied().filter(|g| g.mesh == mesh).collect();
        rows.extend(COMPARISONS.iter().filter_map(|claim| compared(mesh, &own, claim)));
        rows.extend(LEVELS.iter().filter_map(|level| reached(mesh, &own, level)));
    }
    (!rows.is_empty()).then(|| Table {
        title: "What the paper's text says of figures 5 to 9".into(),
        note: "Detection ratios, averaged over a figure's axis. Differences below 0.03 count as \
               none. In all of them ours begin with every bit right and equal margins, the \
               paper's with what a single pass leaves. Remeshing and simplification are other \
               programs than the paper's; a remesher that puts its vertices onto the surface \
               forgets where QSP had slid them along it, and Cho's bumps stay."
            .into(),
        head: ["the paper", "mesh", "ours", "agrees", "where not, why"].map(str::to_owned).to_vec(),
        rows,
    })
}

fn compared(mesh: &str, groups: &[&Group], claim: &Comparison) -> Option<Vec<Cell>> {
    let mean = |marks: Marks, value: fn(&Group) -> f64| {
        let of = |g: &&&Group| g.family == claim.family && marks.has(&g.method);
        let values: Vec<f64> = groups.iter().filter(of).map(|g| value(g)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let both = |value| Some((mean(claim.first, value)?, mean(claim.second, value)?));
    let (first, second) = both(|g| g.detection_ratio)?;
    let more = first - second;
    let verdict = match (claim.alike, more.abs() < ALIKE) {
        (true, true) => "yes",
        (false, true) => "no difference",
        (false, false) if more > 0.0 => "yes",
        _ => "no",
    };
    let reason = if verdict == "yes" {
        String::new()
    } else {
        let bounds = |value| both(value).map(|(first, second)| Bounds { first, second });
        let blind = bounds(|g| g.log10_bound)?;
        let known = bounds(|g| g.log10_bound_in_place)?;
        reasons::of_comparison(blind, known, claim.alike)
    };
    let ours = format!("{first:.3} and {second:.3}, difference {more:+.3}");
    Some(row(claim.text, mesh, ours, verdict, reason))
}

fn reached(mesh: &str, groups: &[&Group], level: &Level) -> Option<Vec<Cell>> {
    let said =
        level.meshes.is_empty() || level.meshes.iter().any(|name| paper::is_called(mesh, name));
    let at = |g: &&&Group| {
        let amount = |asked: f64| g.amount.is_some_and(|a| (a - asked).abs() < 1e-9);
        said && g.family == level.family && level.amount.is_none_or(amount)
    };
    let worst =
        groups.iter().filter(at).min_by(|a, b| a.detection_ratio.total_cmp(&b.detection_ratio))?;
    // The tolerance is for rounding: a mean of ones may be slightly below 1.
    let fits = worst.detection_ratio >= level.least - 1e-12;
    let ours = if worst.detection_ratio > 1.0 - 1e-12 {
        "all of them 1".to_owned()
    } else {
        format!("the least is {} with {:.4}", worst.method, worst.detection_ratio)
    };
    let verdict = if fits { "yes" } else { "no" };
    let before = groups.iter().find(|g| g.family == "none" && reasons::same_mark(g, worst));
    let reason = if fits {
        String::new()
    } else {
        reasons::of_ratio(worst, level.least + ALIKE, before.copied(), None)
    };
    Some(row(level.text, mesh, ours, verdict, reason))
}

fn row(text: &str, mesh: &str, ours: String, verdict: &str, reason: String) -> Vec<Cell> {
    let merit = match verdict {
        "yes" => 1.0,
        "no" => 0.0,
        _ => 0.5,
    };
    vec![
        Cell::plain(text),
        Cell::plain(mesh),
        Cell::plain(ours),
        Cell::rated(verdict, merit),
        Cell::plain(reason),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::report::test_support::group;

    fn noise(method: &str, detection_ratio: f64, log10_bound_in_place: f64) -> Group {
        let (method, family) = (method.to_owned(), "noise".to_owned());
        let log10_bound = -5.0;
        Group { method, family, detection_ratio, log10_bound, log10_bound_in_place, ..group() }
    }

    #[test]
    fn a_claim_that_does_not_hold_says_what_the_hosts_frame_says() {
        let groups = [
            noise("qsp-mean", 0.6, -15.0),
            noise("cho-mean", 0.6, -15.0),
            noise("qsp-var", 0.8, -5.0),
            noise("cho-var", 0.8, -5.0),
        ];
        let table = claims(&groups).unwrap();
        let texts: Vec<Vec<&str>> =
            table.rows.iter().map(|row| row.iter().map(|c| c.text.as_str()).collect()).collect();
        let [mean, similar] = texts.as_slice() else { panic!("{texts:?}") };
        assert_eq!((mean[3], similar[3], similar[4]), ("no", "yes", ""));
        assert!(mean[4].contains("it holds"), "{mean:?}");
    }

    #[test]
    fn a_level_is_that_of_the_worst_method() {
        let of = |method: &str, detection_ratio: f64| Group {
            method: method.into(),
            family: "quantisation".into(),
            amount: Some(8.0),
            detection_ratio,
            log10_bound: -1.0,
            ..group()
        };
        let table = claims(&[of("qsp-mean", 0.9), of("qsp-var", 0.7)]).unwrap();
        let level = table.rows.last().unwrap();
        assert_eq!(level[3].text, "no");
        assert!(level[2].text.contains("qsp-var") && level[4].text.starts_with("the frame"));
    }
}
