//! Marking and verifying.

use serde_json::Value;

use crate::server::{Server, file_form, file_part, glb, marked, obj, other_obj, problem};

fn assert_match(verdict: &Value, id: &str) {
    assert_eq!(verdict["verdict"], "match", "{verdict}");
    let best = &verdict["matches"][0];
    assert_eq!(best["watermark_id"], id, "{verdict}");
    assert!(best["log10_fp"].as_f64().unwrap() < -15.0, "{verdict}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_marked_file_is_recognised_also_after_a_restart() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let (other_id, other_file) = server.mark(other_obj(), "other").await;
    assert_ne!(file, obj());
    let verdict = server.verify(file_form(&file)).await;
    assert_match(&verdict, &id);
    assert_eq!(verdict["hypotheses"], 2);
    assert_eq!(verdict["matches"].as_array().unwrap().len(), 1);
    assert_eq!(verdict["matches"][0]["owner_id"], "acme");
    assert_eq!(verdict["matches"][0]["frame"], "blind");
    assert_eq!(verdict["file"]["format"], "obj");
    assert_match(&server.verify(file_form(&other_file)).await, &other_id);
    let again = format!("/v1/verifications/{}", verdict["id"].as_str().unwrap());
    assert_eq!(server.get_json(&again).await, verdict);

    let server = server.restart().await;
    assert_match(&server.verify(file_form(&file)).await, &id);
    assert_match(&server.verify(file_form(&other_file)).await, &other_id);
    assert_eq!(server.get_json(&again).await, verdict);
}

#[tokio::test(flavor = "multi_thread")]
async fn hosts_and_strangers_do_not_match() {
    let server = Server::start().await;
    let nothing = server.verify(file_form(obj())).await;
    assert_eq!((&nothing["verdict"], &nothing["hypotheses"]), (&"no_match".into(), &0.into()));
    let (id, file) = server.mark(obj(), "acme").await;
    let (_, other_file) = server.mark(other_obj(), "other").await;
    let host = server.verify(file_form(obj())).await;
    assert_eq!(host["verdict"], "no_match", "{host}");
    // Another owner's file, asked only about the marks of "acme".
    let form = file_form(&other_file).text("owner_id", "acme");
    let verdict = server.verify(form).await;
    assert_eq!(verdict["verdict"], "no_match", "{verdict}");
    // With the record named, the blind frame is sufficient, so the host's frame is not tried.
    let named = server.verify(file_form(&file).text("watermark_id", id.clone())).await;
    assert_match(&named, &id);
    assert_eq!(named["hypotheses"], 1);
    let owned = server.verify(file_form(&file).text("owner_id", "acme")).await;
    assert_match(&owned, &id);
}

/// The marked file without the part of its surface beyond a plane.
fn cropped(file: &[u8]) -> Vec<u8> {
    let text = std::str::from_utf8(file).unwrap();
    let vertices: Vec<f64> = text
        .lines()
        .filter_map(|line| line.strip_prefix("v "))
        .map(|line| line.split(' ').next().unwrap().parse().unwrap())
        .collect();
    let mut sorted = vertices.clone();
    sorted.sort_by(f64::total_cmp);
    let plane = sorted[sorted.len() * 7 / 10];
    let inside = |corner: &str| {
        let number = corner.split('/').next().unwrap();
        vertices[number.parse::<usize>().unwrap() - 1] < plane
    };
    let kept = |line: &&str| line.strip_prefix("f ").is_none_or(|face| face.split(' ').all(inside));
    text.lines().filter(kept).flat_map(|line| [line, "\n"]).collect::<String>().into_bytes()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_part_is_recognised_in_place_when_its_mark_is_named() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let part = cropped(&file);
    let fast = server.verify(file_form(&part).text("depth", "fast")).await;
    assert_eq!(fast["verdict"], "no_match", "{fast}");
    for (name, value) in [("watermark_id", id.as_str()), ("owner_id", "acme")] {
        let named = server.verify(file_form(&part).text(name, value.to_owned())).await;
        assert_eq!(named["verdict"], "match", "{named}");
        assert_eq!(named["matches"][0]["frame"], "in_place");
        assert_eq!(named["hypotheses"], 2);
        assert_eq!(stages(&named), ["blind", "in_place"]);
    }
}

/// The stages that ran.
fn stages(verdict: &Value) -> Vec<&str> {
    let tried = verdict["stages"].as_array().unwrap();
    tried.iter().map(|stage| stage["stage"].as_str().unwrap()).collect()
}

/// The file with a far triangle, which makes the blind frame useless.
fn with_a_stray(file: &[u8]) -> Vec<u8> {
    [file, b"\nv 90 90 90\nv 90.001 90 90\nv 90 90.001 90\nf -1 -2 -3\n"].concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_explains_itself() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    server.mark(other_obj(), "other").await;
    for (suspect, stage) in [(file.clone(), "blind"), (with_a_stray(&file), "layout_search_near")] {
        let verdict = server.verify(file_form(&suspect)).await;
        assert_eq!(verdict["verdict"], "match", "{verdict}");
        assert_eq!(verdict["depth"], "standard");
        let found = &verdict["matches"][0];
        assert_eq!(found["watermark_id"], id.as_str());
        let how = &found["evidence"];
        let number = |name: &str| how[name].as_f64().unwrap();
        assert_eq!(how["stage"], stage);
        let whole = |name: &str| how[name].as_u64().unwrap();
        assert_eq!(whole("bits_read") + whole("erasures"), 64);
        assert_eq!(how["weights"].as_array().unwrap().len(), 64);
        let tried = verdict["stages"].as_array().unwrap();
        let own = tried.iter().find(|tried| tried["stage"] == stage).unwrap();
        let counted = own["hypotheses"].as_f64().unwrap() / own["error_share"].as_f64().unwrap();
        assert!((number("counted") - counted).abs() < 1e-9);
        let log10_fp = number("log10_bound") + (counted * number("charged")).log10();
        assert!((found["log10_fp"].as_f64().unwrap() - log10_fp).abs() < 1e-9);
        let hypotheses: u64 = tried.iter().map(|tried| tried["hypotheses"].as_u64().unwrap()).sum();
        assert_eq!(verdict["hypotheses"], hypotheses);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_depth_says_what_is_tried() {
    let server = Server::start().await;
    let (id, _) = server.mark(obj(), "acme").await;
    for (depth, tried) in [
        ("fast", vec!["blind", "layout_search_near"]),
        (
            "standard",
            vec![
                "blind",
                "in_place",
                "layout_search_near",
                "layout_search",
                "host_frame",
                "relief",
            ],
        ),
        (
            "exhaustive",
            vec![
                "blind",
                "in_place",
                "layout_search_near",
                "layout_search",
                "host_frame",
                "relief",
                "layout_search_wide",
            ],
        ),
    ] {
        let form = file_form(other_obj()).text("depth", depth).text("watermark_id", id.clone());
        let verdict = server.verify(form).await;
        assert_eq!(verdict["verdict"], "no_match", "{verdict}");
        assert_eq!(verdict["depth"], depth);
        assert_eq!(stages(&verdict), tried);
    }
    let response = server.post("/v1/verifications", file_form(obj()).text("depth", "deep")).await;
    problem(response, 400, "invalid_parameter").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn glb_keeps_its_format() {
    let server = Server::start().await;
    let form = file_form(glb()).text("owner_id", "acme");
    let response = server.post("/v1/watermarks", form).await;
    assert_eq!(response.headers()["content-type"], "model/gltf-binary");
    let (id, file) = marked(response).await;
    assert!(file.starts_with(b"glTF") && file != glb());
    assert_match(&server.verify(file_form(&file)).await, &id);
}

#[tokio::test(flavor = "multi_thread")]
async fn fields_in_any_order_and_the_answer_s_headers() {
    let server = Server::start().await;
    let form = reqwest::multipart::Form::new()
        .text("strength", "0.12")
        .text("owner_id", "acme")
        .part("file", file_part(obj()).file_name("R\u{e4}der \"x\".obj"))
        .text("recipient", "studio")
        .text("label", "first")
        .text("method", "qsp-var")
        .text("bits", "32")
        .text("payload", "cafe");
    let response = server.post("/v1/watermarks", form).await;
    assert_eq!(response.status(), 201);
    let header = |name: &str| response.headers()[name].to_str().unwrap().to_owned();
    let id = header("quadmark-watermark-id");
    assert_eq!(header("content-type"), "model/obj");
    assert_eq!(header("location"), format!("/v1/watermarks/{id}"));
    assert_eq!(header("link"), format!("</v1/watermarks/{id}>; rel=\"describedby\""));
    assert!(header("content-disposition").contains("-marked.obj"));
    let etag = header("etag");
    let bytes = response.bytes().await.unwrap();
    let record = server.get_json(&format!("/v1/watermarks/{id}")).await;
    assert_eq!(etag, format!("\"{}\"", record["marked_sha256"].as_str().unwrap()));
    let expected = [
        ("owner_id", "acme"),
        ("recipient", "studio"),
        ("label", "first"),
        ("method", "qsp-var"),
        ("message", "cafe0000"),
        ("payload", "cafe"),
        ("format", "obj"),
    ];
    for (member, value) in expected {
        assert_eq!(record[member], value, "{member}");
    }
    assert_eq!((&record["bits"], &record["strength"]), (&32.into(), &0.12.into()));
    let file = server.get(&format!("/v1/watermarks/{id}/file")).await;
    assert_eq!(file.bytes().await.unwrap(), bytes);
    let url = server.url(&format!("/v1/watermarks/{id}/file"));
    let same = server.client.get(url).header("if-none-match", etag).send().await.unwrap();
    assert_eq!(same.status(), 304);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_as_body_and_the_record_as_answer() {
    let server = Server::start().await;
    let url = server.url("/v1/watermarks?owner_id=acme&label=a%20b");
    let request = server.client.post(url).header("accept", "application/json").body(obj());
    let response = request.send().await.unwrap();
    assert_eq!(response.status(), 201);
    assert_eq!(response.headers()["content-type"], "application/json");
    let record: Value = response.json().await.unwrap();
    assert_eq!((&record["owner_id"], &record["label"]), (&"acme".into(), &"a b".into()));
    let file = server.get(record["file_url"].as_str().unwrap()).await.bytes().await.unwrap();
    let url = server.url("/v1/verifications");
    let verdict = server.client.post(url).body(file).send().await.unwrap();
    assert_match(&verdict.json().await.unwrap(), record["id"].as_str().unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_not_kept() {
    let server = Server::start().await;
    let form = || file_form(obj()).text("owner_id", "acme").text("keep_file", "false");
    let url = server.url("/v1/watermarks");
    let lost = server.client.post(url).header("accept", "application/json").multipart(form());
    problem(lost.send().await.unwrap(), 400, "invalid_parameter").await;
    server.assert_empty("an answer that would have lost the file").await;
    let form = form().text("keep_host", "false");
    let (id, file) = marked(server.post("/v1/watermarks", form).await).await;
    assert_eq!(server.service.blob_count().await.unwrap(), 0);
    let record = server.get_json(&format!("/v1/watermarks/{id}")).await;
    assert_eq!((&record["file_url"], &record["host_kept"]), (&Value::Null, &false.into()));
    let gone = server.get(&format!("/v1/watermarks/{id}/file")).await;
    problem(gone, 404, "file_not_kept").await;
    assert_match(&server.verify(file_form(&file)).await, &id);
}

#[tokio::test(flavor = "multi_thread")]
async fn inspection_registers_nothing() {
    let server = Server::start().await;
    let response = server.post("/v1/inspections", file_form(obj()).text("bits", "32")).await;
    assert_eq!(response.status(), 200);
    let found: Value = response.json().await.unwrap();
    assert_eq!((&found["format"], &found["bits"]), (&"obj".into(), &32.into()));
    assert!(found["vertices"].as_u64().unwrap() > 5_000, "{found}");
    let expected = found["expected"].as_array().unwrap();
    assert_eq!(expected[0]["attack"], "no attack");
    assert!(expected[0]["log10_fp"].as_f64().unwrap() < -8.0, "{found}");
    assert!(expected.len() > 15 && expected.iter().all(|e| e["error"].as_f64().unwrap() > 0.0));
    server.assert_empty("an inspection").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_method_is_recognised() {
    let server = Server::start().await;
    for method in quadmark::watermark::Method::ALL {
        let form = file_form(obj()).text("owner_id", "acme").text("method", method.to_string());
        let (id, file) = marked(server.post("/v1/watermarks", form).await).await;
        assert_match(&server.verify(file_form(&file)).await, &id);
    }
}
