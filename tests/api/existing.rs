//! Several marks on one file, on copies of one file, and how a request treats existing marks.

use glam::DVec3;
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use serde_json::Value;

use crate::server::{Server, file_form, marked, obj, other_obj, problem};

async fn mark_with(
    server: &Server,
    file: &[u8],
    fields: &[(&'static str, String)],
) -> reqwest::Response {
    let form =
        fields.iter().fold(file_form(file), |form, (name, value)| form.text(*name, value.clone()));
    server.post("/v1/watermarks", form).await
}

fn owner(name: &str) -> (&'static str, String) {
    ("owner_id", name.to_owned())
}

fn on_existing(what: &str) -> (&'static str, String) {
    ("on_existing", what.to_owned())
}

/// Ids in the answer's header.
fn told(response: &reqwest::Response) -> Option<String> {
    let header = response.headers().get("quadmark-existing-marks");
    header.map(|ids| ids.to_str().unwrap().to_owned())
}

/// Ids of the matches, best first.
fn matches(verdict: &Value) -> Vec<&str> {
    assert_eq!(verdict["verdict"], "match", "{verdict}");
    let matches = verdict["matches"].as_array().unwrap().iter();
    let certain = matches.filter(|found| found["log10_fp"].as_f64().unwrap() < -9.0);
    certain.map(|found| found["watermark_id"].as_str().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_marked_host_is_refused_told_of_or_marked_without_a_word() {
    let server = Server::start().await;
    let (first, file) = server.mark(obj(), "acme").await;
    server.mark(other_obj(), "other").await;
    let blobs = server.service.blob_count().await.unwrap();
    let registered = server.get_json("/v1/watermarks").await;

    let refused = mark_with(&server, &file, &[owner("rival"), on_existing("reject")]).await;
    let body = problem(refused, 409, "already_marked").await;
    assert!(body["detail"].as_str().unwrap().contains(&first), "{body}");
    assert_eq!(server.get_json("/v1/watermarks").await, registered);
    assert_eq!(server.service.blob_count().await.unwrap(), blobs);
    let nonsense = mark_with(&server, &file, &[owner("rival"), on_existing("maybe")]).await;
    problem(nonsense, 400, "invalid_parameter").await;

    for (what, tells) in [(None, true), (Some("warn"), true), (Some("allow"), false)] {
        let fields: Vec<_> = [owner("rival")].into_iter().chain(what.map(on_existing)).collect();
        let response = mark_with(&server, &file, &fields).await;
        assert_eq!(told(&response), tells.then(|| first.clone()), "{what:?}");
        let (id, _) = marked(response).await;
        let record = server.get_json(&format!("/v1/watermarks/{id}")).await;
        let found = &record["existing_marks"];
        assert_eq!(found.as_array().unwrap().len(), 1, "{record}");
        assert_eq!(found[0]["watermark_id"], first.as_str());
        assert_eq!(found[0]["owner_id"], "acme");
        assert!(found[0]["log10_fp"].as_f64().unwrap() < -9.0, "{record}");
    }
    // A host without a mark is marked whatever is requested, and the record says that it had none.
    for what in ["reject", "warn", "allow"] {
        let response = mark_with(&server, obj(), &[owner("acme"), on_existing(what)]).await;
        assert_eq!(told(&response), None);
        let (id, _) = marked(response).await;
        let record = server.get_json(&format!("/v1/watermarks/{id}")).await;
        assert_eq!(record["existing_marks"], Value::Array(Vec::new()), "{record}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn revoked_marks_are_not_looked_for_and_a_query_serves_as_well_as_a_form() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let raw = async || {
        let url = server.url("/v1/watermarks?owner_id=rival&on_existing=reject");
        let request = server.client.post(url).header("content-type", "model/obj");
        request.body(file.clone()).send().await.unwrap()
    };
    problem(raw().await, 409, "already_marked").await;
    let revoked = server.client.delete(server.url(&format!("/v1/watermarks/{id}")));
    assert_eq!(revoked.send().await.unwrap().status(), 200);
    marked(raw().await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_names_the_same_marks() {
    let server = Server::start().await;
    let (first, file) = server.mark(obj(), "acme").await;
    let send = async |fields: &[(&'static str, &'static str)]| {
        let form = file_form(&file).text("owner_id", "rival").text("keep_file", "false");
        let form = fields.iter().fold(form, |form, &(name, value)| form.text(name, value));
        let request = server.client.post(server.url("/v1/watermarks"));
        request.header("idempotency-key", "k").multipart(form).send().await.unwrap()
    };
    let answer = send(&[]).await;
    assert_eq!(told(&answer), Some(first.clone()));
    let made = marked(answer).await;
    for fields in [&[][..], &[("on_existing", "warn")]] {
        let retry = send(fields).await;
        assert_eq!(retry.headers()["idempotent-replayed"], "true");
        assert_eq!(told(&retry), Some(first.clone()));
        assert!(marked(retry).await == made);
    }
    for other in ["reject", "allow"] {
        problem(send(&[("on_existing", other)]).await, 409, "idempotency_conflict").await;
    }
}

/// A host large enough for several marks.
fn large(sample: Sample) -> Vec<u8> {
    to_obj(&sample.mesh(40_000).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_marks_one_over_the_other_both_are_found() {
    let server = Server::start().await;
    for sample in [Sample::Blob, Sample::Knot] {
        let (first, file) = server.mark(&large(sample), "acme").await;
        let response = mark_with(&server, &file, &[owner("rival")]).await;
        assert_eq!(told(&response), Some(first.clone()), "{sample}");
        let (second, file) = marked(response).await;
        let verdict = server.verify(file_form(&file)).await;
        let found = matches(&verdict);
        assert_eq!(found.len(), 2, "{sample}: {verdict}");
        assert!(found.contains(&first.as_str()) && found.contains(&second.as_str()), "{verdict}");
        // The older mark is read itself, or named by the newer one's record.
        for found in verdict["matches"].as_array().unwrap() {
            let under = &found["overmarked_by"];
            assert!(under.is_null() || (*under == *second && found["watermark_id"] == *first));
        }
        let third = mark_with(&server, &file, &[owner("third")]).await;
        let told = told(&third).unwrap();
        assert!(told.contains(&first) && told.contains(&second), "{sample}: {told}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_recipient_is_named_by_its_copy() {
    const RECIPIENTS: [&str; 6] = ["ada", "bo", "cy", "di", "eve", "flo"];
    let server = Server::start().await;
    let host = large(Sample::Blob);
    let mut copies = Vec::new();
    for recipient in RECIPIENTS {
        let fields = [
            owner("acme"),
            ("recipient", recipient.to_owned()),
            ("bits", "256".to_owned()),
            on_existing("reject"),
        ];
        copies.push(marked(mark_with(&server, &host, &fields).await).await);
    }
    for (recipient, (id, file)) in RECIPIENTS.iter().zip(&copies) {
        let verdict = server.verify(file_form(file)).await;
        assert_eq!(matches(&verdict), [id.as_str()], "{recipient}");
        assert_eq!(verdict["matches"][0]["recipient"], *recipient);
    }
}

/// The mean of the files, vertex by vertex.
fn mean(files: &[&[u8]]) -> Vec<u8> {
    let read = |file: &&[u8]| Asset::read(file, &Limits::default()).unwrap().into_mesh();
    let copies: Vec<Mesh> = files.iter().map(read).collect();
    let at = |v: usize| {
        copies.iter().map(|copy| copy.positions()[v]).sum::<DVec3>() / copies.len() as f64
    };
    let positions = (0..copies[0].positions().len()).map(at).collect();
    to_obj(&Mesh::new(positions, copies[0].triangles().to_vec()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn recipients_who_average_their_copies_are_all_named_and_nobody_else() {
    let server = Server::start().await;
    for sample in [Sample::Blob, Sample::Knot] {
        let host = large(sample);
        let mut copies = Vec::new();
        for recipient in 0..6 {
            let fields = [
                owner("acme"),
                ("recipient", recipient.to_string()),
                ("strength", "0.1".to_owned()),
                on_existing("allow"),
            ];
            copies.push(marked(mark_with(&server, &host, &fields).await).await);
        }
        for colluders in [&copies[..2], &copies[2..5], &copies[1..6]] {
            let files: Vec<&[u8]> = colluders.iter().map(|(_, file)| file.as_slice()).collect();
            let verdict = server.verify(file_form(&mean(&files))).await;
            let mut named = matches(&verdict);
            let mut meant: Vec<&str> = colluders.iter().map(|(id, _)| id.as_str()).collect();
            named.sort_unstable();
            meant.sort_unstable();
            assert_eq!(named, meant, "{sample}: {verdict}");
            // Only one of them, when the request asks about nobody else.
            let form = file_form(&mean(&files)).text("watermark_id", meant[0].to_owned());
            assert_eq!(matches(&server.verify(form).await), [meant[0]], "{sample}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_overwritten_mark_is_found_for_its_owner_alone() {
    let server = Server::start().await;
    for sample in [Sample::Blob, Sample::Knot] {
        let (first, file) = server.mark(&large(sample), "acme").await;
        let (second, over) = server.mark(&file, "rival").await;
        for (field, value) in [("owner_id", "acme"), ("watermark_id", first.as_str())] {
            let verdict = server.verify(file_form(&over).text(field, value.to_owned())).await;
            assert_eq!(matches(&verdict), [first.as_str()], "{sample}: {verdict}");
            let under = &verdict["matches"][0]["overmarked_by"];
            assert!(under.is_null() || *under == *second, "{sample}: {verdict}");
        }
        let (_, other) = server.mark(&large(Sample::Gear), "somebody").await;
        let verdict = server.verify(file_form(&other).text("owner_id", "acme")).await;
        assert_eq!(verdict["verdict"], "no_match", "{verdict}");
    }
}
