//! Verifications that ask about marks that cannot be searched for. They are refused with the
//! reason, never answered with `no_match`, never stored.

use crate::binary::program;
use crate::server::{Server, file_form, obj, other_obj, problem};

async fn stored_verdicts(server: &Server) -> i64 {
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(server.data().join("registry.sqlite"))
        .read_only(true);
    let reader = sqlx::SqlitePool::connect_with(options).await.unwrap();
    let (count,): (i64,) =
        sqlx::query_as("SELECT count(*) FROM verifications").fetch_one(&reader).await.unwrap();
    count
}

#[tokio::test(flavor = "multi_thread")]
async fn filters_that_select_nothing_are_refused_with_the_reason() {
    let server = Server::start().await;
    let (id, file) = server.mark(obj(), "acme").await;
    let (gone, gone_file) = server.mark(other_obj(), "gone").await;
    let revoke =
        |id: &str| server.client.delete(server.url(&format!("/v1/watermarks/{id}"))).send();
    assert_eq!(revoke(&gone).await.unwrap().status(), 200);
    let (records, blobs) =
        (server.get_json("/v1/watermarks").await, server.service.blob_count().await.unwrap());
    let cases: [(&[(&str, &str)], &str); 5] = [
        (&[("owner_id", "nobody")], "no mark of the owner \"nobody\" is registered"),
        (&[("owner_id", "ACME")], "letter by letter"),
        (&[("owner_id", "gone")], "were revoked"),
        (&[("watermark_id", &gone)], "was revoked at"),
        (&[("watermark_id", &id), ("owner_id", "gone")], "is not one of \"gone\""),
    ];
    for (fields, reason) in cases {
        for suspect in [&file, &gone_file] {
            for depth in ["fast", "standard"] {
                let form = fields.iter().fold(file_form(suspect), |form, (name, value)| {
                    form.text((*name).to_owned(), (*value).to_owned())
                });
                let refused = server.post("/v1/verifications", form.text("depth", depth)).await;
                let body = problem(refused, 422, "nothing_to_compare").await;
                let detail = body["detail"].as_str().unwrap();
                assert!(detail.contains(reason), "{fields:?}: {detail}");
            }
        }
    }
    assert_eq!(stored_verdicts(&server).await, 0);
    assert_eq!(server.get_json("/v1/watermarks").await, records);
    assert_eq!(server.service.blob_count().await.unwrap(), blobs);
    // Marks that can be searched for are.
    for fields in [vec![("owner_id", "acme")], vec![("watermark_id", id.as_str())], vec![]] {
        let form = fields.into_iter().fold(file_form(&file), |form, (name, value)| {
            form.text(name.to_owned(), value.to_owned())
        });
        assert_eq!(server.verify(form).await["verdict"], "match");
    }
    assert_eq!(stored_verdicts(&server).await, 3);

    let suspect = server.data().join("../suspect.obj");
    std::fs::write(&suspect, &file).unwrap();
    let verify = |arguments: &[&str]| {
        let mut command = program();
        command.arg("verify").arg(&suspect).arg("--data").arg(server.data()).args(arguments);
        command.output().unwrap()
    };
    for arguments in [&["--owner-id", "nobody"][..], &["--watermark-id", &gone, "--json"]] {
        let output = verify(arguments);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(output.stdout.is_empty(), "{output:?}");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains("there is nothing to compare the file with"), "{text}");
    }
    assert_eq!(verify(&["--owner-id", "acme"]).status.code(), Some(0));
}

/// With an empty registry, `no_match` is the true answer. A client that asks before every upload
/// also asks before the first. The zero hypotheses say that nothing was compared.
#[tokio::test(flavor = "multi_thread")]
async fn an_empty_registry_answers_no_match() {
    let server = Server::start().await;
    let verdict = server.verify(file_form(obj())).await;
    assert_eq!((&verdict["verdict"], &verdict["hypotheses"]), (&"no_match".into(), &0.into()));
}
