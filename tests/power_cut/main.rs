//! Nothing that was answered is lost when the power is cut.
//!
//! The real `quadmark serve` runs on a disk of which only synced data survives (`disk.c`, a
//! preloaded library). It marks, verifies and revokes. Then the disk is examined as if the power
//! had been cut after each single sync. A service must start on it, and everything answered by then
//! must exist.
#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test")]

mod disk;

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use disk::Disk;
use quadmark::sample::{Sample, to_glb, to_obj};
use reqwest::multipart::{Form, Part};
use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_quadmark");

/// A directory below the root of the disk, with parents that the service must also make durable.
const DATA: &str = "srv/quadmark/data";

fn command() -> Command {
    let mut command = Command::new(PROGRAM);
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("QUADMARK_")) {
        command.env_remove(name);
    }
    command
}

/// A running service, killed on drop.
struct Served {
    child: Child,
    address: String,
    client: reqwest::Client,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Served {
    fn start(data: &Path, disk: Option<&Disk>) -> Self {
        let mut command = command();
        command
            .args(["serve", "--listen", "127.0.0.1:0", "--log-format", "json", "--data"])
            .arg(data)
            .stderr(Stdio::piped());
        if let Some(disk) = disk {
            disk.carries(&mut command);
        }
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut said = Vec::new();
        let address = lines.by_ref().find_map(|line| {
            let line = line.unwrap();
            let value: Value = serde_json::from_str(&line).unwrap_or_default();
            said.push(line);
            value["address"].as_str().map(str::to_owned)
        });
        let Some(address) = address else {
            panic!("it does not start: {}", said.join("\n"));
        };
        std::thread::spawn(move || lines.for_each(drop));
        let client = reqwest::Client::builder().timeout(Duration::from_mins(2)).build().unwrap();
        Self { child, address, client }
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    async fn json(&self, path: &str) -> Option<Value> {
        let answer = self.client.get(self.url(path)).send().await.unwrap();
        match answer.status().as_u16() {
            200 => Some(answer.json().await.unwrap()),
            404 => None,
            status => panic!("{path}: {status}: {}", answer.text().await.unwrap()),
        }
    }

    async fn mark(&self, host: &[u8], recipient: &str) -> (String, Vec<u8>) {
        let form = file_form(host).text("owner_id", "acme").text("recipient", recipient.to_owned());
        let request = self.client.post(self.url("/v1/watermarks")).multipart(form);
        let answer = request.header("Idempotency-Key", recipient).send().await.unwrap();
        assert_eq!(answer.status(), 201);
        let id = answer.headers()["quadmark-watermark-id"].to_str().unwrap().to_owned();
        (id, answer.bytes().await.unwrap().to_vec())
    }

    async fn verify(&self, file: &[u8]) -> Value {
        let request = self.client.post(self.url("/v1/verifications")).multipart(file_form(file));
        let answer = request.send().await.unwrap();
        assert_eq!(answer.status(), 200);
        answer.json().await.unwrap()
    }
}

fn file_form(file: &[u8]) -> Form {
    let part = Part::bytes(file.to_vec()).file_name("mesh");
    Form::new().part("file", part.mime_str("application/octet-stream").unwrap())
}

/// What a client was answered.
enum Told {
    Marked { recipient: &'static str, id: String, file: Vec<u8> },
    Revoked { id: String },
    Verified { answer: Value },
}

/// Marks, verifies and revokes. Returns each answer with the number of syncs at its time.
async fn work(disk: &Disk) -> Vec<(usize, Told)> {
    let service = Served::start(&disk.root().join(DATA), Some(disk));
    let mesh = Sample::Blob.mesh(10_000).unwrap();
    let hosts = [("one", to_obj(&mesh)), ("two", to_obj(&mesh)), ("three", to_glb(&mesh))];
    let mut told = Vec::new();
    for (recipient, host) in hosts {
        let (id, file) = service.mark(&host, recipient).await;
        told.push((disk.syncs(), Told::Marked { recipient, id, file }));
    }
    let Some((_, Told::Marked { id, file, .. })) = told.first() else { panic!("nothing marked") };
    let (id, file) = (id.clone(), file.clone());
    let answer = service.verify(&file).await;
    assert_eq!(answer["verdict"], "match");
    told.push((disk.syncs(), Told::Verified { answer }));
    let path = format!("/v1/watermarks/{id}");
    let revoked = service.client.delete(service.url(&path)).send().await.unwrap();
    assert!(revoked.status().is_success());
    told.push((disk.syncs(), Told::Revoked { id }));
    told
}

/// Asks a service for everything that was answered; if `thorough`, also verifies each file.
async fn ask(service: &Served, told: &[&Told], cut: usize, thorough: bool) {
    let is_revoked = |wanted: &String| {
        told.iter().any(|told| matches!(told, Told::Revoked { id } if id == wanted))
    };
    for told in told {
        match told {
            Told::Marked { id, file, recipient } => {
                let record = service.json(&format!("/v1/watermarks/{id}")).await;
                assert!(record.is_some(), "the mark for {recipient} is lost by a cut after {cut}");
                let url = service.url(&format!("/v1/watermarks/{id}/file"));
                let bytes = service.client.get(url).send().await.unwrap().bytes().await.unwrap();
                assert!(bytes == *file, "the file for {recipient} after {cut}");
                if thorough && !is_revoked(id) {
                    let verdict = service.verify(file).await;
                    assert_eq!(verdict["verdict"], "match", "{recipient} after {cut}");
                    assert_eq!(verdict["matches"][0]["watermark_id"], id.as_str());
                }
            }
            Told::Revoked { id } => {
                let record = service.json(&format!("/v1/watermarks/{id}")).await.unwrap();
                assert_ne!(record["revoked_at"], Value::Null, "the revocation after {cut}");
            }
            Told::Verified { answer } => {
                let id = answer["id"].as_str().unwrap();
                let kept = service.json(&format!("/v1/verifications/{id}")).await;
                assert_eq!(kept.as_ref(), Some(answer), "the verdict after {cut}");
            }
        }
    }
}

/// Nothing is missing, damaged or left over.
fn check(data: &Path, cut: usize) {
    let checked = command().arg("check").arg("--data").arg(data).output().unwrap();
    let found = String::from_utf8_lossy(&checked.stdout);
    assert!(checked.status.success(), "after {cut}: {found}");
}

#[tokio::test(flavor = "multi_thread")]
async fn whatever_was_answered_survives_a_power_cut_at_any_time() {
    let disk = Disk::new();
    let told = work(&disk).await;
    let syncs = disk.syncs();
    assert!(told.len() == 5 && syncs > 20, "{syncs}");
    for cut in 1..=syncs {
        let copy = tempfile::tempdir().unwrap();
        disk.survivors(cut, copy.path());
        let data = copy.path().join(DATA);
        let is_answer = told.iter().any(|(at, _)| *at == cut);
        if is_answer {
            check(&data, cut);
        }
        let service = Served::start(&data, None);
        let by_then: Vec<&Told> =
            told.iter().filter(|(at, _)| *at <= cut).map(|(_, told)| told).collect();
        ask(&service, &by_then, cut, is_answer).await;
        drop(service);
        check(&data, cut);
    }
}
