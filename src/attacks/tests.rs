//! Each attack on small generated meshes: what it must keep and what it must change.

use super::*;
use crate::attacks::crop::Of;
use crate::attacks::edges::Edges;
use crate::attacks::remesh::Remeshing;
use crate::mesh::distortion::distortion;
use crate::mesh::surface::Surface;
use crate::sample::Sample;
use crate::watermark::{EmbedParams, extract};

fn blob() -> Mesh {
    Sample::Blob.mesh(3000).unwrap()
}

/// An octahedron without one of its upper triangles. It has a border and irregular vertices.
fn open_octahedron() -> Mesh {
    let p = DVec3::new;
    let positions = vec![
        p(1.0, 0.0, 0.0),
        p(0.0, 1.0, 0.0),
        p(-1.0, 0.0, 0.0),
        p(0.0, -1.0, 0.0),
        p(0.0, 0.0, 1.0),
        p(0.0, 0.0, -1.0),
    ];
    let triangles =
        vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]];
    Mesh::new(positions, triangles).unwrap()
}

/// V - E + F, and the number of edges that are not between two triangles.
fn topology(mesh: &Mesh) -> (i64, usize) {
    let edges = Edges::new(mesh.triangles());
    let count = |n: usize| i64::try_from(n).unwrap();
    let open = edges.count.iter().filter(|&&n| n != 2).count();
    (count(mesh.positions().len()) - count(edges.ends.len()) + count(mesh.triangles().len()), open)
}

fn relative_mrms(a: &Mesh, b: &Mesh) -> f64 {
    let d = distortion(&Surface::new(a), &Surface::new(b), 20_000).unwrap();
    d.mrms / d.diagonal
}

const ALL: [Attack; 27] = [
    Attack::None,
    Attack::Noise(0.003),
    Attack::UniformNoise(0.003),
    Attack::Smooth { lambda: 0.5, iterations: 5 },
    Attack::Quantise(9),
    Attack::Simplify(0.5),
    Attack::Remesh(0.6),
    Attack::Midpoint,
    Attack::Butterfly,
    Attack::Loop,
    Attack::Sqrt3,
    Attack::Crop(0.3, Of::Vertices),
    Attack::Crop(0.3, Of::Area),
    Attack::Similarity,
    Attack::Reorder,
    Attack::StrayVertices(20),
    Attack::Spikes { count: 3, height: 0.05 },
    Attack::Collude(2),
    Attack::ReMark,
    Attack::RoundTrip,
    Attack::Smooth { lambda: 0.1, iterations: 30 },
    Attack::Taubin(10),
    Attack::Cotangent { lambda: 0.5, iterations: 3 },
    Attack::Voxel(0.02),
    Attack::Fragment(0.1),
    Attack::Scan(0.0005),
    Attack::Pipeline(2),
];

#[test]
fn the_same_seed_gives_the_same_mesh_on_any_number_of_threads() {
    let host = Sample::Blob.mesh(6000).unwrap();
    let bits = crate::watermark::BitCount::new(16).unwrap();
    let params = EmbedParams { bits, ..EmbedParams::default() };
    let context = Context { host: &host, params: &params, amplitude: None };
    for attack in ALL {
        let attacked = || attack.apply(&Target::new(&host), &context, 5).unwrap();
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let four = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
        let (a, b) = (one.install(attacked), four.install(attacked));
        assert!(a == b, "{attack}");
        assert_eq!(a == host, attack == Attack::None, "{attack}");
    }
}

#[test]
fn noise_moves_every_vertex_by_what_was_asked() {
    let host = blob();
    let surface = Surface::new(&host);
    let norms: Vec<f64> = surface.positions.iter().map(|p| p.distance(surface.centre())).collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let mean = norms.iter().sum::<f64>() / norms.len() as f64;

    let noisy = noise::unit_vectors(&Target::new(&host), 0.01, 3).unwrap();
    for (a, b) in host.positions().iter().zip(noisy.positions()) {
        assert!((a.distance(*b) / (0.01 * largest) - 1.0).abs() < 1e-9);
    }
    let noisy = noise::uniform_coordinates(&Target::new(&host), 0.01, 3).unwrap();
    let moves: Vec<f64> = host
        .positions()
        .iter()
        .zip(noisy.positions())
        .flat_map(|(a, b)| ((*b - *a) / (0.01 * mean)).to_array())
        .collect();
    assert!(moves.iter().all(|x| x.abs() <= 1.0 + 1e-9));
    let variance = moves.iter().map(|x| x * x).sum::<f64>() / moves.len() as f64;
    assert!((variance - 1.0 / 3.0).abs() < 0.02, "{variance}");
}

