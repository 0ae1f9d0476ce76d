//! Suspects that the blind frame cannot read: parts, moved parts and strong noise, without naming a
//! mark.

use serde_json::Value;

use crate::server::{Server, file_form, obj, other_obj};

/// Replaces the vertices of a file's `v` lines by `of` their number and position.
fn with_vertices(file: &[u8], of: impl Fn(usize, [f64; 3]) -> [f64; 3]) -> Vec<u8> {
    let text = std::str::from_utf8(file).unwrap();
    let mut number = 0;
    let mut line = |line: &str| match line.strip_prefix("v ") {
        None => format!("{line}\n"),
        Some(rest) => {
            let mut numbers = rest.split(' ').map(|x| x.parse().unwrap());
            let [x, y, z] = of(number, std::array::from_fn(|_| numbers.next().unwrap()));
            number += 1;
            format!("v {x:.9} {y:.9} {z:.9}\n")
        }
    };
    text.lines().map(&mut line).collect::<String>().into_bytes()
}

fn vertices(file: &[u8]) -> Vec<[f64; 3]> {
    let text = std::str::from_utf8(file).unwrap();
    let numbers = |rest: &str| {
        let mut numbers = rest.split(' ').map(|x| x.parse().unwrap());
        std::array::from_fn(|_| numbers.next().unwrap())
    };
    text.lines().filter_map(|line| line.strip_prefix("v ")).map(numbers).collect()
}

/// The faces on one side of a plane, with `percent` percent of the vertices.
fn part(file: &[u8], percent: usize) -> Vec<u8> {
    let along: Vec<f64> = vertices(file).iter().map(|[x, y, z]| x + 0.6 * y - 0.3 * z).collect();
    let mut sorted = along.clone();
    sorted.sort_by(f64::total_cmp);
    let plane = sorted[sorted.len() * percent / 100];
    let inside = |corner: &str| {
        along[corner.split('/').next().unwrap().parse::<usize>().unwrap() - 1] < plane
    };
    let kept = |line: &&str| line.strip_prefix("f ").is_none_or(|face| face.split(' ').all(inside));
    let text = std::str::from_utf8(file).unwrap();
    text.lines().filter(kept).flat_map(|line| [line, "\n"]).collect::<String>().into_bytes()
}

/// Turned about two axes, scaled to 0.3, and moved.
fn moved(file: &[u8]) -> Vec<u8> {
    let (s, c) = 1.1_f64.sin_cos();
    let (t, d) = 0.4_f64.sin_cos();
    with_vertices(file, |_, [x, y, z]| {
        let (x, y) = (c * x - s * y, s * x + c * y);
        let (y, z) = (d * y - t * z, t * y + d * z);
        [0.3 * x + 5.0, 0.3 * y - 2.0, 0.3 * z + 1.0]
    })
}

/// Moves each vertex by up to this share of the object's size on each axis.
fn noisy(file: &[u8], share: f64) -> Vec<u8> {
    let all = vertices(file);
    let size = all.iter().flatten().fold(0.0_f64, |size, x| size.max(x.abs()));
    let random = |k: f64| 2.0 * ((k.sin() * 43_758.545_3).fract().abs() - 0.5);
    with_vertices(file, |v, [x, y, z]| {
        let seed = 3.0 * v as f64 + 1.0;
        let by = |x: f64, k: f64| x + share * size * random(12.9898 * (seed + k));
        [by(x, 0.0), by(y, 1.0), by(z, 2.0)]
    })
}

fn assert_found(verdict: &Value, id: &str, frame: &str, what: &str) {
    assert_eq!(verdict["verdict"], "match", "{what}: {verdict}");
    let best = &verdict["matches"][0];
    assert_eq!((&best["watermark_id"], &best["frame"]), (&id.into(), &frame.into()), "{what}");
    let how = &best["evidence"];
    let counted = how["counted"].as_f64().unwrap() * how["charged"].as_f64().unwrap();
    let fp = how["log10_bound"].as_f64().unwrap() + counted.log10();
    assert!((fp - best["log10_fp"].as_f64().unwrap()).abs() < 1e-9, "{what}: {verdict}");
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_and_wrecks_are_recognised_without_being_named_also_after_a_restart() {
    let mut server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    server.mark(other_obj(), "other").await;
    for restarted in [false, true] {
        let half = part(&file, 50);
        assert_found(&server.verify(file_form(&half)).await, &id, "in_place", "half, in place");
        let gone = moved(&half);
        let verdict = server.verify(file_form(&gone)).await;
        assert_found(&verdict, &id, "registered", "half, moved");
        let wild = noisy(&file, 0.015);
        let verdict = server.verify(file_form(&wild)).await;
        assert_found(&verdict, &id, "in_place", "noise of 1.5 %, order kept");
        assert_eq!(verdict["matches"][0]["evidence"]["stage"], "matched_filter");
        // The depth `fast` uses no host.
        let fast = server.verify(file_form(&gone).text("depth", "fast")).await;
        assert_eq!(fast["verdict"], "no_match", "{fast}");
        if !restarted {
            server = server.restart().await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn hosts_under_attack_and_revoked_marks_do_not_match() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    for (what, suspect) in [
        ("the host", obj().to_vec()),
        ("half of it", part(obj(), 50)),
        ("half of it, moved", moved(&part(obj(), 50))),
        ("its noisy copy", noisy(obj(), 0.02)),
        ("another shape's half", part(other_obj(), 50)),
    ] {
        let verdict = server.verify(file_form(&suspect).text("depth", "exhaustive")).await;
        assert_eq!(verdict["verdict"], "no_match", "{what}: {verdict}");
    }
    let half = moved(&part(&file, 50));
    assert_eq!(server.verify(file_form(&half)).await["verdict"], "match");
    let path = server.url(&format!("/v1/watermarks/{id}"));
    assert!(server.client.delete(path).send().await.unwrap().status().is_success());
    let verdict = server.verify(file_form(&half)).await;
    assert_eq!(verdict["verdict"], "no_match", "{verdict}");
}
