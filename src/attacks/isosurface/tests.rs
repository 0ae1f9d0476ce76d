use super::*;
use crate::attacks::edges::Edges;

fn cells_near(grid: &Grid, value: impl Fn(DVec3) -> f64) -> Vec<u64> {
    let steps = -12..12;
    let mut cells = Vec::new();
    for x in steps.clone() {
        for y in steps.clone() {
            for z in steps.clone() {
                let place = grid.cell() * DVec3::new(f64::from(x), f64::from(y), f64::from(z));
                if value(place).abs() < 3.0 * grid.cell() {
                    cells.push(grid.cell_of(place + DVec3::splat(0.5 * grid.cell())));
                }
            }
        }
    }
    cells.sort_unstable();
    cells
}

#[test]
fn a_ball_becomes_a_closed_surface_that_looks_outward() {
    let grid = Grid::new(DVec3::ZERO, 0.1);
    let ball = |p: DVec3| p.length() - 0.777;
    let mesh = extract(&grid, &cells_near(&grid, ball), 1.0 + 1e-6, ball).unwrap();
    let edges = Edges::new(mesh.triangles());
    assert!(edges.count.iter().all(|&count| count == 2));
    let (v, e, f) = (mesh.positions().len(), edges.ends.len(), mesh.triangles().len());
    assert_eq!(v + f, e + 2);
    for triangle in mesh.triangles() {
        let [a, b, c] = triangle.map(|v| mesh.positions()[v as usize]);
        assert!((b - a).cross(c - a).dot(a) > 0.0);
        assert!(ball(a).abs() < 0.01);
    }
}

/// Random values, so that every ambiguous case occurs beside every other.
#[test]
fn any_values_give_edges_of_two_triangles() {
    let grid = Grid::new(DVec3::ZERO, 1.0);
    let value = |p: DVec3| {
        let mut random = crate::attacks::random::Random::derived(1, p.to_array().map(f64::to_bits));
        // Outside at the rim, so that the surface is closed.
        if p.abs().max_element() > 7.5 { 0.4 } else { 0.5 * random.symmetric() }
    };
    let steps = || -9_i32..9;
    let cells = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let mut cells: Vec<u64> =
        cells.map(|c| grid.cell_of(DVec3::from_array(c.map(f64::from)) + 0.5)).collect();
    cells.sort_unstable();
    let mesh = extract(&grid, &cells, 1.0, value).unwrap();
    let edges = Edges::new(mesh.triangles());
    assert!(edges.count.iter().all(|&count| count == 2));
    for edge in 0..edges.ends.len() {
        assert!(edges.inner_sides(edge, mesh.triangles()).is_some());
    }
}

#[test]
fn unknown_corners_and_false_changes_of_sign_leave_it_open() {
    let grid = Grid::new(DVec3::ZERO, 0.1);
    let ball = |p: DVec3| p.length() - 0.777;
    let cells = cells_near(&grid, ball);
    let half = |p: DVec3| if p.x > 0.05 { UNKNOWN } else { ball(p) };
    let flipped = |p: DVec3| if p.x > 0.05 { -ball(p) } else { ball(p) };
    for (value, parts) in [(&half as &(dyn Fn(DVec3) -> f64 + Sync), 1), (&flipped, 2)] {
        let mesh = extract(&grid, &cells, 1.0 + 1e-6, value).unwrap();
        let edges = Edges::new(mesh.triangles());
        assert!(edges.count.iter().all(|&count| count <= 2));
        assert!(edges.borders().count() > 20 * parts);
        assert!(mesh.positions().iter().all(|&p| ball(p).abs() < 0.01));
    }
    assert_eq!(extract(&grid, &cells, 1.0, |_| 1.0), Err(AttackError::NoSurface));
}
