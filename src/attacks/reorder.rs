//! The same surface in another order.

use super::{AttackError, index};
use crate::attacks::random::Random;
use crate::mesh::Mesh;

/// Puts vertices and triangles in a random order and begins each triangle at a random corner. A
/// reader that depends on the surface alone must not be affected (Luo and Bors 2009, section 5: the
/// vertex reordering attack).
///
/// # Errors
/// None in practice: the result is a valid mesh.
pub fn reorder(mesh: &Mesh, seed: u64) -> Result<Mesh, AttackError> {
    let mut random = Random::new(seed);
    let mut order: Vec<usize> = (0..mesh.positions().len()).collect();
    random.shuffle(&mut order);
    let mut new_index = vec![0; order.len()];
    for (new, &old) in order.iter().enumerate() {
        new_index[old] = index(new);
    }
    let positions = order.iter().map(|&old| mesh.positions()[old]).collect();
    let mut triangles: Vec<[u32; 3]> = mesh.triangles().to_vec();
    for triangle in &mut triangles {
        *triangle = triangle.map(|vertex| new_index[vertex as usize]);
        triangle.rotate_left(random.below(3));
    }
    random.shuffle(&mut triangles);
    Ok(Mesh::new(positions, triangles)?)
}