#[test]
fn seams_do_not_crack() {
    let whole = blob();
    // Every triangle with corners of its own.
    let corners = whole.triangles().iter().flatten();
    let soup: Vec<DVec3> = corners.map(|&v| whole.positions()[v as usize]).collect();
    let triangles = (0..index(soup.len() / 3)).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let soup = Mesh::new(soup, triangles).unwrap();
    let params = EmbedParams::default();
    let context = Context { host: &soup, params: &params, amplitude: None };
    for attack in ALL {
        if matches!(
            attack,
            Attack::Collude(_)
                | Attack::ReMark
                | Attack::Crop(..)
                | Attack::Fragment(_)
                | Attack::Pipeline(_)
        ) {
            continue;
        }
        let attacked = attack.apply(&Target::new(&soup), &context, 9).unwrap();
        let welded = Surface::new(&attacked);
        let welded = Mesh::new(welded.positions, welded.triangles).unwrap();
        assert_eq!(topology(&welded), (2, 0), "{attack}");
    }
}

#[test]
fn smoothing_draws_to_the_neighbours() {
    // A flat fan with a lifted centre. Its rim is a border and stays in its plane.
    let rim = |k: u32| {
        let angle = std::f64::consts::TAU * f64::from(k) / 6.0;
        DVec3::new(angle.cos(), angle.sin(), 0.0)
    };
    let positions: Vec<DVec3> = std::iter::once(DVec3::Z).chain((0..6).map(rim)).collect();
    let triangles = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
    let fan = Mesh::new(positions, triangles).unwrap();
    let smooth = smooth::laplacian(&Target::new(&fan), 0.25, 2).unwrap();
    assert!((smooth.positions()[0].z - 0.75 * 0.75).abs() < 1e-12);
    // (self + two neighbours at 60 degrees) / 3 is at 2/3 of the radius.
    let radius = smooth.positions()[1].length();
    assert!((radius - (1.0_f64 - 0.25 / 3.0).powi(2)).abs() < 1e-12, "{radius}");
}

/// A ball of radius 1 with a random ripple.
fn rippled_ball() -> Mesh {
    let host = blob();
    let mut random = crate::attacks::random::Random::new(8);
    let rippled = |p: &DVec3| p.normalize() * (1.0 + 0.003 * random.symmetric());
    let positions = host.positions().iter().map(rippled).collect();
    Mesh::new(positions, host.triangles().to_vec()).unwrap()
}

fn mean_radius(mesh: &Mesh) -> f64 {
    mesh.positions().iter().map(|p| p.length()).sum::<f64>() / mesh.positions().len() as f64
}

fn roughness(mesh: &Mesh) -> f64 {
    let mean = mean_radius(mesh);
    let squares = mesh.positions().iter().map(|p| (p.length() - mean).powi(2));
    (squares.sum::<f64>() / mesh.positions().len() as f64).sqrt()
}

#[test]
fn taubin_smoothing_takes_ripples_and_leaves_the_size() {
    let rippled = rippled_ball();
    let target = Target::new(&rippled);
    let taubin = smooth::taubin(&target, smooth::TAUBIN, 50).unwrap();
    let umbrella = smooth::laplacian(&target, 0.5, 50).unwrap();
    assert!(roughness(&taubin) < 0.6 * roughness(&rippled), "{}", roughness(&taubin));
    let shrunk = |mesh: &Mesh| 1.0 - mean_radius(mesh) / mean_radius(&rippled);
    assert!(shrunk(&umbrella) > 0.02, "{}", shrunk(&umbrella));
    assert!(shrunk(&taubin).abs() < 0.25 * shrunk(&umbrella), "{}", shrunk(&taubin));
}

