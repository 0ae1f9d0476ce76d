//! Layout search: where the bins of a damaged file lie, found from the file alone.
//!
//! The blind frame is computed from extremes and from a mean over the whole surface. One vertex moved
//! out by 1 %, a few stray triangles, a smoothing pass or a cut-off ear shifts the frame, although
//! hardly a norm has changed. But a mark reveals its own bins: the statistic of every bin is off
//! neutral, which is rare by chance. Centres and bin layouts are therefore searched for those in which
//! the suspect's norms look most like marked ones. The search reads the suspect alone, never a
//! codeword. Only the few best readings are scored, and all of these are counted.
//!
//! Steps: `outliers` drops stray parts, `centre` searches the centre, `energy` searches the bin
//! layouts.

mod centre;
mod energy;
mod outliers;

use std::borrow::Cow;
use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use crate::watermark::bins::{BinLayout, Frame, trimmed_share};
use crate::watermark::{BitCount, Hypothesis, Modulation, Profile, SoftBits, Suspect};
use energy::Peak;

/// How much is searched and scored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayoutEffort {
    /// Centres are searched up to this far from the suspect's own, as a share of the diagonal.
    pub radius: f64,
    /// Centres that are found by their roughness, besides the suspect's own.
    pub candidates: usize,
    /// Of all these, centres that are kept, by the energy of their best bin layout.
    pub centres: usize,
    /// Bin layouts scored per layout class about each centre that is kept.
    pub layouts: usize,
}

/// How far the extremes of the norms may be from those of the marked mesh, as shares of the radial
/// extent. `lost` bounds what the file lacks, `excess` what it has beyond. A larger excess is an
/// outlier.
#[derive(Debug, Clone, Copy)]
struct Window {
    lost_below: f64,
    excess_below: f64,
    lost_above: f64,
    excess_above: f64,
}

impl Window {
    /// For 64 bits, what a cut of 2 % takes away: the bunny without its farthest 2 % of vertices lacks
    /// 24 % of its remaining extent, most other meshes less than 10 %. For more bits the window has as
    /// many bins, so that the search takes about as long.
    fn of(bits: BitCount) -> Self {
        let share = (64.0 / bits.get() as f64).min(1.0);
        Self {
            lost_below: 0.04 * share,
            excess_below: 0.02 * share,
            lost_above: 0.27 * share,
            excess_above: 0.03 * share,
        }
    }

    fn admits(&self, frame: &Frame, seen: &Frame) -> bool {
        let extent = seen.radial_extent();
        let below = (frame.rho_min - seen.rho_min) / extent;
        let above = (frame.rho_max - seen.rho_max) / extent;
        (-self.lost_below..=self.excess_below).contains(&below)
            && (-self.excess_above..=self.lost_above).contains(&above)
    }
}

/// A bin layout in which the norms look marked.
#[derive(Debug, Clone)]
struct Found {
    centre: DVec3,
    peak: Peak,
    soft: Arc<SoftBits>,
}

/// What is found about one centre.
#[derive(Debug, Clone)]
struct About {
    /// The centre and the range that the norms span about it.
    seen: Frame,
    /// Its bin layouts, best first.
    found: Vec<Found>,
}

/// The bin layouts found for one number of bits and one modulation, best first, per centre.
#[derive(Debug, Clone)]
pub struct Layouts {
    bits: BitCount,
    per_centre: Vec<About>,
    /// How many of each a class takes.
    most: usize,
}

/// Searches a suspect for the bin layouts of marks of `bits` bits.
#[must_use]
pub fn synchronise(
    suspect: &Suspect,
    bits: BitCount,
    modulation: Modulation,
    effort: &LayoutEffort,
) -> Layouts {
    synchronise_until(suspect, bits, modulation, effort, &|| false)
}

/// As [`synchronise`], calling `stop` before each centre and each row of bin layouts. The result must
/// be discarded once `stop` answers `true`.
#[must_use]
pub fn synchronise_until(
    suspect: &Suspect,
    bits: BitCount,
    modulation: Modulation,
    effort: &LayoutEffort,
    stop: &(dyn Fn() -> bool + Sync),
) -> Layouts {
    let none = Layouts { bits, per_centre: Vec::new(), most: effort.layouts };
    let Some(body) = outliers::body(suspect, stop) else { return none };
    let mut centres = vec![body.centre];
    centres.extend(centre::search(&body, bits, modulation, effort, stop));
    let mut per_centre: Vec<(Cow<'_, Profile>, Vec<Peak>)> = centres
        .into_iter()
        .map_while(|centre| {
            // Sorting the norms is the most expensive step. The norms about the suspect's own centre
            // are sorted already.
            let whole = body.positions.len() == suspect.vertices();
            let profile = if whole && centre == suspect.frame().centre {
                Cow::Borrowed(suspect.profile())
            } else {
                Cow::Owned(Profile::about_until(&body.positions, centre, stop)?)
            };
            let peaks = energy::peaks(&profile, bits, modulation, stop);
            Some((profile, peaks))
        })
        .collect();
    let best = |peaks: &[Peak]| peaks.first().map_or(0.0, |peak| peak.energy);
    per_centre.sort_by(|(_, a), (_, b)| best(b).total_cmp(&best(a)));
    per_centre.truncate(effort.centres);
    let about = |(profile, peaks): (Cow<'_, Profile>, Vec<Peak>)| {
        let read = |peak: Peak| {
            let soft = profile.read_layout(&peak.layout(bits), modulation);
            Found { centre: profile.frame().centre, peak, soft: Arc::new(soft) }
        };
        About { seen: profile.frame(), found: peaks.into_par_iter().map(read).collect() }
    };
    let per_centre = per_centre.into_iter().map(about).collect();
    Layouts { bits, per_centre, most: effort.layouts }
}

impl Layouts {
    /// Number of readings of all layout classes together.
    #[must_use]
    pub fn of_all_classes(&self) -> usize {
        (0..=u8::MAX).into_par_iter().map(|class| self.of_class(class).len()).sum()
    }

    /// The readings of one layout class: the bin layouts found whose implied range agrees with the
    /// suspect's.
    #[must_use]
    pub fn of_class(&self, class: u8) -> Vec<Hypothesis> {
        let window = Window::of(self.bits);
        let mut readings = Vec::new();
        for About { seen, found } in &self.per_centre {
            let fitting = found.iter().filter_map(|found| {
                let frame = implied(found.centre, &found.peak.layout(self.bits), class);
                window.admits(&frame, seen).then(|| Hypothesis { frame, soft: found.soft.clone() })
            });
            readings.extend(fitting.take(self.most));
        }
        readings
    }
}

/// The frame in which a bin layout is that of a class.
fn implied(centre: DVec3, layout: &BinLayout, class: u8) -> Frame {
    let eps = trimmed_share(class);
    let extent = layout.width * layout.bins as f64 / (1.0 - 2.0 * eps);
    let rho_min = layout.start - eps * extent;
    Frame { centre, rho_min, rho_max: rho_min + extent }
}

#[cfg(test)]
mod tests;
