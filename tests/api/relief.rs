//! The relief: what is left of a mark when its surface was remeshed, cut or averaged, and marks of
//! meshes that the blind layer cannot use.

use glam::DVec3;
use quadmark::attacks::crop::Of;
use quadmark::attacks::{Attack, Context, Target, collude};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::sample::{to_glb, to_obj};
use quadmark::watermark::EmbedParams;
use serde_json::Value;

use crate::server::{Server, file_form, obj, other_obj, problem};

fn mesh(file: &[u8]) -> Mesh {
    Asset::read(file, &Limits::default()).unwrap().into_mesh()
}

fn attacked(file: &[u8], steps: &[Attack]) -> Mesh {
    let start = mesh(file);
    let params = EmbedParams::default();
    let context = Context { host: &start, params: &params, amplitude: None };
    let step = |(now, seed): (Mesh, u64), attack: &Attack| {
        (attack.apply(&Target::new(&now), &context, seed).unwrap(), seed + 1)
    };
    steps.iter().fold((start.clone(), 7), step).0
}

async fn marked(
    server: &Server,
    host: &[u8],
    fields: &[(&'static str, &'static str)],
) -> (Value, Vec<u8>) {
    let mut form = file_form(host).text("owner_id", "acme");
    for (name, value) in fields {
        form = form.text(*name, *value);
    }
    let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
    let response = request.send().await.unwrap();
    assert_eq!(response.status(), 201, "{}", response.text().await.unwrap());
    let location = response.headers()["location"].to_str().unwrap().to_owned();
    let file = response.bytes().await.unwrap().to_vec();
    (server.get_json(&location).await, file)
}

/// A sphere about the origin, from a cube with `along` squares along each edge.
fn ball(along: u32, round: bool) -> Mesh {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let first = u32::try_from(positions.len()).unwrap();
        for k in 0..(along + 1) * (along + 1) {
            let at = |x: u32| 2.0 * f64::from(x) / f64::from(along) - 1.0;
            let mut p = [0.0; 3];
            p[axis] = sign;
            p[(axis + 1) % 3] = at(k % (along + 1)) * sign;
            p[(axis + 2) % 3] = at(k / (along + 1));
            let p = DVec3::from_array(p);
            positions.push(if round { p.normalize() } else { p });
        }
        for k in 0..along * along {
            let corner = first + k % along + k / along * (along + 1);
            let (right, up) = (corner + 1, corner + along + 1);
            triangles.extend([[corner, right, up + 1], [corner, up + 1, up]]);
        }
    }
    Mesh::new(positions, triangles).unwrap()
}

fn assert_found(verdict: &Value, record: &Value, what: &str) {
    assert_eq!(verdict["verdict"], "match", "{what}: {verdict}");
    assert_eq!(verdict["matches"][0]["watermark_id"], record["id"], "{what}: {verdict}");
}

#[tokio::test(flavor = "multi_thread")]
async fn marks_survive_a_new_surface_and_fragments() {
    let server = Server::start().await;
    let (record, file) = marked(&server, obj(), &[]).await;
    assert_eq!(record["layers"], "both", "{record}");
    assert!(record["quality"]["mrms"].as_f64().unwrap() <= 1e-4, "{record}");
    for (what, steps) in [
        ("remeshed", vec![Attack::Remesh(0.5), Attack::Similarity]),
        ("simplified", vec![Attack::Simplify(0.75), Attack::Similarity]),
        ("a part", vec![Attack::Crop(0.5, Of::Vertices), Attack::Similarity]),
    ] {
        let verdict = server.verify(file_form(&to_glb(&attacked(&file, &steps)))).await;
        assert_found(&verdict, &record, what);
        // The same attack on the host matches nothing.
        let verdict = server.verify(file_form(&to_glb(&attacked(obj(), &steps)))).await;
        assert_eq!(verdict["verdict"], "no_match", "{what}: {verdict}");
    }
    let remeshed = attacked(&file, &[Attack::Remesh(0.5), Attack::Similarity]);
    let verdict = server.verify(file_form(&to_glb(&remeshed))).await;
    let how = &verdict["matches"][0]["evidence"];
    assert_eq!(how["stage"], "relief", "{how}");
    assert_eq!(how["weights"], Value::Array(Vec::new()), "{how}");
}

