//! Published results, for comparison with what was measured.

use crate::lab::summary::Group;

/// Vertices of the meshes of Luo and Bors 2009, section 5.
const VERTICES: [(&str, usize); 3] = [("bunny", 35_947), ("gear", 231_703), ("dragon", 437_645)];

/// Table 1 of Luo and Bors 2009: MRMS x 10^-4 in the meshes' own unit. Columns: `qsp-mean`,
/// `qsp-var`, `cho-mean`, `cho-var`.
const TABLE_1: [(&str, [f64; 4]); 3] = [
    ("bunny", [0.25, 0.17, 0.77, 0.37]),
    ("gear", [447.58, 164.53, 1481.24, 811.89]),
    ("dragon", [0.23, 0.11, 0.85, 0.44]),
];

/// Table 2: detection ratios after butterfly, Loop and midpoint subdivision, methods as above. Only
/// the Loop column has values other than 1.
const TABLE_2_LOOP: [(&str, [f64; 4]); 3] = [
    ("bunny", [0.75, 0.73, 0.73, 0.74]),
    ("gear", [1.0, 1.0, 0.99, 1.0]),
    ("dragon", [1.0, 1.0, 1.0, 1.0]),
];

const METHODS: [&str; 4] = ["qsp-mean", "qsp-var", "cho-mean", "cho-var"];

/// Whether the last part of a mesh's name, after folders, begins with a name of the paper's meshes.
#[must_use]
pub fn is_called(mesh: &str, name: &str) -> bool {
    mesh.rsplit('/').next().is_some_and(|last| last.to_lowercase().starts_with(name))
}

fn in_table(table: &[(&str, [f64; 4])], mesh: &str, method: &str) -> Option<f64> {
    let column = METHODS.iter().position(|&name| name == method)?;
    let (_, row) = table.iter().find(|(name, _)| is_called(mesh, name))?;
    row.get(column).copied()
}

/// Number of vertices of the paper's mesh, for files named after one.
#[must_use]
pub fn vertices(mesh: &str) -> Option<usize> {
    VERTICES.iter().find(|(name, _)| is_called(mesh, name)).map(|(_, count)| *count)
}

/// Whether marks have the strength and number of bits of the paper's tables.
fn is_usual(group: &Group) -> bool {
    (group.strength - 0.1).abs() < 1e-9 && group.bits == 64
}

/// The paper's Table 1, for files named after its meshes.
#[must_use]
pub fn mrms(group: &Group) -> Option<f64> {
    in_table(&TABLE_1, &group.mesh, &group.method).filter(|_| is_usual(group))
}

/// The paper's Table 2.
#[must_use]
pub fn subdivided(group: &Group) -> Option<f64> {
    let row = in_table(&TABLE_2_LOOP, &group.mesh, &group.method).filter(|_| is_usual(group));
    match group.family.as_str() {
        "loop" => row,
        // Columns of ones.
        "butterfly" | "midpoint" => row.map(|_| 1.0),
        _ => None,
    }
}

/// Bit error rates on the LIRIS benchmark's Venus with 64 bits and the perceptual budget: Cho et
/// al. 2007, and Wang, Lavoué, Denis and Baskurt, *Robust and blind mesh watermarking based on
/// volume moments*, Computers and Graphics 35, 2011.
const LIRIS: [(&str, f64, [f64; 2]); 16] = [
    ("uniform-noise", 0.05, [0.01, 0.0]),
    ("uniform-noise", 0.1, [0.03, 0.01]),
    ("uniform-noise", 0.3, [0.13, 0.08]),
    ("uniform-noise", 0.5, [0.28, 0.16]),
    ("smoothing", 5.0, [0.10, 0.0]),
    ("smoothing", 10.0, [0.23, 0.01]),
    ("smoothing", 30.0, [0.38, 0.07]),
    ("smoothing", 50.0, [0.45, 0.14]),
    ("quantisation", 11.0, [0.0, 0.0]),
    ("quantisation", 10.0, [0.04, 0.01]),
    ("quantisation", 9.0, [0.14, 0.01]),
    ("quantisation", 8.0, [0.26, 0.05]),
    ("quantisation", 7.0, [0.46, 0.17]),
    ("midpoint", 0.0, [0.04, 0.0]),
    ("sqrt3", 0.0, [0.14, 0.0]),
    ("loop", 0.0, [0.16, 0.0]),
];

/// Published bit error rates for an attack: Cho et al. 2007, Wang et al. 2011.
#[must_use]
pub fn liris(family: &str, amount: Option<f64>) -> Option<[f64; 2]> {
    let amount = amount.unwrap_or_default();
    let row = LIRIS.iter().find(|(name, a, _)| *name == family && (a - amount).abs() < 1e-9)?;
    Some(row.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::report::test_support::group;

    #[test]
    fn what_was_printed_is_found_by_mesh_and_method() {
        assert_eq!(vertices("Gear_x"), Some(231_703));
        let of = |mesh: &str, method: &str, family: &str| Group {
            mesh: mesh.into(),
            method: method.into(),
            family: family.into(),
            ..group()
        };
        for (mesh, method, expected) in [
            ("bunny", "cho-var", Some(0.37)),
            ("gear_involute_g7", "qsp-mean", Some(447.58)),
            ("horse", "qsp-mean", None),
            ("bunny", "exact-mean", None),
        ] {
            assert_eq!(mrms(&of(mesh, method, "none")), expected, "{mesh} {method}");
        }
        for (mesh, family, expected) in [
            ("Dragon", "midpoint", Some(1.0)),
            ("bunny", "loop", Some(0.73)),
            ("bunny", "sqrt3", None),
        ] {
            assert_eq!(subdivided(&of(mesh, "qsp-var", family)), expected, "{mesh} {family}");
        }
        // Marks unlike the paper's are not compared with it.
        assert_eq!(mrms(&Group { strength: 0.2, ..of("bunny", "cho-var", "none") }), None);
        assert_eq!(subdivided(&Group { bits: 32, ..of("bunny", "qsp-var", "loop") }), None);
        assert_eq!(liris("quantisation", Some(8.0)), Some([0.26, 0.05]));
        assert_eq!(liris("sqrt3", None), Some([0.14, 0.0]));
    }
}