#[test]
fn cotangent_smoothing_moves_along_the_normal_only() {
    // A plane with triangles of many shapes. It has no roughness, so points should hardly move; the
    // umbrella slides every point.
    let n = 12_u32;
    let mut random = crate::attacks::random::Random::new(3);
    let positions = (0..n * n).map(|i| {
        let inner = |x: u32| if (1..n - 1).contains(&x) { 0.25 } else { 0.0 };
        let [x, y] = [i % n, i / n];
        let wobble = |random: &mut crate::attacks::random::Random| {
            inner(x) * inner(y) * 4.0 * random.symmetric()
        };
        DVec3::new(f64::from(x) + wobble(&mut random), f64::from(y) + wobble(&mut random), 0.0)
    });
    let triangles = (0..n - 1).flat_map(|y| {
        (0..n - 1).flat_map(move |x| {
            let v = y * n + x;
            [[v, v + 1, v + n + 1], [v, v + n + 1, v + n]]
        })
    });
    let plane = Mesh::new(positions.collect(), triangles.collect()).unwrap();
    let target = Target::new(&plane);
    let inner = |v: usize| (3..9).contains(&(v % 12)) && (3..9).contains(&(v / 12));
    let slid = |mesh: &Mesh| {
        let pairs = mesh.positions().iter().zip(plane.positions()).enumerate();
        pairs.filter(|(v, _)| inner(*v)).map(|(_, (a, b))| a.distance(*b)).fold(0.0, f64::max)
    };
    let even = cotangent::cotangent(&target, 0.5, 1).unwrap();
    let umbrella = smooth::laplacian(&target, 0.5, 1).unwrap();
    assert!(slid(&umbrella) > 0.1);
    assert!(slid(&even) < 0.5 * slid(&umbrella), "{} {}", slid(&even), slid(&umbrella));

    let rippled = rippled_ball();
    let smooth = cotangent::cotangent(&Target::new(&rippled), 0.5, 10).unwrap();
    assert!(roughness(&smooth) < 0.6 * roughness(&rippled), "{}", roughness(&smooth));
}

#[test]
fn voxel_extraction_gives_a_new_closed_surface_within_a_cell() {
    for (sample, euler) in [(Sample::Blob, 2), (Sample::Knot, 0), (Sample::Gear, 0)] {
        let host = sample.mesh(6000).unwrap();
        let diagonal = Surface::new(&host).diagonal();
        for share in [0.02, 0.01] {
            let new = voxel::voxel(&Target::new(&host), share, 4).unwrap();
            assert_eq!(topology(&new), (euler, 0), "{sample} {share}");
            let d = distortion(&Surface::new(&host), &Surface::new(&new), 20_000).unwrap();
            assert!(d.hausdorff < share * diagonal, "{sample} {share}: {}", d.hausdorff);
            assert!(d.mrms < 0.3 * share * diagonal, "{sample} {share}: {}", d.mrms);
        }
        let [one, other] = [1, 2].map(|seed| voxel::voxel(&Target::new(&host), 0.02, seed));
        assert_ne!(one, other);
    }
}

#[test]
fn a_scan_lies_on_the_old_surface_to_within_its_noise() {
    for (sample, euler) in [(Sample::Blob, 2), (Sample::Knot, 0)] {
        let host = sample.mesh(6000).unwrap();
        let diagonal = Surface::new(&host).diagonal();
        let mrms = [0.0, 0.0005].map(|noise| {
            let how = scan::Scanning { points: 40_000, noise, cells: 128.0 };
            let new = scan::scan(&Target::new(&host), &how, 4).unwrap();
            assert_eq!(topology(&new), (euler, 0), "{sample} {noise}");
            let d = distortion(&Surface::new(&host), &Surface::new(&new), 20_000).unwrap();
            assert!(d.hausdorff < diagonal / 128.0, "{sample} {noise}: {}", d.hausdorff);
            d.mrms / diagonal
        });
        // Some fifty points are fitted together, so their noise is averaged.
        assert!(mrms[1] < 0.0004 && mrms[0] < mrms[1], "{sample}: {mrms:?}");
    }
}

#[test]
fn pipelines_are_three_attacks_of_different_families() {
    let mut names = Vec::new();
    for number in 0..100 {
        let families = pipeline::steps(number).map(|step| step.family());
        assert!(families[0] != families[1] && families[1] != families[2]);
        assert!(families[2] != families[0]);
        names.push(Attack::Pipeline(number).to_string().split_once(':').unwrap().1.to_owned());
    }
    names.sort_unstable();
    names.dedup();
    assert!(names.len() > 90, "{}", names.len());
    let host = blob();
    let params = EmbedParams::default();
    let context = Context { host: &host, params: &params, amplitude: None };
    let steps = [Attack::Simplify(0.5), Attack::Crop(0.3, Of::Vertices)];
    let once = pipeline::in_a_row(&steps, &Target::new(&host), &context, 3).unwrap();
    let mut random = crate::attacks::random::Random::new(3);
    let first = steps[0].apply(&Target::new(&host), &context, random.word()).unwrap();
    let then = steps[1].apply(&Target::new(&first), &context, random.word()).unwrap();
    assert_eq!(once, then);
}

