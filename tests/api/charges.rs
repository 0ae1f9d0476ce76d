//! What a bound is charged for besides the hypotheses of its verification: marks that were refused
//! or revoked before, and earlier questions.

use std::collections::BTreeSet;

use quadmark::config::{Config, Settings};
use quadmark::marking::{Layers, most_tries};
use quadmark::service::{Depth, SALTS, Service, VerifyRequest};
use serde_json::Value;

use crate::server::{Server, file_form, marked, obj, problem};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

/// The match of a verdict, whose figures must agree with each other.
fn best(verdict: &Value) -> &Value {
    assert_eq!(verdict["verdict"], "match", "{verdict}");
    let best = &verdict["matches"][0];
    let how = &best["evidence"];
    let counted = number(&how["counted"]) * number(&how["charged"]);
    let log10_fp = number(&how["log10_bound"]) + counted.log10();
    assert!((log10_fp - number(&best["log10_fp"])).abs() < 1e-9, "{verdict}");
    best
}

#[tokio::test(flavor = "multi_thread")]
async fn each_question_about_a_record_is_counted_and_charged() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    // Another file each time, of the same mesh.
    let variant = |k: u64| [file.as_slice(), format!("# {k}\n").as_bytes()].concat();
    // By its id, by its owner, and by the answer alone.
    let form = |question: u64| match question % 3 {
        0 => file_form(&variant(question)).text("watermark_id", id.clone()),
        1 => file_form(&variant(question)).text("owner_id", "acme"),
        _ => file_form(&variant(question)),
    };
    let mut before = f64::NEG_INFINITY;
    for question in 1..=10_u64 {
        let verdict = server.verify(form(question)).await;
        let found = best(&verdict);
        assert_eq!(
            (&verdict["questions"], &found["evidence"]["questions"]),
            (&question.into(), &question.into())
        );
        assert!(number(&found["log10_fp"]) > before, "{question}: {verdict}");
        before = number(&found["log10_fp"]);
    }
    // A healthy mark has decades to spare after ten questions.
    assert!(before < -12.0, "{before}");
    // The same file, asked about in the same way, is the same question.
    for question in [10, 3, 1, 8] {
        let again = server.verify(form(question)).await;
        assert_eq!(best(&again)["evidence"]["questions"], question);
    }
    // The file of another owner is a question about the mark if the request names the mark, else
    // not.
    let verdict = server.verify(file_form(obj())).await;
    assert_eq!((&verdict["verdict"], &verdict["questions"]), (&"no_match".into(), &0.into()));
    let verdict = server.verify(file_form(obj()).text("watermark_id", id.clone())).await;
    assert_eq!((&verdict["verdict"], &verdict["questions"]), (&"no_match".into(), &11.into()));
    let server = server.restart().await;
    let mut asking = tokio::task::JoinSet::new();
    for k in 100..106 {
        let url = server.url("/v1/verifications");
        let form = file_form(&variant(k)).text("watermark_id", id.clone());
        let request = server.client.post(url).multipart(form);
        asking.spawn(async move { request.send().await.unwrap().json::<Value>().await.unwrap() });
    }
    let mut asked = BTreeSet::new();
    while let Some(verdict) = asking.join_next().await {
        asked.insert(best(&verdict.unwrap())["evidence"]["questions"].as_u64().unwrap());
    }
    assert!(asked.into_iter().eq(12..=17), "none is lost, none is had twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_directory_that_is_only_read_charges_the_next_question_and_counts_none() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let settings = Settings { data: Some(server.data()), ..Settings::default() };
    let reader = Service::open_to_verify(Config::decide(settings).unwrap()).await.unwrap();
    for _ in 0..3 {
        let spooled = reader
            .spool(reader.admit_upload(None).unwrap())
            .unwrap()
            .write(&file)
            .await
            .unwrap()
            .end(None)
            .await
            .unwrap();
        let watermark_id = Some(id.parse().unwrap());
        let depth = Depth::Standard;
        let request = VerifyRequest { file: spooled, owner_id: None, watermark_id, depth };
        let verification = reader.verify(request).await.unwrap();
        assert_eq!(verification.questions, 1);
        assert_eq!(verification.matches[0].evidence.as_ref().unwrap().questions, 1);
    }
    let verdict = server.verify(file_form(&file).text("watermark_id", id)).await;
    assert_eq!(verdict["questions"], 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn marks_that_were_refused_are_charged_to_the_next_of_their_host_and_owner() {
    let server = Server::start().await;
    // The blind layer alone, since a relief can be arbitrarily weak.
    let refused = || {
        let form = file_form(obj()).text("owner_id", "acme").text("layers", "blind");
        form.text("max_distortion", "0.000001")
    };
    let response = server.post("/v1/watermarks", refused()).await;
    problem(response, 422, "distortion_unreachable").await;
    server.assert_empty("a refusal").await;
    let mark = async |owner_id: &str, key: &str| {
        let request = server.client.post(server.url("/v1/watermarks"));
        let form = file_form(obj()).text("owner_id", owner_id.to_owned());
        let form = form.text("on_existing", "allow");
        marked(request.header("idempotency-key", key).multipart(form).send().await.unwrap()).await
    };
    let (_, other) = mark("other", "k").await;
    let (id, file) = mark("acme", "k").await;
    // A retry is answered with the same record and is not another try.
    assert_eq!(mark("acme", "k").await.0, id);
    let (_, next) = mark("acme", "l").await;
    // Each salt and strength that was refused is a try.
    let all = 1 + most_tries(SALTS, Layers::Blind);
    for (file, tries) in [(&file, all), (&next, 1), (&other, 1)] {
        let verdict = server.verify(file_form(file)).await;
        let how = &best(&verdict)["evidence"];
        assert_eq!(how["tries"], tries, "{verdict}");
        assert_eq!(number(&how["charged"]) > 100.0, tries == all, "{verdict}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_registers_many_and_revokes_most_gains_nothing() {
    let server = Server::start().await;
    let mut marks = Vec::new();
    for _ in 0..4 {
        marks.push(server.mark(obj(), "acme").await);
    }
    let (id, file) = marks.pop().unwrap();
    let ask = async |name: &'static str, value: &str| {
        let verdict = server.verify(file_form(&file).text(name, value.to_owned())).await;
        best(&verdict)["evidence"]["siblings"].as_u64().unwrap()
    };
    // Asked by its id, it is one of four. Asked by its owner, all four are hypotheses anyway.
    assert_eq!(ask("watermark_id", &id).await, 4);
    assert_eq!(ask("owner_id", "acme").await, 1);
    for (revoked, (id, _)) in (1..).zip(&marks) {
        let path = server.url(&format!("/v1/watermarks/{id}"));
        assert!(server.client.delete(path).send().await.unwrap().status().is_success());
        assert_eq!(ask("owner_id", "acme").await, 1 + revoked);
    }
    assert_eq!(ask("watermark_id", &id).await, 4);
    let verdict = server.verify(file_form(&file)).await;
    assert_eq!(best(&verdict)["evidence"]["siblings"], 4);
}
