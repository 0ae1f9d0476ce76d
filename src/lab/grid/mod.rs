//! Grids as data: which marks are made and which attacks are applied to them.

mod blind;
mod liris;
mod paper;
mod quick;

use std::fmt;
use std::str::FromStr;

use crate::attacks::Attack;
use crate::marking::Layers;
use crate::watermark::{BitCount, Method, Strength};

pub use liris::{GEOMETRIC_BUDGET, PERCEPTUAL_BUDGET};

/// How a mark is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    /// Modulation and placement.
    pub method: Method,
    /// The strength; with a budget, the largest allowed strength.
    pub strength: Strength,
    /// Number of bits.
    pub bits: BitCount,
    /// Whether embedding is repeated until a blind reader reads all bits, as in the service.
    /// Otherwise it is the paper's single pass.
    pub closed_loop: bool,
    /// Largest MRMS as a share of the diagonal. The mark is as strong as this budget allows.
    pub budget: Option<f64>,
    /// Its layers. A mark with a relief is also read against the host.
    pub layers: Layers,
}

/// Marks that undergo the same attacks.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// Its name in rows.
    pub name: &'static str,
    /// The marks.
    pub settings: Vec<Setting>,
    /// The attacks on each mark.
    pub attacks: Vec<Attack>,
    /// Whether only the first mesh takes part, as the bunny alone does in some of the paper's
    /// figures.
    pub first_mesh_only: bool,
}

/// A caller's choices, which replace those of the grid. An empty list keeps the grid's.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Choices {
    /// Methods.
    pub methods: Vec<Method>,
    /// Strengths.
    pub strengths: Vec<Strength>,
    /// Numbers of bits.
    pub bits: Vec<BitCount>,
}

/// A grid by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Grid {
    /// Tables 1 and 2 and figures 5 to 11 of Luo and Bors 2009.
    Paper,
    /// The protocol of the LIRIS benchmark (Wang et al. 2010), with both of its budgets.
    Liris,
    /// A few of everything, marked and read as the service does it.
    #[default]
    Quick,
    /// The blind layer alone under the attacks that are forecast.
    Blind,
}

impl Grid {
    /// All grids.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Liris, Self::Quick, Self::Blind];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Liris => "liris",
            Self::Quick => "quick",
            Self::Blind => "blind",
        }
    }

    /// Its experiments, with the caller's choices.
    #[must_use]
    pub fn experiments(self, choices: &Choices) -> Vec<Experiment> {
        match self {
            Self::Paper => paper::experiments(choices),
            Self::Liris => liris::experiments(choices),
            Self::Quick => quick::experiments(choices),
            Self::Blind => blind::experiments(choices),
        }
    }

    /// Default number of trials per mark. The first two are those of the source.
    #[must_use]
    pub fn trials(self) -> usize {
        match self {
            Self::Paper => 50,
            Self::Liris => 5,
            Self::Quick | Self::Blind => 10,
        }
    }
}

impl fmt::Display for Grid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Grid {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|grid| grid.name() == name);
        named.ok_or_else(|| format!("unknown grid {name:?}: it is paper, liris, quick or blind"))
    }
}

/// The caller's list, or the grid's.
fn or<T: Copy>(chosen: &[T], otherwise: &[T]) -> Vec<T> {
    if chosen.is_empty() { otherwise.to_vec() } else { chosen.to_vec() }
}

/// Every method with every strength and number of bits.
fn settings(choices: &Choices, closed_loop: bool, budget: Option<f64>) -> Vec<Setting> {
    let mut all = Vec::new();
    for &bits in &choices.bits {
        for &strength in &choices.strengths {
            let layers = Layers::Blind;
            let of =
                |&method: &Method| Setting { method, strength, bits, closed_loop, budget, layers };
            all.extend(choices.methods.iter().map(of));
        }
    }
    all
}

/// The strengths of a list, without those out of range.
fn strengths(list: &[f64]) -> Vec<Strength> {
    list.iter().filter_map(|&alpha| Strength::new(alpha).ok()).collect()
}

/// The numbers of bits of a list, without those out of range.
fn bit_counts(list: &[u32]) -> Vec<BitCount> {
    list.iter().filter_map(|&bits| BitCount::new(bits).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_read_back_by_name_and_ask_for_something() {
        for grid in Grid::ALL {
            assert_eq!(grid.name().parse::<Grid>(), Ok(grid));
            for experiment in grid.experiments(&Choices::default()) {
                let name = experiment.name;
                assert!(
                    !experiment.settings.is_empty() && !experiment.attacks.is_empty(),
                    "{name}"
                );
                assert_eq!(experiment.attacks[0], Attack::None, "{name}");
            }
        }
        assert!("papers".parse::<Grid>().is_err());
    }

    /// Independent of the service's default.
    #[test]
    fn the_paper_marks_with_its_own_strength() {
        for experiment in Grid::Paper.experiments(&Choices::default()) {
            let all = experiment.settings.iter().map(|s| s.strength.get());
            let own = all.clone().filter(|&strength| (strength - 0.1).abs() < 1e-12).count();
            assert!(own == all.count() || experiment.name == "figure 10a", "{}", experiment.name);
        }
    }

    #[test]
    fn choices_replace_what_the_grid_has() {
        let choices = Choices {
            methods: vec![Method::ChoVar],
            strengths: strengths(&[0.05, 0.2, 7.0]),
            bits: bit_counts(&[32]),
        };
        let quick = Grid::Quick.experiments(&choices);
        assert_eq!(quick[0].settings.len(), 2);
        for grid in Grid::ALL {
            for experiment in grid.experiments(&choices) {
                let all = experiment.settings.iter();
                assert!(all.clone().all(|s| s.method == Method::ChoVar), "{}", experiment.name);
            }
        }
    }
}