/// Two overlapping blobs, and two cubes that touch in a face.
#[test]
fn voxel_extraction_makes_one_of_parts_that_touch_or_overlap() {
    let blob = Sample::Blob.mesh(3000).unwrap();
    let diagonal = Surface::new(&blob).diagonal();
    let beside = |shift: DVec3| {
        let moved = blob.positions().iter().map(|&p| p + shift);
        let count = index(blob.positions().len());
        let again = blob.triangles().iter().map(|t| t.map(|v| v + count));
        let positions = blob.positions().iter().copied().chain(moved).collect();
        Mesh::new(positions, blob.triangles().iter().copied().chain(again).collect()).unwrap()
    };
    let two = beside(0.15 * diagonal * DVec3::X);
    let new = voxel::voxel(&Target::new(&two), 0.02, 4).unwrap();
    assert_eq!(topology(&new), (2, 0));

    // Stacked cubes. The face between them exists twice.
    let cube = |low: f64| {
        let at = |k: u32| {
            let bit = |by: u32| f64::from(k >> by & 1);
            DVec3::new(bit(0), bit(1), low + bit(2))
        };
        (0..8).map(at).collect::<Vec<DVec3>>()
    };
    let faces =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = |first: u32| {
        faces.iter().flat_map(move |&[a, b, c, d]| {
            [[a, b, c], [a, c, d]].map(|t| t.map(|v: u32| v + first))
        })
    };
    let positions = [cube(0.0), cube(1.0)].concat();
    let tower = Mesh::new(positions, triangles(0).chain(triangles(8)).collect()).unwrap();
    let new = voxel::voxel(&Target::new(&tower), 0.03, 4).unwrap();
    assert_eq!(topology(&new), (2, 0));
    let within = |p: &DVec3| p.z > 0.1 && p.z < 1.9 && p.x.min(p.y) > 0.1 && p.x.max(p.y) < 0.9;
    assert_eq!(new.positions().iter().filter(|&p| within(p)).count(), 0);
}

#[test]
fn voxel_extraction_keeps_open_surfaces_open() {
    let host = Sample::Blob.mesh(6000).unwrap();
    let half = crop::crop(&Target::new(&host), 0.5, Of::Vertices, 1).unwrap();
    let new = voxel::voxel(&Target::new(&half), 0.02, 4).unwrap();
    let cell = 0.02 * Surface::new(&half).diagonal();
    let closest = crate::mesh::closest::Closest::new(&Surface::new(&half)).unwrap();
    assert!(new.positions().iter().all(|&p| closest.distance(p) < cell));
    let back = crate::mesh::closest::Closest::new(&Surface::new(&new)).unwrap();
    assert!(half.positions().iter().all(|&p| back.distance(p) < 2.0 * cell));
    let (euler, open) = topology(&new);
    assert!(euler == 1 && open > 50, "{euler} {open}");
}

#[test]
fn a_fragment_is_the_asked_share_around_one_place() {
    let host = Sample::Knot.mesh(5000).unwrap();
    let diagonal = Surface::new(&host).diagonal();
    for share in [0.1, 0.02] {
        let [one, other] =
            [1, 2].map(|seed| fragment::fragment(&Target::new(&host), share, seed).unwrap());
        assert_ne!(one, other);
        assert_eq!(one.triangles().len(), share_of(host.triangles().len(), share));
        assert!(Surface::new(&one).diagonal() < 0.7 * diagonal);
        assert!(one.positions().iter().all(|p| host.positions().contains(p)));
    }
    let least = fragment::fragment(&Target::new(&host), 0.0, 1).unwrap();
    assert_eq!(least.triangles().len(), 1);
}

#[test]
fn quantised_coordinates_lie_on_a_grid_of_the_asked_size() {
    let quantised = quantise::quantise(&blob(), 4).unwrap();
    let mut levels: Vec<f64> = quantised.positions().iter().map(|p| p.y).collect();
    levels.sort_unstable_by(f64::total_cmp);
    levels.dedup();
    assert!(levels.len() <= 16 && levels.len() > 10, "{}", levels.len());
    let flat = Mesh::new(vec![DVec3::ONE; 3], vec![[0, 1, 2]]).unwrap();
    assert_eq!(quantise::quantise(&flat, 8).unwrap(), flat);
}

