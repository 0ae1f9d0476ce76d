//! Renderings: host, marked and attacked meshes, coloured by their distance from the host.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use glam::DVec3;
use rayon::prelude::*;

use super::raster::{SIZE, View, draw};
use crate::attacks::{Attack, Target};
use crate::lab::grid::Experiment;
use crate::lab::run::{Plan, Subject};
use crate::lab::trial::Trial;
use crate::mesh::Mesh;
use crate::mesh::closest::Closest;

/// A rendering.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// What it shows.
    pub caption: String,
    /// `data:image/png;base64,...`
    pub uri: String,
}

/// The renderings of one host.
#[derive(Debug, Clone, PartialEq)]
pub struct Gallery {
    /// The host's name.
    pub mesh: String,
    /// Host, marked, attacked.
    pub pictures: Vec<Picture>,
}

/// Families of attacks whose strongest attack is shown.
const SHOWN: [&str; 8] = [
    "noise",
    "uniform-noise",
    "smoothing",
    "quantisation",
    "simplification",
    "remeshing",
    "cropping",
    "spikes",
];

/// Largest number of marks that are shown, each of another method.
const MOST_MARKS: usize = 6;

/// Share of the vertices whose distances the heat map spans. The rest has the hottest colour.
const SPANNED: f64 = 0.995;

/// Colour of a surface at distance 0: light grey.
const COLD: DVec3 = DVec3::new(0.82, 0.82, 0.84);

/// Draws hosts, their marked meshes of trial 0, and attacks on the first marked mesh.
#[must_use]
pub fn galleries(plan: &Plan<'_>, stop: &(dyn Fn() -> bool + Sync)) -> Vec<Gallery> {
    let of = |(number, subject): (usize, &Subject)| gallery(plan, number, subject, stop);
    plan.subjects.par_iter().enumerate().map(of).collect()
}

fn gallery(
    plan: &Plan<'_>,
    number: usize,
    subject: &Subject,
    stop: &(dyn Fn() -> bool + Sync),
) -> Gallery {
    let host = subject.asset.mesh();
    let view = View::of(host);
    let mut pictures = vec![Picture {
        caption: "host".into(),
        uri: uri(&draw(host, &view, &vec![COLD; host.positions().len()])),
    }];
    let Some(measured) = subject.measured() else {
        return Gallery { mesh: subject.name.clone(), pictures };
    };
    let surface = measured.closest();
    let diagonal = subject.surface.diagonal();
    let trials = shown_trials(plan, number, subject);
    for (k, trial) in trials.iter().enumerate() {
        let Ok(marked) = trial.mark(stop) else { continue };
        let what = format!("marked, {} {}", trial.setting.method, marked.report.strength.get());
        pictures.push(heated(&marked.mesh, &view, surface, diagonal, &what));
        if k > 0 {
            continue;
        }
        let target = Target::new(&marked.mesh);
        for (place, attack) in trial.met() {
            if strongest(trial.attacks, attack)
                && let Ok(mesh) = trial.attack(&marked.report, &target, attack, place)
            {
                pictures.push(heated(&mesh, &view, surface, diagonal, &attack.to_string()));
            }
        }
    }
    Gallery { mesh: subject.name.clone(), pictures }
}

/// The first trial of each method, of the experiment with the most attacks.
fn shown_trials<'a>(plan: &Plan<'a>, number: usize, subject: &'a Subject) -> Vec<Trial<'a>> {
    let attacks = |experiment: &&Experiment| experiment.attacks.len();
    let Some(experiment) = plan.experiments.iter().rev().max_by_key(attacks) else {
        return Vec::new();
    };
    let mut trials: Vec<Trial<'a>> = Vec::new();
    for &setting in &experiment.settings {
        let known = trials.iter().any(|trial| trial.setting.method == setting.method);
        if !known && trials.len() < MOST_MARKS {
            trials.push(Trial {
                experiment: experiment.name,
                subject,
                number,
                setting,
                attacks: &experiment.attacks,
                families: plan.families,
                known: None,
                trial: 0,
                seed: plan.seed,
                damage: false,
            });
        }
    }
    trials
}

/// Whether an attack is the last of its family, and the family is shown. Grids list attacks from
/// weak to strong.
fn strongest(all: &[Attack], attack: Attack) -> bool {
    let family = attack.family();
    let last = all.iter().rfind(|other| other.family() == family);
    SHOWN.contains(&family) && last == Some(&attack)
}

/// The mesh, coloured by the distance of its vertices from the host's surface.
fn heated(mesh: &Mesh, view: &View, host: &Closest, diagonal: f64, what: &str) -> Picture {
    let distances: Vec<f64> =
        mesh.positions().par_iter().with_min_len(1024).map(|&p| host.distance(p)).collect();
    let mut sorted = distances.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the length")]
    let place = (SPANNED * sorted.len().saturating_sub(1) as f64) as usize;
    let hottest = sorted.get(place).copied().unwrap_or_default();
    // Rounding to single precision is not shown as a distance.
    let hottest = hottest.max(1e-7 * diagonal);
    let colours: Vec<DVec3> = distances.iter().map(|d| heat(d / hottest)).collect();
    Picture {
        caption: format!("{what}; reddest: {:.4} % of the diagonal", 100.0 * hottest / diagonal),
        uri: uri(&draw(mesh, view, &colours)),
    }
}

/// Grey over yellow and orange to dark red.
fn heat(share: f64) -> DVec3 {
    let stops =
        [COLD, DVec3::new(1.0, 0.9, 0.45), DVec3::new(0.95, 0.5, 0.15), DVec3::new(0.7, 0.05, 0.1)];
    let at = 3.0 * share.clamp(0.0, 1.0);
    let blend = |from: usize, t: f64| stops[from].lerp(stops[from + 1], t);
    match at {
        x if x < 1.0 => blend(0, x),
        x if x < 2.0 => blend(1, x - 1.0),
        x => blend(2, x - 2.0),
    }
}

/// Pixels as a PNG in a data URI; empty if the encoder fails, which is not expected.
fn uri(pixels: &[u8]) -> String {
    let side = u32::try_from(SIZE / 2).unwrap_or_default();
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, side, side);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(pixels).and_then(|()| writer.finish()));
    match written {
        Ok(()) => format!("data:image/png;base64,{}", BASE64_STANDARD.encode(file)),
        Err(_) => String::new(),
    }
}
