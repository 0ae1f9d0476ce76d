//! Which figures a report shows: any family of attacks with three amounts or more, and any sweep of
//! strengths or bits.

use std::collections::BTreeSet;

use super::plot::{Axis, Plot, Series};
use super::tables::{distinct, label};
use crate::lab::grid::Grid;
use crate::lab::summary::Group;
use crate::watermark::Method;

/// A figure and the name of its file, without extension.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Letters, digits and hyphens.
    pub name: String,
    /// What it shows.
    pub plot: Plot,
}

/// All figures.
#[must_use]
pub fn figures(grid: Grid, groups: &[Group]) -> Vec<Figure> {
    let mut all = Vec::new();
    for experiment in distinct(groups.iter().map(|g| g.experiment.as_str())) {
        let own: Vec<&Group> = groups.iter().filter(|g| g.experiment == experiment).collect();
        for mesh in distinct(own.iter().map(|g| g.mesh.as_str())) {
            let own: Vec<&Group> = own.iter().copied().filter(|g| g.mesh == mesh).collect();
            all.extend(sweeps(grid, mesh, &own));
            // If numbers of bits differ, one figure per method, else one for all methods.
            let by_method = distinct(own.iter().map(|g| g.bits)).len() > 1;
            let parts: Vec<Vec<&Group>> = if by_method {
                let methods = distinct(own.iter().map(|g| g.method.as_str())).into_iter();
                methods.map(|m| own.iter().copied().filter(|g| g.method == m).collect()).collect()
            } else {
                vec![own]
            };
            for part in parts {
                all.extend(robustness(grid, mesh, &part, by_method));
            }
        }
    }
    told_apart(&mut all);
    all
}

/// Appends numbers to file names that hosts with different names share.
fn told_apart(figures: &mut [Figure]) {
    let mut known = BTreeSet::new();
    for figure in figures {
        let first = figure.name.clone();
        let mut number = 1;
        while !known.insert(figure.name.clone()) {
            number += 1;
            figure.name = format!("{first}-{number}");
        }
    }
}

/// The paper's number for a family's figure.
fn number(grid: Grid, family: &str, experiment: &str) -> Option<&'static str> {
    match (grid, experiment, family) {
        (Grid::Paper, "figure 11", _) => Some("11"),
        (Grid::Paper, "figure 10a", _) => Some("10a"),
        (Grid::Paper, "figure 10b", _) => Some("10b"),
        (Grid::Paper, _, "noise") => Some("5"),
        (Grid::Paper, _, "smoothing") => Some("6"),
        (Grid::Paper, _, "simplification") => Some("7"),
        (Grid::Paper, _, "quantisation") => Some("8"),
        (Grid::Paper, _, "remeshing") => Some("9"),
        _ => None,
    }
}

/// The label of a family's amount, and whether small amounts are the strong ones.
fn amount(family: &str) -> (&'static str, bool) {
    match family {
        "noise" => ("noise, % of the largest vertex norm", false),
        "uniform-noise" => ("noise amplitude, % of the mean vertex norm", false),
        "smoothing" => ("iterations of Laplacian smoothing", false),
        "simplification" => ("triangles removed, %", false),
        "quantisation" => ("bits per coordinate", true),
        "remeshing" => ("vertices after remeshing, %", true),
        "cropping" => ("vertices cut away, %", false),
        "area-cropping" => ("area cut away, %", false),
        "collusion" => ("copies averaged", false),
        "fragment" => ("triangles kept, %", true),
        _ => ("amount", false),
    }
}

fn robustness(grid: Grid, mesh: &str, groups: &[&Group], by_method: bool) -> Vec<Figure> {
    let mut all = Vec::new();
    for family in distinct(groups.iter().map(|g| g.family.as_str())) {
        let own: Vec<&Group> =
            groups.iter().copied().filter(|g| g.family == family && g.trials > 0).collect();
        let mut amounts = distinct(own.iter().filter_map(|g| g.amount));
        if amounts.len() < 3 {
            continue;
        }
        amounts.sort_by(f64::total_cmp);
        let (x_label, falling) = amount(family);
        let mut x = Axis::through(x_label, &amounts);
        if falling {
            x.range = (x.range.1, x.range.0);
        }
        let experiment = own.first().map_or("", |g| g.experiment.as_str());
        let of =
            number(grid, family, experiment).map_or_else(String::new, |n| format!("Figure {n}, "));
        let method = own.first().filter(|_| by_method).map_or("", |g| g.method.as_str());
        let base = match number(grid, family, experiment) {
            Some(n) => format!("figure-{n}-{mesh}-{method}"),
            None => format!("{experiment}-{family}-{mesh}-{method}"),
        };
        let method = if method.is_empty() { String::new() } else { format!(", {method}") };
        let ratio = Axis {
            label: "detection ratio".into(),
            range: (0.4, 1.0),
            ticks: vec![0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0],
        };
        let matches = Axis::from_zero("share of trials that match", 1.0);
        let plot = |title: String, y: Axis, value: fn(&Group) -> f64| Plot {
            title,
            x: x.clone(),
            y,
            series: series(&own, |g| Some((g.amount?, value(g)))),
        };
        let title = format!("{of}{mesh}: {family}{method}");
        all.push(Figure {
            name: file_name(&base),
            plot: plot(title.clone(), ratio, |g| g.detection_ratio),
        });
        let mut matches = plot(format!("{title}, matches"), matches, |g| g.matches);
        if own.iter().any(|g| g.log10_bound_relief.is_some()) {
            matches.series = beside_the_host(matches.series, &own);
        }
        all.push(Figure { name: file_name(&format!("{base}-matches")), plot: matches });
    }
    all
}

