//! What a mark does to a mesh: reported, kept and limited.

use serde_json::Value;

use crate::server::{Server, file_form, marked, obj, problem};

async fn record_of(server: &Server, fields: &[(&'static str, &'static str)]) -> Value {
    let form = file_form(obj()).text("owner_id", "acme");
    let form = fields.iter().fold(form, |form, &(name, value)| form.text(name, value));
    let url = server.url("/v1/watermarks");
    let request = server.client.post(url).header("accept", "application/json");
    let response = request.multipart(form).send().await.unwrap();
    let (status, body) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 201, "{fields:?}: {body}");
    serde_json::from_str(&body).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_answer_and_the_record_tell_what_the_mark_did() {
    let server = Server::start().await;
    let answered = record_of(&server, &[("method", "qsp-mean"), ("layers", "blind")]).await;
    let quality = &answered["quality"];
    let (mrms, hausdorff) = (number(&quality["mrms"]), number(&quality["hausdorff"]));
    assert!(mrms > 1e-6 && mrms < 1e-3, "{answered}");
    assert!(hausdorff > mrms && hausdorff <= number(&quality["max_displacement"]) * 1.001);
    assert!(number(&quality["normal_deviation_degrees"]) > 0.0 && quality["flipped"].is_u64());
    assert_eq!(
        (&quality["method_used"], &answered["strength"]),
        (&"qsp-mean".into(), &0.15.into())
    );
    let path = format!("/v1/watermarks/{}", answered["id"].as_str().unwrap());
    assert_eq!(server.get_json(&path).await, answered);
    let server = server.restart().await;
    assert_eq!(server.get_json(&path).await, answered);
}

/// The coordinates of an OBJ, as written.
fn coordinates(obj: &[u8]) -> Vec<&str> {
    let lines = std::str::from_utf8(obj).unwrap().lines();
    lines.filter_map(|line| line.strip_prefix("v ")).flat_map(|line| line.split(' ')).collect()
}

fn decimals(word: &str) -> usize {
    word.split_once('.').map_or(0, |(_, digits)| digits.len())
}

/// A host with the sample's six decimals keeps them. A host with three gets more, and the record
/// says for how many coordinates.
#[tokio::test(flavor = "multi_thread")]
async fn coordinates_keep_their_decimals_or_are_counted() {
    let server = Server::start().await;
    let text = std::str::from_utf8(obj()).unwrap();
    let short = |line: &str| match line.strip_prefix("v ") {
        Some(rest) => {
            let words = rest.split(' ').map(|word| word.split_at(word.len() - 3).0.to_owned());
            format!("v {}\n", words.collect::<Vec<_>>().join(" "))
        }
        None => format!("{line}\n"),
    };
    let coarse: String = text.lines().map(short).collect();
    for (host, keeps) in [(obj(), true), (coarse.as_bytes(), false)] {
        let (id, file) = server.mark(host, "acme").await;
        let pairs = coordinates(host).into_iter().zip(coordinates(&file));
        let more = pairs.filter(|(before, after)| decimals(after) > decimals(before)).count();
        assert_eq!(more == 0, keeps);
        let record = server.get_json(&format!("/v1/watermarks/{id}")).await;
        assert_eq!(record["quality"]["more_decimals"], more, "{record}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_strongest_mark_within_the_distortion_is_made() {
    let server = Server::start().await;
    // Well above the distortion of the weakest mark of this mesh with this method (1.9e-5 to
    // 2.6e-5, by key), and well below the strongest.
    let (limit, method) = (6e-5, ("method", "qsp-mean"));
    let found = record_of(&server, &[method, ("max_distortion", "0.00006")]).await;
    let (mrms, strength) = (number(&found["quality"]["mrms"]), number(&found["strength"]));
    // The strength leaves room for codewords that distort more than most. Codewords that distort
    // least (a random key on narrow bins) use well below half of the limit.
    assert!(mrms <= limit && mrms > 0.3 * limit, "{found}");
    let twice = record_of(&server, &[method, ("max_distortion", "0.00012")]).await;
    assert!(number(&twice["strength"]) > strength, "{twice}");
    let most = [("max_distortion", "0.1"), ("strength", "0.12")];
    assert_eq!(record_of(&server, &most).await["strength"], 0.12);
    assert_eq!(record_of(&server, &[("max_distortion", "0.1")]).await["strength"], 0.25);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_distortion_that_no_mark_keeps_to_leaves_nothing_behind() {
    let server = Server::start().await;
    let form = file_form(obj()).text("owner_id", "acme").text("layers", "blind");
    let form = form.text("max_distortion", "0.000001");
    let refused = server.post("/v1/watermarks", form).await;
    let body = problem(refused, 422, "distortion_unreachable").await;
    let detail = body["detail"].as_str().unwrap();
    assert!(detail.contains("1e-6") && detail.contains("max_distortion"), "{detail}");
    server.assert_empty("an unreachable distortion").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_within_a_distortion_gets_the_same_bytes() {
    let server = Server::start().await;
    let form = |limit| {
        let form = file_form(obj()).text("owner_id", "acme").text("keep_file", "false");
        form.text("max_distortion", limit)
    };
    let send = async |form: reqwest::multipart::Form| {
        let request = server.client.post(server.url("/v1/watermarks"));
        request.header("idempotency-key", "k").multipart(form).send().await.unwrap()
    };
    let first = marked(send(form("0.00005")).await).await;
    let retry = send(form("0.00005")).await;
    assert_eq!(retry.headers()["idempotent-replayed"], "true");
    assert!(marked(retry).await == first);
    for other in [form("0.00006"), form("0.00005").text("strength", "0.1")] {
        problem(send(other).await, 409, "idempotency_conflict").await;
    }
}
