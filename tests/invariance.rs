//! Changes that do not affect a mark: another position, size and direction, another order of
//! vertices and faces, another file format. The meshes are generated, so the test runs on every
//! machine.
#![expect(clippy::unwrap_used, reason = "test helpers")]

mod support;

use glam::{DMat3, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::watermark::Method;

use support::{bits_read, mark_named};

fn read(bytes: &[u8]) -> Mesh {
    Asset::read(bytes, &Limits::default()).unwrap().into_mesh()
}

/// Turned, scaled and moved.
fn similar(mesh: &Mesh) -> Mesh {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 1.234);
    let positions = mesh.positions().iter().map(|&p| turn * p * 37.5 + DVec3::new(10.0, -7.0, 2.0));
    Mesh::new(positions.collect(), mesh.triangles().to_vec()).unwrap()
}

/// Vertices and faces in another order; each face starts at another corner.
fn reordered(mesh: &Mesh) -> Mesh {
    // A stride that shares no factor with the count visits everything once.
    let shuffle = |count: usize| {
        let stride = (count / 3..count).find(|&s| greatest_common_divisor(s, count) == 1).unwrap();
        (0..count).map(move |i| i * stride % count)
    };
    let vertices: Vec<usize> = shuffle(mesh.positions().len()).collect();
    let mut new_index = vec![0_u32; vertices.len()];
    for (new, &old) in vertices.iter().enumerate() {
        new_index[old] = u32::try_from(new).unwrap();
    }
    let triangles = shuffle(mesh.triangles().len()).map(|triangle| {
        let [a, b, c] = mesh.triangles()[triangle];
        [b, c, a].map(|corner| new_index[usize::try_from(corner).unwrap()])
    });
    let positions = vertices.iter().map(|&old| mesh.positions()[old]).collect();
    Mesh::new(positions, triangles.collect()).unwrap()
}

fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[test]
fn a_mark_survives_similarity_reordering_and_conversion() {
    for sample in Sample::ALL {
        let host = sample.mesh(20_000).unwrap();
        for (format, host) in [("obj", to_obj(&host)), ("glb", to_glb(&host))] {
            for method in Method::ALL {
                let name = format!("{sample} {method} {format}");
                let marked = mark_named(&name, &host, method).unwrap();
                let mesh = read(&marked.bytes);
                let suspects = [
                    ("as it is", marked.bytes),
                    ("similar", to_obj(&similar(&mesh))),
                    ("similar in single precision", to_glb(&similar(&mesh))),
                    ("reordered", to_glb(&reordered(&mesh))),
                    ("reordered twice", to_obj(&reordered(&reordered(&mesh)))),
                    ("converted there and back", to_obj(&read(&to_glb(&read(&to_obj(&mesh)))))),
                ];
                for (change, bytes) in suspects {
                    let (right, wrong) = bits_read(&name, &bytes, method.modulation());
                    let usable = marked.report.usable_bins;
                    // A vertex at the very end of the range moves with the rounding of a format,
                    // and the bin layout moves with it. At most a poor bin is lost.
                    assert!(wrong == 0 && right + 2 >= usable, "{name}, {change}: {right} {wrong}");
                }
            }
        }
    }
}
