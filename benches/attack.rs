//! Applies one attack to one file and writes a file, for comparison with other programs
//! (`benches/metro/attacks.py`).
//!
//! ```text
//! cargo bench --bench attack -- IN OUT.obj NAME [SEED]
//! cargo bench --bench attack -- IN OUT.obj FAMILY AMOUNT [MORE]
//! ```
//!
//! A name is one of `attacks::named`, such as `voxel-0.5` or `crop-30+noise-0.5`. A wrong name
//! lists them all. Families have the names of that script:
//!
//! `noise 0.003`, `smoothing 0.5 10`, `quantisation 8`, `simplification 0.9`, `remeshing 0.6`,
//! `midpoint`, `butterfly`, `loop`, `sqrt3`, `cropping 0.3`.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a benchmark may stop")]

use std::fmt::Write as _;
use std::time::Instant;

use quadmark::attacks::crop::Of;
use quadmark::attacks::{Attack, Context, Named, Target};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::watermark::EmbedParams;

fn named(family: &str, amounts: &[f64]) -> Attack {
    let amount = || amounts[0];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small counts")]
    let count = |k: usize| amounts[k] as u32;
    match family {
        "noise" => Attack::Noise(amount()),
        "uniform-noise" => Attack::UniformNoise(amount()),
        "smoothing" => Attack::Smooth { lambda: amount(), iterations: count(1) },
        "quantisation" => Attack::Quantise(count(0)),
        "simplification" => Attack::Simplify(amount()),
        "remeshing" => Attack::Remesh(amount()),
        "midpoint" => Attack::Midpoint,
        "butterfly" => Attack::Butterfly,
        "loop" => Attack::Loop,
        "sqrt3" => Attack::Sqrt3,
        "cropping" => Attack::Crop(amount(), Of::Vertices),
        other => panic!("unknown attack {other}"),
    }
}

/// Writes all digits, so that the measurement does not depend on rounding in the file.
fn exact_obj(mesh: &Mesh) -> String {
    let mut text = String::new();
    for p in mesh.positions() {
        writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap();
    }
    for t in mesh.triangles() {
        let [a, b, c] = t.map(|v| v + 1);
        writeln!(text, "f {a} {b} {c}").unwrap();
    }
    text
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let [input, output, name, rest @ ..] = words.as_slice() else {
        eprintln!("IN OUT.obj NAME [SEED]\n{}", Named::help());
        return;
    };
    let numbers: Vec<f64> = rest.iter().map(|word| word.parse().unwrap()).collect();
    let asset = Asset::read(&std::fs::read(input).unwrap(), &Limits::default()).unwrap();
    let context = Context { host: asset.mesh(), params: &EmbedParams::default(), amplitude: None };
    let target = Target::new(asset.mesh());
    let start = Instant::now();
    let attacked = match name.parse::<Named>() {
        Ok(attacks) => {
            let seed = rest.first().map_or(1, |seed| seed.parse().unwrap());
            attacks.apply(&target, &context, seed).unwrap()
        }
        Err(names) if numbers.is_empty() => panic!("{names}"),
        Err(_) => named(name, &numbers).apply(&target, &context, 1).unwrap(),
    };
    eprintln!(
        "{} vertices, {} triangles, {:.2} s",
        attacked.positions().len(),
        attacked.triangles().len(),
        start.elapsed().as_secs_f64()
    );
    std::fs::write(output, exact_obj(&attacked)).unwrap();
}
