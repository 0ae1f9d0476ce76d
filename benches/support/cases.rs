//! What happens to suspects in the acceptance table of detection, and the share that must be
//! recognised.

use quadmark::attacks::random::Random;
use quadmark::attacks::{Attack, AttackError, Context, Named, Target};
use quadmark::mesh::Mesh;

/// Suffix of the name of a case whose suspects keep their pose. All others are moved at the end.
const IN_PLACE: &str = "+in-place";

/// The rows that must always be recognised, and those that the relief is for; with the required
/// share, if there is one.
#[rustfmt::skip]
const ACCEPTANCE: &[(&str, Option<f64>)] = &[
    ("none+in-place", Some(1.0)), ("none", Some(1.0)), ("reordered", Some(1.0)),
    ("obj-glb", Some(1.0)),
    ("noise-0.1+in-place", Some(1.0)), ("noise-0.3+in-place", Some(1.0)),
    ("noise-0.5+in-place", Some(1.0)), ("noise-0.5+reordered", Some(1.0)),
    ("noise-2+in-place", None),
    ("bits-10+in-place", Some(1.0)), ("bits-8+in-place", Some(1.0)), ("bits-7+in-place", Some(1.0)),
    ("bits-6+in-place", Some(1.0)), ("bits-5+in-place", Some(1.0)), ("bits-4+in-place", Some(1.0)),
    ("midpoint+in-place", Some(1.0)), ("loop+in-place", Some(1.0)),
    ("spike-1+in-place", Some(1.0)), ("stray-10+in-place", Some(1.0)),
    ("simplified-50", Some(1.0)),
    ("crop-10", Some(1.0)), ("crop-30", Some(1.0)), ("crop-50", Some(1.0)),
    ("crop-80+in-place", Some(1.0)), ("crop-80", None), ("crop-50+noise-0.5", Some(1.0)),
    ("smoothed-1", Some(1.0)), ("smoothed-10", Some(1.0)), ("smoothed-20", Some(1.0)),
    ("taubin-50", Some(1.0)), ("cotangent-10", None), ("cotangent-20", None),
    ("simplified-75", Some(1.0)), ("simplified-90", Some(0.95)), ("simplified-95", Some(0.8)),
    ("remeshed-100", Some(1.0)), ("remeshed-50", Some(1.0)), ("remeshed-25", Some(0.95)),
    ("fragment-10", None), ("fragment-5", Some(0.95)), ("fragment-2", Some(0.8)),
    ("fragment-5+simplified-75", Some(0.6)),
    ("voxel-0.5", Some(1.0)), ("voxel-1", Some(0.9)), ("scan-0.05", Some(0.95)),
    ("overmarked", Some(1.0)),
    ("averaged-3", None), ("averaged-10", Some(1.0)), ("averaged-30", Some(0.9)),
    ("averaged-100", None),
    ("laundered", Some(1.0)),
];

/// Number of pipelines of the acceptance table. Each is applied to one mesh, in turn.
pub const PIPELINES: u32 = 100;

/// How suspects are made and judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A marked copy is attacked, and its record must be named.
    Copy,
    /// The copies of this many recipients are averaged, and each of their records must be named.
    Averaged(u32),
    /// A marked copy is attacked and registered anew by somebody else. The answer must report the
    /// record, or a verification of the new copy must name it.
    Laundered,
    /// All pipelines, each on one mesh.
    Pipelines,
}

/// A row of the table.
#[derive(Debug, Clone)]
pub struct Case {
    pub name: String,
    pub kind: Kind,
    /// The share that must be recognised.
    pub wanted: Option<f64>,
    steps: Vec<Attack>,
}

impl Case {
    /// The case of a name: one or several attacks, `laundered`, `pipelines`, or `averaged-N`.
    pub fn named(name: &str) -> Result<Self, String> {
        let (short, in_place) = match name.strip_suffix(IN_PLACE) {
            Some(short) => (short, true),
            None => (name, false),
        };
        let (of, kind) = match short {
            "laundered" => ("crop-30+noise-0.5", Kind::Laundered),
            "pipelines" => ("none", Kind::Pipelines),
            other => (other, Kind::Copy),
        };
        let mut steps = of.parse::<Named>()?.steps().to_vec();
        let kind = match *steps.as_slice() {
            [Attack::Collude(copies)] => {
                steps.clear();
                Kind::Averaged(copies)
            }
            _ => kind,
        };
        steps.retain(|step| *step != Attack::None);
        if !in_place {
            steps.push(Attack::Similarity);
        }
        let listed = ACCEPTANCE.iter().find(|(listed, _)| *listed == name);
        let wanted = listed.and_then(|&(_, wanted)| wanted);
        Ok(Self { name: name.to_owned(), kind, wanted, steps })
    }

    /// All rows of the acceptance table. Those that register further marks come last.
    pub fn acceptance() -> Vec<Self> {
        let names = ACCEPTANCE.iter().map(|&(name, _)| name);
        let (last, mut all): (Vec<Self>, Vec<Self>) = names
            .chain(["pipelines"])
            .map(|name| Self::named(name).unwrap())
            .partition(|case| matches!(case.kind, Kind::Averaged(_) | Kind::Laundered));
        all.extend(last);
        all
    }

    /// One pipeline, as a case.
    pub fn pipeline(number: u32) -> Self {
        Self::named(&format!("pipeline-{number}")).unwrap()
    }

    /// Whether the file is verified as it is.
    pub fn is_nothing(&self) -> bool {
        self.steps.is_empty()
    }

    /// Applies the attacks to a mesh. The same names, trial and seed give the same mesh.
    pub fn apply(
        &self,
        mesh: &Mesh,
        context: &Context<'_>,
        (of, trial): (&str, u64),
        seed: u64,
    ) -> Result<Mesh, AttackError> {
        let mut random = Random::derived(seed, [hash(of), trial, hash(&self.name)]);
        self.steps.iter().try_fold(mesh.clone(), |now, step| {
            step.apply(&Target::new(&now), context, random.word())
        })
    }
}

/// FNV-1a.
fn hash(name: &str) -> u64 {
    let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    name.bytes().fold(0xcbf2_9ce4_8422_2325, step)
}
