//! A client that a stock generator makes from the `OpenAPI` document marks and verifies a file.
//!
//! Needs `openapi-python-client` on the path, with the Python that it runs on; `.ci/run` installs them:
//!
//! ```text
//! python3 -m venv target/client-generator
//! target/client-generator/bin/pip install openapi-python-client==0.29.1
//! PATH=$PWD/target/client-generator/bin:$PATH cargo test --test api client::
//! ```

use std::path::Path;
use std::process::{Command, Output};

use crate::server::{Server, obj};

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{out}{err}")
}

#[tokio::test(flavor = "multi_thread")]
#[cfg_attr(not(has_client_generator), ignore = "needs openapi-python-client")]
async fn a_generated_client_marks_and_verifies() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let directory = tempfile::tempdir().unwrap();
    let host = directory.path().join("mesh.obj");
    std::fs::write(&host, obj()).unwrap();
    let package = directory.path().join("quadmark_client");
    let generated = Command::new("openapi-python-client")
        .args(["generate", "--meta", "none", "--path"])
        .arg(here.join("openapi.yaml"))
        .arg("--config")
        .arg(here.join("tests/api/client/config.yaml"))
        .arg("--output-path")
        .arg(&package)
        .output()
        .expect("openapi-python-client is on the path");
    let said = text(&generated);
    assert!(generated.status.success(), "{said}");
    assert!(!said.contains("Cannot parse") && !said.contains("Unsupported"), "{said}");
    let server = Server::start().await;
    let mut client = Command::new("python3");
    client.arg(here.join("tests/api/client/use.py"));
    client.args([directory.path().to_owned(), server.url("").into(), host]);
    let used = tokio::task::spawn_blocking(move || client.output().unwrap()).await.unwrap();
    assert!(used.status.success(), "{}", text(&used));
    assert!(text(&used).contains("marked and verified"), "{}", text(&used));
}
