//! The passes of one round of remeshing. Edges are visited in the order of their ends or of their
//! triangles, so that the result depends on the mesh alone.

use glam::DVec3;
use rayon::prelude::*;

use super::super::index;
use super::dynamic::{Dynamic, Wing};
use super::ground::{Foot, Ground};
use crate::mesh::surface::doubled_area;

/// Cosine of the largest turn of a triangle in one step, 60 degrees. A larger turn is a fold.
const LEAST_COSINE: f64 = 0.5;

/// Largest number of halvings in one round. Twenty cut the object's diagonal to a millionth.
const MOST_HALVINGS: usize = 20;

/// Splits edges longer than `longest`, until there are none.
pub fn split(mesh: &mut Dynamic, longest: f64) {
    let mut edges = mesh.edges(|edge| mesh.length(edge) > longest);
    for _ in 0..MOST_HALVINGS {
        // Only edges at new vertices are new. All other long edges have been split.
        let first_new = index(mesh.positions.len());
        for edge in edges {
            let [a, b] = edge.map(|v| mesh.at(v));
            mesh.split(edge, a.midpoint(b));
        }
        edges = mesh.edges_from(first_new, |edge| mesh.length(edge) > longest);
        if edges.is_empty() {
            return;
        }
    }
}

/// Collapses edges shorter than `shortest` where that makes no edge longer than `longest`, folds no
/// triangle and moves no feature.
pub fn collapse(mesh: &mut Dynamic, shortest: f64, longest: f64) {
    let edges = mesh.edges(|edge| mesh.length(edge) < shortest);
    let mut lists = [Vec::new(), Vec::new()];
    for edge in edges {
        let alive = edge.iter().all(|&v| !mesh.around[v as usize].is_empty());
        if !alive || mesh.wings(edge).0 == 0 || mesh.length(edge) >= shortest {
            continue;
        }
        let Some((gone, kept, place)) = merged(mesh, edge) else { continue };
        if is_sound(mesh, [gone, kept], &mut lists)
            && stays_short(mesh, place, longest, &lists)
            && !folds(mesh, gone, kept, place)
            && !folds(mesh, kept, gone, place)
        {
            mesh.collapse(gone, kept, place);
        }
    }
}

/// The removed vertex, the kept vertex and its new position. A smooth vertex is merged into a
/// feature vertex, and a vertex inside a feature curve into the next vertex along the curve. `None`
/// if both must stay.
fn merged(mesh: &Dynamic, [a, b]: [u32; 2]) -> Option<(u32, u32, DVec3)> {
    let degree = |v: u32| mesh.features[v as usize].len();
    match (degree(a), degree(b)) {
        (0, 0) => Some((a, b, mesh.at(a).midpoint(mesh.at(b)))),
        (0, _) => Some((a, b, mesh.at(b))),
        (_, 0) => Some((b, a, mesh.at(a))),
        _ if !mesh.is_feature([a, b]) => None,
        (2, _) => Some((a, b, mesh.at(b))),
        (_, 2) => Some((b, a, mesh.at(a))),
        _ => None,
    }
}

/// The link condition: the ends have no common neighbours but the apexes of the edge's triangles.
/// The neighbours of both ends are written to `lists`.
fn is_sound(mesh: &Dynamic, edge: [u32; 2], lists: &mut [Vec<u32>; 2]) -> bool {
    let (count, wings) = mesh.wings(edge);
    for (list, vertex) in lists.iter_mut().zip(edge) {
        mesh.neighbours(vertex, list);
    }
    let common = lists[0].iter().filter(|v| lists[1].binary_search(v).is_ok()).count();
    // An apex with three triangles would be left with two that coincide.
    let thin = |wing: &Wing| mesh.around[wing.apex as usize].len() <= 3;
    let borders = edge.iter().all(|&v| mesh.border[v as usize]);
    (1..=2).contains(&count)
        && common == count
        && !wings.iter().take(count).any(thin)
        // Two borders must not be joined across the surface.
        && (count == 1 || !borders)
}

fn stays_short(mesh: &Dynamic, place: DVec3, longest: f64, lists: &[Vec<u32>; 2]) -> bool {
    lists.iter().flatten().all(|&v| mesh.at(v).distance(place) <= longest)
}

/// Whether moving `vertex` to `place` folds a triangle. Triangles with the corner `except` are
/// ignored.
fn folds(mesh: &Dynamic, vertex: u32, except: u32, place: DVec3) -> bool {
    mesh.around[vertex as usize].iter().any(|&t| {
        let corners = mesh.triangles[t as usize];
        if corners.contains(&except) {
            return false;
        }
        let [a, b, c] = corners.map(|v| if v == vertex { place } else { mesh.at(v) });
        turns_too_far(mesh.normal(t), doubled_area(a, b, c))
    })
}

