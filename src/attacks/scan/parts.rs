//! The connected components of a surface.

use super::super::{AttackError, compacted};
use crate::mesh::Mesh;

/// The mesh without connected components of less than `share` of all triangles. Triangles with a
/// common vertex are connected.
pub fn without_crumbs(mesh: &Mesh, share: f64) -> Result<Mesh, AttackError> {
    let mut parent: Vec<usize> = (0..mesh.positions().len()).collect();
    for triangle in mesh.triangles() {
        let [a, b, c] = triangle.map(|v| root(&mut parent, v as usize));
        let least = a.min(b).min(c);
        for v in [a, b, c] {
            parent[v] = least;
        }
    }
    let mut sizes = vec![0_usize; parent.len()];
    let part: Vec<usize> =
        mesh.triangles().iter().map(|t| root(&mut parent, t[0] as usize)).collect();
    for &part in &part {
        sizes[part] += 1;
    }
    let least = share * mesh.triangles().len() as f64;
    let kept = mesh.triangles().iter().zip(&part);
    let kept = kept.filter(|&(_, &part)| sizes[part] as f64 >= least).map(|(t, _)| *t);
    compacted(mesh.positions(), kept.collect())
}

/// The vertex that represents a vertex's component. Paths are halved on the way (union-find).
fn root(parent: &mut [usize], mut vertex: usize) -> usize {
    while parent[vertex] != vertex {
        parent[vertex] = parent[parent[vertex]];
        vertex = parent[vertex];
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn small_parts_go_and_large_ones_stay() {
        let strip = |from: u32, count: u32| (from..from + count).map(|v| [v, v + 1, v + 2]);
        let positions = (0..40).map(|k| DVec3::new(f64::from(k), f64::from(k * k), 0.0)).collect();
        let triangles = strip(0, 20).chain(strip(30, 2)).chain(strip(35, 3)).collect();
        let mesh = Mesh::new(positions, triangles).unwrap();
        let kept = without_crumbs(&mesh, 0.1).unwrap();
        assert_eq!(kept.triangles().len(), 23);
        assert_eq!(kept.positions().len(), 27);
        assert_eq!(without_crumbs(&mesh, 0.0).unwrap().triangles().len(), 25);
    }
}
