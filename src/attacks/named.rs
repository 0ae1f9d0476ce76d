//! Attacks by stable names, alone or in sequence, as command lines and tables call them.

use std::fmt;
use std::str::FromStr;

use super::crop::Of;
use super::pipeline::in_a_row;
use super::{Attack, AttackError, Context, Target};
use crate::mesh::Mesh;

/// A name, the form of its amount, its meaning, and the attack with a given amount.
type Name = (&'static str, &'static str, &'static str, fn(f64) -> Attack);

/// An amount rounded to a count.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn count(amount: f64) -> u32 {
    amount.clamp(0.0, f64::from(u32::MAX)).round() as u32
}

/// All names. An amount P is in percent, an amount N is a number.
const NAMES: [Name; 26] = [
    ("none", "", "the file as it was handed out", |_| Attack::None),
    ("moved", "", "a random similarity", |_| Attack::Similarity),
    ("reordered", "", "vertices and triangles shuffled", |_| Attack::Reorder),
    ("obj-glb", "", "out into GLB and OBJ and back", |_| Attack::RoundTrip),
    ("noise", "-P", "each vertex moved by P of the largest norm", |p| Attack::Noise(p / 100.0)),
    ("uniform", "-P", "coordinates, up to P of the mean norm", |p| Attack::UniformNoise(p / 100.0)),
    ("bits", "-N", "coordinates rounded to N bits", |n| Attack::Quantise(count(n))),
    ("smoothed", "-N", "Laplacian 0.5, N times", |n| Attack::Smooth {
        lambda: 0.5,
        iterations: count(n),
    }),
    ("taubin", "-N", "Taubin 0.5 and -0.53, N times", |n| Attack::Taubin(count(n))),
    ("cotangent", "-N", "cotangent Laplacian 0.5, N times", |n| Attack::Cotangent {
        lambda: 0.5,
        iterations: count(n),
    }),
    ("simplified", "-P", "P of the triangles removed", |p| Attack::Simplify(p / 100.0)),
    ("remeshed", "-P", "isotropic, to P of the vertices", |p| Attack::Remesh(p / 100.0)),
    ("voxel", "-P", "marching cubes, cells of P of the diagonal", |p| Attack::Voxel(p / 100.0)),
    ("scan", "-P", "from 100,000 points with noise P of the diagonal", |p| Attack::Scan(p / 100.0)),
    ("midpoint", "", "subdivided", |_| Attack::Midpoint),
    ("loop", "", "subdivided by Loop's scheme", |_| Attack::Loop),
    ("sqrt3", "", "subdivided by the square root of three", |_| Attack::Sqrt3),
    ("butterfly", "", "subdivided by the butterfly scheme", |_| Attack::Butterfly),
    ("crop", "-P", "P of the vertices cut off by a plane", |p| {
        Attack::Crop(p / 100.0, Of::Vertices)
    }),
    ("area-crop", "-P", "P of the area cut off", |p| Attack::Crop(p / 100.0, Of::Area)),
    ("fragment", "-P", "P of the triangles around one place", |p| Attack::Fragment(p / 100.0)),
    ("stray", "-N", "N vertices that no triangle uses", |n| Attack::StrayVertices(count(n))),
    ("spike", "-P", "one vertex pulled out by P of its norm", |p| Attack::Spikes {
        count: 1,
        height: p / 100.0,
    }),
    ("averaged", "-N", "mean of N recipients' copies", |n| Attack::Collude(count(n))),
    ("overmarked", "", "a stranger's mark on top", |_| Attack::ReMark),
    ("pipeline", "-N", "three attacks drawn at random by N", |n| Attack::Pipeline(count(n))),
];

/// A sequence of attacks by name, such as `crop-30+noise-0.5`.
#[derive(Debug, Clone, PartialEq)]
pub struct Named {
    name: String,
    steps: Vec<Attack>,
}

impl Named {
    /// The attacks.
    #[must_use]
    pub fn steps(&self) -> &[Attack] {
        &self.steps
    }

    /// Applies the attacks one after the other. The same seed gives the same mesh.
    ///
    /// # Errors
    /// Those of the attacks.
    pub fn apply(
        &self,
        target: &Target<'_>,
        context: &Context<'_>,
        seed: u64,
    ) -> Result<Mesh, AttackError> {
        in_a_row(&self.steps, target, context, seed)
    }

    /// All names with their meanings, one per line.
    #[must_use]
    pub fn help() -> String {
        let line = |&(name, amount, meaning, _): &Name| {
            format!("  {:14}{meaning}\n", [name, amount].concat())
        };
        let lines: String = NAMES.iter().map(line).collect();
        format!(
            "{lines}P is in percent; with + between them, one after the other: crop-30+noise-0.5\n"
        )
    }
}

impl fmt::Display for Named {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl FromStr for Named {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let steps = name.split('+').map(attack).collect::<Result<_, _>>()?;
        Ok(Self { name: name.to_owned(), steps })
    }
}

fn attack(name: &str) -> Result<Attack, String> {
    let of = |&(own, amount, _, attack): &Name| {
        let rest = name.strip_prefix(own)?;
        if amount.is_empty() {
            return rest.is_empty().then(|| attack(0.0));
        }
        let amount: f64 = rest.strip_prefix('-')?.parse().ok()?;
        (amount.is_finite() && amount >= 0.0).then(|| attack(amount))
    };
    let found = NAMES.iter().find_map(of);
    found.ok_or_else(|| format!("no attack is called {name:?}; there are\n{}", Named::help()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_is_one_attack_with_its_amount() {
        let mut all = Vec::new();
        for (name, amount, _, _) in NAMES {
            let full = if amount.is_empty() { name.to_owned() } else { format!("{name}-3") };
            let named: Named = full.parse().unwrap();
            let [attack] = *named.steps() else { panic!("{full}") };
            assert_eq!(named.to_string(), full);
            assert!(Named::help().contains(&format!("{name}{amount}")));
            // The amount matters.
            if !amount.is_empty() {
                assert_ne!(format!("{name}-4").parse::<Named>().unwrap().steps(), [attack]);
            }
            all.push(attack.to_string());
        }
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), NAMES.len());
        assert_eq!("voxel-0.5".parse::<Named>().unwrap().steps(), [Attack::Voxel(0.005)]);
        let two = "crop-30+noise-0.5".parse::<Named>().unwrap();
        assert_eq!(two.steps(), [Attack::Crop(0.3, Of::Vertices), Attack::Noise(0.005)]);
    }

    #[test]
    fn other_words_are_no_attacks() {
        for wrong in
            ["", "noise", "noise-", "noise-x", "none-1", "voxels-1", "crop-30+", "noise--1"]
        {
            assert!(wrong.parse::<Named>().unwrap_err().contains("voxel-P"), "{wrong}");
        }
    }
}
