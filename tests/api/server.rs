//! A server for one test, generated meshes, and the checks that all tests share.

use std::net::SocketAddr;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use quadmark::config::{Config, Settings};
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::service::Service;
use reqwest::multipart::{Form, Part};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    pub(crate) service: Arc<Service>,
    pub(crate) client: reqwest::Client,
    settings: Settings,
    directory: tempfile::TempDir,
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Server {
    pub(crate) async fn start() -> Self {
        Self::with(Settings::default()).await
    }

    pub(crate) async fn with(settings: Settings) -> Self {
        Self::on(tempfile::tempdir().unwrap(), settings).await
    }

    pub(crate) async fn on(directory: tempfile::TempDir, settings: Settings) -> Self {
        let own = Settings { data: Some(directory.path().join("data")), ..Settings::default() };
        let config = Config::decide(own.over(settings.clone())).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let service = Service::open(config).await.unwrap();
        let (stop, stopped) = oneshot::channel();
        let served = service.clone();
        let task = tokio::spawn(async move {
            let stopped = async {
                let _ = stopped.await;
            };
            quadmark::http::serve_on(listener, served, stopped).await.unwrap();
        });
        let client = reqwest::Client::builder().timeout(Duration::from_mins(2)).build().unwrap();
        Self { address, service, client, settings, directory, stop, task }
    }

    /// Stops in order and starts again on the same data directory.
    pub(crate) async fn restart(self) -> Self {
        let settings = self.settings.clone();
        Self::on(self.stop().await, settings).await
    }

    /// Stops in order; `data` in the directory is the data directory.
    pub(crate) async fn stop(self) -> tempfile::TempDir {
        let Self { service, client, directory, stop, task, .. } = self;
        drop((service, client));
        stop.send(()).unwrap();
        task.await.unwrap();
        directory
    }

    pub(crate) fn data(&self) -> std::path::PathBuf {
        self.directory.path().join("data")
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub(crate) async fn get(&self, path: &str) -> reqwest::Response {
        self.client.get(self.url(path)).send().await.unwrap()
    }

    pub(crate) async fn get_json(&self, path: &str) -> Value {
        let response = self.get(path).await;
        assert_eq!(response.status(), 200, "{path}");
        response.json().await.unwrap()
    }

    pub(crate) async fn post(&self, path: &str, form: Form) -> reqwest::Response {
        self.client.post(self.url(path)).multipart(form).send().await.unwrap()
    }

    /// Marks a file. Returns its id and its marked bytes.
    pub(crate) async fn mark(&self, file: &[u8], owner_id: &str) -> (String, Vec<u8>) {
        let form = file_form(file).text("owner_id", owner_id.to_owned());
        marked(self.post("/v1/watermarks", form).await).await
    }

    pub(crate) async fn verify(&self, form: Form) -> Value {
        let response = self.post("/v1/verifications", form).await;
        assert_eq!(response.status(), 200);
        response.json().await.unwrap()
    }

    /// Nothing is registered, nothing is stored, no upload is left.
    pub(crate) async fn assert_empty(&self, after: &str) {
        let page = self.get_json("/v1/watermarks").await;
        assert_eq!(page["watermarks"], Value::Array(Vec::new()), "registry after {after}");
        assert_eq!(self.service.blob_count().await.unwrap(), 0, "blobs after {after}");
        let uploads = self.data().join("uploads");
        assert_eq!(std::fs::read_dir(uploads).unwrap().count(), 0, "uploads after {after}");
    }
}

/// The id and the bytes of a marked file.
pub(crate) async fn marked(response: reqwest::Response) -> (String, Vec<u8>) {
    let status = response.status();
    let id = response.headers().get("quadmark-watermark-id").cloned();
    let bytes = response.bytes().await.unwrap();
    assert_eq!(status, 201, "{}", String::from_utf8_lossy(&bytes[..bytes.len().min(500)]));
    (id.unwrap().to_str().unwrap().to_owned(), bytes.to_vec())
}

/// Checks that an answer is a problem of this status and code. Returns its body.
pub(crate) async fn problem(response: reqwest::Response, status: u16, code: &str) -> Value {
    let found = response.status().as_u16();
    let path = response.url().path().to_owned();
    assert!(is_documented(&path, found, code), "openapi.yaml: {path} answers {found} {code}");
    let kind = response.headers().get("content-type").cloned();
    let id = response.headers().get("x-request-id").cloned();
    let text = response.text().await.unwrap();
    let body: Value = serde_json::from_str(&text).unwrap_or_else(|_| panic!("{code}: {text}"));
    assert_eq!(body["code"], code, "{text}");
    assert_eq!(found, status, "{text}");
    assert_eq!(kind.unwrap(), "application/problem+json", "{text}");
    assert_eq!(body["status"], status, "{text}");
    assert_eq!(body["request_id"], id.unwrap().to_str().unwrap(), "{text}");
    for member in ["type", "title", "detail"] {
        assert!(body[member].as_str().is_some_and(|text| !text.is_empty()), "{member}: {text}");
    }
    body
}

/// Whether the document allows this answer from an operation at this path. An unknown path, or a
/// method that the path does not have, is no operation.
fn is_documented(path: &str, status: u16, code: &str) -> bool {
    static DOCUMENT: OnceLock<Value> = OnceLock::new();
    let read = || yaml_serde::from_str(&quadmark::http::openapi_yaml()).unwrap();
    let paths = DOCUMENT.get_or_init(read)["paths"].as_object().unwrap();
    let is = |template: &str| {
        let (asked, known) = (path.split('/'), template.split('/'));
        asked.clone().count() == known.clone().count()
            && asked.zip(known).all(|(asked, known)| asked == known || known.starts_with('{'))
    };
    let Some((_, operations)) = paths.iter().find(|(template, _)| is(template)) else {
        return true;
    };
    let status = status.to_string();
    let says = |operation: &Value| {
        let description = &operation["responses"][&status]["description"];
        description.as_str().is_some_and(|text| text.contains(&format!("`{code}`")))
    };
    code == "method_not_allowed" || operations.as_object().unwrap().values().any(says)
}

pub(crate) fn file_part(file: &[u8]) -> Part {
    Part::bytes(file.to_vec()).file_name("mesh.obj").mime_str("application/octet-stream").unwrap()
}

pub(crate) fn file_form(file: &[u8]) -> Form {
    Form::new().part("file", file_part(file))
}

/// A closed surface of about 10,000 vertices, as OBJ.
pub(crate) fn obj() -> &'static [u8] {
    static OBJ: OnceLock<Vec<u8>> = OnceLock::new();
    OBJ.get_or_init(|| to_obj(&Sample::Blob.mesh(10_000).unwrap()))
}

/// Another closed surface, as OBJ.
pub(crate) fn other_obj() -> &'static [u8] {
    static OBJ: OnceLock<Vec<u8>> = OnceLock::new();
    OBJ.get_or_init(|| to_obj(&Sample::Knot.mesh(10_000).unwrap()))
}

/// The surface of [`obj`] as GLB.
pub(crate) fn glb() -> &'static [u8] {
    static GLB: OnceLock<Vec<u8>> = OnceLock::new();
    GLB.get_or_init(|| to_glb(&Sample::Blob.mesh(10_000).unwrap()))
}
