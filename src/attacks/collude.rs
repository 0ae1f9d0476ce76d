//! Averaging of copies with different marks.

use glam::DVec3;

use super::AttackError;
use crate::mesh::Mesh;

/// The mean of copies of one mesh that carry different marks. A colluder who holds several
/// fingerprinted copies averages them (Cox, Kilian, Leighton and Shamoon, *Secure spread spectrum
/// watermarking for multimedia*, IEEE Trans. Image Processing 6(12), 1997, section V).
///
/// # Errors
/// [`AttackError::CopiesDiffer`], also for an empty list.
pub fn average(copies: &[&Mesh]) -> Result<Mesh, AttackError> {
    let (first, rest) = copies.split_first().ok_or(AttackError::CopiesDiffer)?;
    let alike = |copy: &&&Mesh| {
        copy.triangles() == first.triangles() && copy.positions().len() == first.positions().len()
    };
    if !rest.iter().all(|copy| alike(&copy)) {
        return Err(AttackError::CopiesDiffer);
    }
    // Displacements are averaged rather than positions, so that no digits are lost far from the
    // origin.
    let mut moves = vec![DVec3::ZERO; first.positions().len()];
    for copy in rest {
        for ((sum, place), from) in moves.iter_mut().zip(copy.positions()).zip(first.positions()) {
            *sum += *place - *from;
        }
    }
    let count = copies.len() as f64;
    let positions = first.positions().iter().zip(moves).map(|(p, sum)| p + sum / count).collect();
    Ok(Mesh::new(positions, first.triangles().to_vec())?)
}