#[tokio::test(flavor = "multi_thread")]
async fn small_meshes_and_round_ones_carry_the_relief_alone() {
    let server = Server::start().await;
    for (name, host) in [("a sphere", ball(10, true)), ("a cube", ball(8, false))] {
        let host = to_obj(&host);
        let (record, file) = marked(&server, &host, &[("recipient", "one")]).await;
        let (other, _) = marked(&server, &host, &[("recipient", "two")]).await;
        assert_eq!((&record["layers"], &other["layers"]), (&"relief".into(), &"relief".into()));
        assert_eq!(record["usable_bins"], 0);
        assert!(record["quality"]["mrms"].as_f64().unwrap() <= 1e-4, "{name}: {record}");
        for (what, steps) in [
            ("as it is", vec![]),
            ("moved", vec![Attack::Similarity]),
            ("reordered", vec![Attack::Reorder]),
            ("12 bits", vec![Attack::Quantise(12)]),
            ("noise", vec![Attack::Noise(0.0005)]),
            ("converted", vec![Attack::RoundTrip]),
        ] {
            let verdict = server.verify(file_form(&to_glb(&attacked(&file, &steps)))).await;
            assert_found(&verdict, &record, &format!("{name}, {what}"));
            assert_eq!(verdict["matches"].as_array().unwrap().len(), 1, "{name}, {what}");
            let verdict = server.verify(file_form(&to_glb(&attacked(&host, &steps)))).await;
            assert_eq!(verdict["verdict"], "no_match", "{name}, {what}: {verdict}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_of_ten_colluders_is_named() {
    const COPIES: usize = 10;
    let server = Server::start().await;
    let (mut ids, mut copies) = (Vec::new(), Vec::new());
    for _ in 0..COPIES {
        let (record, file) = marked(&server, obj(), &[]).await;
        ids.push(record["id"].clone());
        copies.push(mesh(&file));
    }
    let (stranger, _) = marked(&server, obj(), &[]).await;
    let all: Vec<&Mesh> = copies.iter().collect();
    let mean = collude::average(&all).unwrap();
    let verdict = server.verify(file_form(&to_glb(&mean))).await;
    let named: Vec<&Value> =
        verdict["matches"].as_array().unwrap().iter().map(|found| &found["watermark_id"]).collect();
    for id in &ids {
        assert!(named.contains(&id), "{id} is not among {named:?}");
    }
    assert!(!named.contains(&&stranger["id"]), "{verdict}");
}

#[tokio::test(flavor = "multi_thread")]
async fn layers_are_as_asked_and_a_retry_makes_the_same_bytes() {
    let server = Server::start().await;
    for layers in ["blind", "relief", "both"] {
        let (record, file) = marked(&server, obj(), &[("layers", layers)]).await;
        assert_eq!(record["layers"], layers);
        assert_eq!(record["amplitude"].is_null(), layers == "blind", "{record}");
        let verdict = server.verify(file_form(&file)).await;
        assert_found(&verdict, &record, layers);
        let stage = &verdict["matches"][0]["evidence"]["stage"];
        match layers {
            "relief" => assert_eq!(stage, "relief", "{verdict}"),
            "blind" => assert_ne!(stage, "relief", "{verdict}"),
            _ => {}
        }
        // The file is not kept, so it is made again.
        let send = || async {
            let form = file_form(obj()).text("owner_id", "acme").text("layers", layers);
            let form = form.text("keep_file", "false").text("label", "again");
            let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
            let key = format!("key-{layers}");
            let response = request.header("Idempotency-Key", key).send().await.unwrap();
            assert_eq!(response.status(), 201);
            response.bytes().await.unwrap()
        };
        assert_eq!(send().await, send().await, "{layers}");
    }
    let before = server.get_json("/v1/watermarks").await;
    for (layers, text) in
        [("relief", "keep_host=true"), ("both", "layers=blind"), ("all", "relief")]
    {
        let form = file_form(obj()).text("owner_id", "acme").text("keep_host", "false");
        let request = server.client.post(server.url("/v1/watermarks"));
        let response = request.multipart(form.text("layers", layers)).send().await.unwrap();
        let told = problem(response, 400, "invalid_parameter").await;
        assert!(told["detail"].as_str().unwrap().contains(text), "{told}");
    }
    assert_eq!(server.get_json("/v1/watermarks").await, before);
    let form = file_form(obj()).text("owner_id", "acme").text("keep_host", "false");
    let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
    assert_eq!(request.send().await.unwrap().status(), 201);
    let page = server.get_json("/v1/watermarks?limit=1").await;
    assert_eq!(page["watermarks"][0]["layers"], "blind", "{page}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_carries_neither_layer_is_refused() {
    let server = Server::start().await;
    let form = file_form(&to_obj(&ball(1, false))).text("owner_id", "acme");
    let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
    let told = problem(request.send().await.unwrap(), 422, "insufficient_capacity").await;
    assert!(told["detail"].as_str().unwrap().contains("vertices"), "{told}");
    assert_eq!(server.get_json("/v1/watermarks").await["watermarks"], Value::Array(Vec::new()));
}

/// Another object with the vertex norms of a marked one, which is what a blind reader reads.
fn with_norms_of(marked: &Mesh, other: &Mesh) -> Mesh {
    let norms_about = |mesh: &Mesh, centre: DVec3| -> Vec<f64> {
        mesh.positions().iter().map(|p| p.distance(centre)).collect()
    };
    let centre_of = |mesh: &Mesh| Surface::new(mesh).centre();
    let mut wanted = norms_about(marked, centre_of(marked));
    wanted.sort_by(f64::total_cmp);
    let mut assumed = centre_of(other);
    let mut best: Option<(f64, Mesh)> = None;
    for _ in 0..300 {
        let mut order: Vec<(f64, usize)> =
            norms_about(other, assumed).into_iter().zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut positions = other.positions().to_vec();
        for (rank, &(_, vertex)) in order.iter().enumerate() {
            let norm = wanted[rank * wanted.len() / order.len()];
            positions[vertex] = assumed + (positions[vertex] - assumed).normalize() * norm;
        }
        let made = Mesh::new(positions, other.triangles().to_vec()).unwrap();
        let centre = centre_of(&made);
        let off = centre.distance(assumed);
        assumed += 0.3 * (centre - assumed);
        if best.as_ref().is_none_or(|(least, _)| off < *least) {
            best = Some((off, made));
        }
    }
    // Ranks change with the centre, so the centre moves in small steps at the end.
    let (off, made) = best.unwrap();
    assert!(off < 1e-3, "the centre does not settle: {off}");
    made
}

#[tokio::test(flavor = "multi_thread")]
async fn bits_on_another_object_are_no_match_and_the_shapes_are_told() {
    let server = Server::start().await;
    let (record, file) = marked(&server, obj(), &[]).await;
    let forged = to_glb(&with_norms_of(&mesh(&file), &mesh(other_obj())));
    let verdict = server.verify(file_form(&forged)).await;
    assert_eq!(verdict["verdict"], "blind_only", "{verdict}");
    let best = &verdict["matches"][0];
    assert_eq!(best["watermark_id"], record["id"], "{verdict}");
    assert!(best["on_host"].as_f64().unwrap() < 0.5, "{verdict}");
    // The marked object itself, moved and in another order, is a match.
    for steps in [vec![], vec![Attack::Similarity, Attack::Reorder]] {
        let verdict = server.verify(file_form(&to_glb(&attacked(&file, &steps)))).await;
        assert_found(&verdict, &record, "the marked file");
        assert!(verdict["matches"][0]["on_host"].as_f64().unwrap() > 0.9, "{verdict}");
    }
    // Without the host, the two cannot be distinguished.
    let server = Server::start().await;
    let (record, file) = marked(&server, obj(), &[("keep_host", "false")]).await;
    let forged = to_glb(&with_norms_of(&mesh(&file), &mesh(other_obj())));
    let verdict = server.verify(file_form(&forged)).await;
    assert_found(&verdict, &record, "no host kept");
    assert!(verdict["matches"][0]["on_host"].is_null(), "{verdict}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_that_is_damaged_and_marked_anew_is_found_out() {
    let server = Server::start().await;
    let (first, file) = marked(&server, obj(), &[]).await;
    let steps = [Attack::Crop(0.3, Of::Vertices), Attack::Noise(0.005), Attack::Similarity];
    let laundered = to_obj(&attacked(&file, &steps));
    let (second, again) = marked(&server, &laundered, &[]).await;
    assert_eq!(second["existing_marks"][0]["watermark_id"], first["id"], "{second}");
    // For another recipient the search is not repeated, and the record says the same.
    let (third, _) = marked(&server, &laundered, &[("recipient", "two")]).await;
    assert_eq!(third["existing_marks"][0]["watermark_id"], first["id"], "{third}");
    let verdict = server.verify(file_form(&again)).await;
    let named: Vec<&Value> =
        verdict["matches"].as_array().unwrap().iter().map(|found| &found["watermark_id"]).collect();
    assert!(named.contains(&&second["id"]) && named.contains(&&first["id"]), "{verdict}");
    let form = file_form(&laundered).text("owner_id", "thief").text("on_existing", "reject");
    let request = server.client.post(server.url("/v1/watermarks")).multipart(form);
    problem(request.send().await.unwrap(), 409, "already_marked").await;
}