#[test]
fn simplification_reaches_its_share_and_stays_near() {
    let host = Sample::Knot.mesh(6000).unwrap();
    for (share, most) in [(0.1, 2e-4), (0.5, 1e-3), (0.9, 8e-3)] {
        let less = simplify::simplify(&Target::new(&host), share).unwrap();
        let kept = less.triangles().len() as f64 / host.triangles().len() as f64;
        assert!((kept - (1.0 - share)).abs() < 1e-3, "{share}: {kept}");
        assert_eq!(topology(&less), (0, 0));
        let mrms = relative_mrms(&host, &less);
        assert!(mrms < most, "{share}: {mrms:e}");
    }
}

#[test]
fn remeshing_gives_even_triangles_of_the_asked_number() {
    for (sample, euler, most) in
        [(Sample::Blob, 2, 2e-3), (Sample::Knot, 0, 3e-3), (Sample::Gear, 0, 4e-3)]
    {
        let host = sample.mesh(6000).unwrap();
        for share in [1.0, 0.4] {
            let new = remesh::remesh(&Target::new(&host), &Remeshing::to_share(share)).unwrap();
            let got = new.positions().len() as f64 / host.positions().len() as f64;
            assert!((got / share - 1.0).abs() < 0.05, "{sample} {share}: {got}");
            assert_eq!(topology(&new), (euler, 0), "{sample} {share}");
            let mrms = relative_mrms(&host, &new);
            assert!(mrms < most, "{sample} {share}: {mrms:e}");
            let lengths = edge_lengths(&new);
            let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
            let even = lengths.iter().filter(|&&l| (0.6 * mean..1.5 * mean).contains(&l)).count();
            let even = even as f64 / lengths.len() as f64;
            assert!(even > 0.9, "{sample} {share}: {even}");
        }
    }
}

fn edge_lengths(mesh: &Mesh) -> Vec<f64> {
    let at = |v: u32| mesh.positions()[v as usize];
    Edges::new(mesh.triangles()).ends.iter().map(|&[a, b]| at(a).distance(at(b))).collect()
}

#[test]
fn remeshing_keeps_creases_and_borders() {
    let host = open_octahedron();
    let new = remesh::remesh(&Target::new(&host), &Remeshing::to_share(60.0)).unwrap();
    // All edges of an octahedron are creases: its surface is reproduced.
    assert!(relative_mrms(&host, &new) < 1e-9);
    assert_eq!(topology(&new).0, 1);
    assert!(new.positions().len() > 200, "{}", new.positions().len());
}