fn turns_too_far(before: DVec3, after: DVec3) -> bool {
    let lengths = before.length() * after.length();
    // Also true if the new triangle has no area. An old triangle without area may take any
    // orientation.
    before != DVec3::ZERO && before.dot(after) <= LEAST_COSINE * lengths
}

/// Flips edges where that brings vertices nearer to six neighbours (four at a border).
pub fn flip(mesh: &mut Dynamic) {
    for triangle in 0..index(mesh.triangles.len()) {
        for k in 0..3 {
            // Each edge is visited from the triangle that runs along it from the lower to the
            // higher index. An earlier flip may have changed the corners of this triangle.
            let corners = mesh.triangles[triangle as usize];
            let [a, b, c] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
            let first = Wing { triangle, apex: c };
            if a < b
                && let Some(second) = mesh.across(triangle, [a, b])
                && evens_out(mesh, [a, b, c, second.apex])
                && !mesh.is_feature([a, b])
                && is_flat(mesh, [a, b], first, second)
                && !mesh.are_joined(c, second.apex)
            {
                mesh.flip([a, b], first, second);
            }
        }
    }
}

/// Whether flipping the edge a-b to c-d, the other corners of its triangles, brings the four
/// vertices nearer to their target numbers of neighbours.
fn evens_out(mesh: &Dynamic, [a, b, c, d]: [u32; 4]) -> bool {
    let change = |vertex, more| excess(mesh, vertex, more) - excess(mesh, vertex, 0);
    c != d && change(a, -1) + change(b, -1) + change(c, 1) + change(d, 1) < 0
}

/// Squared difference between a vertex's number of neighbours, changed by `more`, and its target.
/// Squares are used rather than absolute values, so that flips at the worse vertex are preferred.
fn excess(mesh: &Dynamic, vertex: u32, more: i64) -> i64 {
    let vertex = vertex as usize;
    let border = i64::from(mesh.border[vertex]);
    let neighbours = i64::try_from(mesh.around[vertex].len()).unwrap_or(i64::MAX / 4) + border;
    (neighbours + more - (6 - 2 * border)).pow(2)
}

/// Whether the two triangles after a flip face the same way as the two before.
fn is_flat(mesh: &Dynamic, [a, b]: [u32; 2], first: Wing, second: Wing) -> bool {
    let before = mesh.normal(first.triangle) + mesh.normal(second.triangle);
    let [a, b, c, d] = [a, b, first.apex, second.apex].map(|v| mesh.at(v));
    let after = [doubled_area(a, d, c), doubled_area(d, b, c)];
    // The normal of a sliver is unreliable.
    let least = 0.02 * before.length();
    after.iter().all(|&n| n.length() > least && !turns_too_far(before, n))
}

/// Moves smooth vertices along the surface to the mean of their neighbours, and projects them onto
/// the original surface.
pub fn relax(mesh: &mut Dynamic, old: &Ground<'_>) {
    let moves = |vertex: usize| !mesh.around[vertex].is_empty() && mesh.features[vertex].is_empty();
    let goals: Vec<Option<Foot>> = (0..mesh.positions.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|vertex| moves(vertex).then(|| old.foot(relaxed(mesh, vertex), mesh.below[vertex])))
        .collect();
    for ((vertex, goal), number) in goals.into_iter().enumerate().zip(0_u32..) {
        let Some(goal) = goal else { continue };
        if !folds(mesh, number, u32::MAX, goal.place) {
            mesh.positions[vertex] = goal.place;
            mesh.below[vertex] = goal.triangle;
        }
    }
}

/// The mean of the neighbours of an inner vertex, projected onto the vertex's tangent plane.
fn relaxed(mesh: &Dynamic, vertex: usize) -> DVec3 {
    let here = mesh.positions[vertex];
    let (mut sum, mut normal) = (DVec3::ZERO, DVec3::ZERO);
    let around = &mesh.around[vertex];
    for &t in around {
        // Each neighbour is in two triangles.
        let corners = mesh.triangles[t as usize].map(|v| mesh.at(v));
        sum += corners[0] + corners[1] + corners[2] - here;
        normal += mesh.normal(t);
    }
    let step = sum / (2.0 * around.len() as f64) - here;
    let normal = normal.normalize_or_zero();
    here + step - normal * normal.dot(step)
}