/// Distortion over strength or over bits, if there are three of either.
fn sweeps(grid: Grid, mesh: &str, groups: &[&Group]) -> Vec<Figure> {
    let own: Vec<&Group> =
        groups.iter().copied().filter(|g| g.family == "none" && g.trials > 0).collect();
    let experiment = own.first().map_or("", |g| g.experiment.as_str());
    let mut all = Vec::new();
    for name in ["strength", "bits"] {
        let variable = |g: &Group| if name == "bits" { g.bits as f64 } else { g.strength };
        let mut values = distinct(own.iter().map(|g| variable(g)));
        if values.len() < 3 || experiment == "figure 11" {
            continue;
        }
        values.sort_by(f64::total_cmp);
        let mrms = |g: &Group| 1e4 * g.mark_mrms * g.diagonal;
        let highest = own.iter().map(|g| mrms(g)).fold(0.0, f64::max);
        let of =
            number(grid, "none", experiment).map_or_else(String::new, |n| format!("Figure {n}, "));
        let by_method = distinct(own.iter().map(|g| g.method.as_str()));
        let curve = |(k, &method): (usize, &&str)| {
            let mut points: Vec<(f64, f64)> =
                own.iter().filter(|g| g.method == method).map(|g| (variable(g), mrms(g))).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            Series { name: method.to_owned(), colour: colour(method, k), dashed: false, points }
        };
        all.push(Figure {
            name: file_name(&format!("{experiment}-{name}-{mesh}")),
            plot: Plot {
                title: format!("{of}{mesh}: distortion by {name}"),
                x: Axis::through(name, &values),
                y: Axis::from_zero("MRMS x 10^-4, mesh's unit", highest),
                series: by_method.iter().enumerate().map(curve).collect(),
            },
        });
    }
    all
}

/// One curve per mark.
fn series(groups: &[&Group], point: impl Fn(&Group) -> Option<(f64, f64)>) -> Vec<Series> {
    let marks = distinct(groups.iter().map(|g| label(g, groups)));
    let methods = distinct(groups.iter().map(|g| g.method.as_str())).len();
    let curve = |(k, name): (usize, &String)| {
        let own = || groups.iter().filter(|g| label(g, groups) == *name);
        let mut points: Vec<(f64, f64)> = own().filter_map(|g| point(g)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let method = own().next().map_or("", |g| g.method.as_str());
        let colour = if methods == marks.len() { colour(method, k) } else { k };
        Series { name: name.clone(), colour, dashed: method.ends_with("var"), points }
    };
    marks.iter().enumerate().map(curve).collect()
}

/// The curves of a blind reader, dashed, and those of a reader that has the host.
fn beside_the_host(blind: Vec<Series>, groups: &[&Group]) -> Vec<Series> {
    let with_host = series(groups, |g| Some((g.amount?, g.matches_with_host)));
    let named = |mut curve: Series, reader: &str, dashed| {
        curve.name = format!("{}, {reader}", curve.name);
        curve.dashed = dashed;
        curve
    };
    let with_host = with_host.into_iter().map(|curve| named(curve, "with the host", false));
    with_host.chain(blind.into_iter().map(|curve| named(curve, "blind", true))).collect()
}

/// A method has the same colour in all figures.
fn colour(method: &str, otherwise: usize) -> usize {
    Method::ALL.iter().position(|m| m.name() == method).unwrap_or(otherwise)
}

/// Lower-case letters, digits and single hyphens.
fn file_name(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_figure_has_the_file_of_another() {
        let figure = |mesh: &str| {
            let axis = Axis::from_zero("", 1.0);
            let plot = Plot { title: mesh.into(), x: axis.clone(), y: axis, series: Vec::new() };
            Figure { name: file_name(&format!("figure-5-{mesh}")), plot }
        };
        let mut all = ["x/blob", "x-blob", "Gear_1", "gear-1", "gear-1-2", "面", "鏡"].map(figure);
        told_apart(&mut all);
        let names = all.each_ref().map(|figure| figure.name.as_str());
        let expected = ["-x-blob", "-x-blob-2", "-gear-1", "-gear-1-2", "-gear-1-2-2", "", "-2"];
        assert_eq!(names, expected.map(|end| format!("figure-5{end}")));
    }
}