#[test]
fn subdivision_multiplies_triangles_and_keeps_the_topology() {
    type Scheme = fn(&Target<'_>) -> Result<Mesh, AttackError>;
    let schemes: [(&str, Scheme, usize, f64); 4] = [
        ("midpoint", subdivide::midpoint, 4, 1e-12),
        ("butterfly", subdivide::butterfly, 4, 2e-3),
        ("loop", subdivide::loop_scheme, 4, 3e-3),
        ("sqrt3", subdivide::sqrt3, 3, 4e-3),
    ];
    for (name, scheme, times, most) in schemes {
        let (host, open) = (blob(), open_octahedron());
        let finer = scheme(&Target::new(&host)).unwrap();
        assert_eq!(finer.triangles().len(), times * host.triangles().len(), "{name}");
        assert_eq!(topology(&finer), (2, 0), "{name}");
        let mrms = relative_mrms(&host, &finer);
        assert!(mrms < most, "{name}: {mrms:e}");
        // Triangles keep their orientation, so the volume keeps its sign.
        let volume = |m: &Mesh| -> f64 {
            let corner = |t: &[u32; 3]| t.map(|v| m.positions()[v as usize]);
            m.triangles().iter().map(corner).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
        };
        assert!((volume(&finer) / volume(&host) - 1.0).abs() < 0.02, "{name}");
        let finer = scheme(&Target::new(&open)).unwrap();
        assert_eq!(topology(&finer).0, 1, "{name}");
    }
}

#[test]
fn interpolating_schemes_keep_old_vertices_and_planes() {
    let host = blob();
    let finer = subdivide::butterfly(&Target::new(&host)).unwrap();
    assert_eq!(finer.positions()[..host.positions().len()], *host.positions());
    // Inside a regular grid, a plane stays a plane under every scheme.
    let n = 8_u32;
    let positions = (0..n * n).map(|i| DVec3::new(f64::from(i % n), f64::from(i / n), 0.0));
    let triangles = (0..n - 1).flat_map(|y| {
        (0..n - 1).flat_map(move |x| {
            let v = y * n + x;
            [[v, v + 1, v + n + 1], [v, v + n + 1, v + n]]
        })
    });
    let plane = Mesh::new(positions.collect(), triangles.collect()).unwrap();
    for scheme in [subdivide::butterfly, subdivide::loop_scheme, subdivide::sqrt3] {
        let finer = scheme(&Target::new(&plane)).unwrap();
        let middle = DVec3::new(3.5, 3.5, 0.0);
        let spacing = if finer.positions().len() > 200 { 0.5 } else { 1.0 / 3.0 };
        for p in finer.positions().iter().filter(|p| p.distance(middle) < 2.0) {
            let off = ((*p / spacing).round() * spacing).distance(*p);
            assert!(off < 1e-12, "{p}");
        }
    }
}

#[test]
fn cropping_takes_the_share_away_on_one_side() {
    let host = Sample::Knot.mesh(5000).unwrap();
    for share in [0.1, 0.5, 0.9] {
        let cut = crop::crop(&Target::new(&host), share, Of::Vertices, 11).unwrap();
        let kept = cut.positions().len() as f64 / host.positions().len() as f64;
        assert!((kept - (1.0 - share)).abs() < 0.03, "{share}: {kept}");
        let area = |m: &Mesh| -> f64 {
            let corners = m.triangles().iter().map(|t| t.map(|v| m.positions()[v as usize]));
            corners.map(|[a, b, c]| (b - a).cross(c - a).length()).sum()
        };
        let cut = crop::crop(&Target::new(&host), share, Of::Area, 11).unwrap();
        let kept = area(&cut) / area(&host);
        assert!((kept - (1.0 - share)).abs() < 1e-3, "{share}: {kept}");
    }
    assert!(crop::crop(&Target::new(&host), 1.0, Of::Vertices, 1).is_err());
}

#[test]
fn what_changes_no_distance_ratio_changes_no_bit() {
    let host = Sample::Blob.mesh(8000).unwrap();
    let params = EmbedParams::default();
    let (key, message) =
        re_mark::key_and_message(&params, &mut crate::attacks::random::Random::new(1)).unwrap();
    let codeword = crate::watermark::Codeword::new(&key, &message);
    let marked = re_mark::mark(&host, &codeword, &params).unwrap();
    let marked = Mesh::new(marked.positions, host.triangles().to_vec()).unwrap();
    let context = Context { host: &host, params: &params, amplitude: None };
    let harmless =
        [Attack::Similarity, Attack::Reorder, Attack::StrayVertices(50), Attack::RoundTrip];
    for attack in harmless {
        let attacked = attack.apply(&Target::new(&marked), &context, 2).unwrap();
        let found = extract(&attacked, &key, params.bits, params.method.modulation()).unwrap();
        let wrong = found.bits.iter().zip(message.bits());
        let wrong = wrong.filter(|(read, meant)| read.is_some_and(|bit| bit != **meant)).count();
        assert_eq!(wrong, 0, "{attack}");
    }
    // Moving the farthest point out spoils the blind reader's range.
    let spiked = Attack::Spikes { count: 1, height: 0.05 }
        .apply(&Target::new(&marked), &context, 2)
        .unwrap();
    let found = extract(&spiked, &key, params.bits, params.method.modulation()).unwrap();
    let right = found.bits.iter().zip(message.bits()).filter(|(r, m)| **r == Some(**m)).count();
    assert!(right < 56, "{right}");
}

#[test]
fn copies_average_to_their_middle_and_strangers_do_not() {
    let host = blob();
    let noisy = noise::unit_vectors(&Target::new(&host), 0.01, 1).unwrap();
    let mean = collude::average(&[&host, &noisy, &noisy, &host]).unwrap();
    for ((a, b), m) in host.positions().iter().zip(noisy.positions()).zip(mean.positions()) {
        assert!(a.midpoint(*b).distance(*m) < 1e-12);
    }
    let other = Sample::Gear.mesh(3000).unwrap();
    assert_eq!(collude::average(&[&host, &other]), Err(AttackError::CopiesDiffer));
    assert_eq!(collude::average(&[]), Err(AttackError::CopiesDiffer));
}

#[test]
fn names_tell_attacks_apart() {
    let mut names: Vec<String> = ALL.iter().map(Attack::to_string).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), ALL.len());
    assert_eq!(Attack::Noise(0.003).amount(), Some(0.3));
    assert_eq!(Attack::Noise(0.0005).to_string(), "noise 0.05 %");
}
