//! The commands of the README, run as printed, and its promise on real meshes with the same
//! requests.
//!
//! Needs `sh` and `curl`, and in part the shared meshes (see `support::meshes`).
#![expect(clippy::unwrap_used, clippy::panic, reason = "test helpers")]

mod support;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use glam::{DMat3, DVec3};
use quadmark::formats::{Asset, Limits};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_glb, to_obj};
use serde_json::Value;

use support::meshes;

const PROGRAM: &str = env!("CARGO_BIN_EXE_quadmark");

/// A service in its own directory, ended on drop.
struct Served {
    child: Child,
    address: String,
    directory: tempfile::TempDir,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn without_settings(command: &mut Command) -> &mut Command {
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("QUADMARK_")) {
        command.env_remove(name);
    }
    command
}

impl Served {
    fn start(directory: tempfile::TempDir) -> Self {
        let mut command = Command::new(PROGRAM);
        without_settings(&mut command)
            .args(["serve", "--listen", "127.0.0.1:0", "--log-format", "json"])
            .current_dir(directory.path())
            .stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .find_map(|line| {
                let line: Value = serde_json::from_str(&line.unwrap()).unwrap();
                line["address"].as_str().map(str::to_owned)
            })
            .unwrap();
        // A pipe that nobody reads would block the service once it is full.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, address, directory }
    }

    fn restart(mut self) -> Self {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        let other = tempfile::tempdir().unwrap();
        Self::start(std::mem::replace(&mut self.directory, other))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn sh(&self, script: &str) -> Output {
        let programs = Path::new(PROGRAM).parent().unwrap();
        let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
        let script = script.replace("127.0.0.1:8080", &self.address);
        let mut command = Command::new("sh");
        without_settings(&mut command).args(["-euc", &script]).env("PATH", path);
        command.current_dir(self.directory.path()).output().unwrap()
    }

    fn json(&self, script: &str) -> Value {
        let output = self.sh(script);
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{script}: {text}");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{script}: {error}: {text}"))
    }

    fn verify(&self, file: &str) -> Value {
        self.json(&format!("curl -sS -F file=@{file} http://127.0.0.1:8080/v1/verifications"))
    }

    fn mark(&self, file: &str, owner_id: &str, marked: &str) -> String {
        let output = self.sh(&format!(
            "curl -sS -f -D headers.txt -o {marked} -F file=@{file} -F owner_id={owner_id} \
             http://127.0.0.1:8080/v1/watermarks\n\
             sed -n 's/^quadmark-watermark-id: //p' headers.txt | tr -d '\\r'"
        ));
        assert!(output.status.success(), "{file}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    }
}

#[test]
#[cfg_attr(not(has_curl), ignore = "needs sh and curl")]
fn the_readme_s_lines_do_what_it_says() {
    let served = Served::start(tempfile::tempdir().unwrap());
    let readme =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md")).unwrap();
    let mut blocks = readme.split("```console\n").skip(1).map(|b| b.split("```").next().unwrap());
    // One script, so that variables persist. Each line announces itself.
    let lines: Vec<&str> =
        blocks.by_ref().flat_map(str::lines).filter_map(|line| line.strip_prefix("$ ")).collect();
    assert!(lines.len() > 10, "{lines:?}");
    let script: String = lines
        .iter()
        .flat_map(|line| ["echo '", &mark_of(line), "'\n", line, "\n"].map(str::to_owned))
        .collect();
    let output = served.sh(&script);
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}\n{errors}");
    let answer = |line: &str| {
        let after = text.split(&format!("{}\n", mark_of(line))).nth(1).unwrap();
        after.split("\n@@").next().unwrap().split("@@").next().unwrap().trim().to_owned()
    };
    let told = |start: &str| {
        let line = lines.iter().find(|line| line.contains(start));
        answer(line.unwrap_or_else(|| panic!("no line with {start}")))
    };
    let json = |start: &str| -> Value { serde_json::from_str(&told(start)).unwrap() };
    let verdict = json("file=@marked.obj http://127.0.0.1:8080/v1/verifications");
    assert_eq!(verdict["verdict"], "match", "{verdict}");
    assert_eq!(verdict["matches"][0]["recipient"], "studio-7");
    assert!(verdict["matches"][0]["log10_fp"].as_f64().unwrap() < -15.0);
    let verdict = json("file=@knot.obj http://127.0.0.1:8080/v1/verifications");
    assert_eq!(verdict["verdict"], "no_match", "{verdict}");
    assert_eq!(json("watermarks?owner_id=acme")["watermarks"].as_array().unwrap().len(), 1);
    assert_eq!(json("bits=128")["bits"], 128);
    assert_eq!(
        json("-F file=@knot.obj http://127.0.0.1:8080/v1/watermarks")["code"],
        "missing_parameter"
    );
    assert_eq!(told("quadmark extract"), "0123456789abcdef");
}

/// What the script prints before a line of the README.
fn mark_of(line: &str) -> String {
    format!("@@{:08x}", line.bytes().fold(0_u32, |sum, b| sum.wrapping_mul(31) + u32::from(b)))
}

fn assert_match(verdict: &Value, id: &str, owner_id: &str, what: &str) {
    assert_eq!(verdict["verdict"], "match", "{what}: {verdict}");
    let best = &verdict["matches"][0];
    assert_eq!((&best["watermark_id"], &best["owner_id"]), (&id.into(), &owner_id.into()));
    // The number of strengths and questions that it is charged for depends on a key that is drawn
    // anew each time.
    let number = |of: &Value| of.as_f64().unwrap();
    let before = number(&best["log10_fp"]) - number(&best["evidence"]["charged"]).log10();
    assert!(before < -15.0, "{what}: {verdict}");
}

fn turned(mesh: &Mesh) -> Mesh {
    let turn = DMat3::from_axis_angle(DVec3::new(0.3, 1.0, -0.4).normalize(), 2.2);
    let positions = mesh.positions().iter().map(|&p| turn * p * 3.0 + DVec3::new(5.0, 6.0, -7.0));
    Mesh::new(positions.collect(), mesh.triangles().to_vec()).unwrap()
}

/// Vertices and triangles in reverse order.
fn reversed(mesh: &Mesh) -> Mesh {
    let last = u32::try_from(mesh.positions().len()).unwrap() - 1;
    let triangles = mesh.triangles().iter().rev().map(|t| t.map(|corner| last - corner));
    let positions = mesh.positions().iter().rev().copied().collect();
    Mesh::new(positions, triangles.collect()).unwrap()
}

/// The mesh scaled to a diagonal of a hundred units, so that the six decimals of [`to_obj`] lose
/// nothing of a small mesh.
fn hundred(mesh: &Mesh) -> Mesh {
    let (low, high) = mesh
        .positions()
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
    let scale = 100.0 / (high - low).length();
    let positions = mesh.positions().iter().map(|&p| p * scale).collect();
    Mesh::new(positions, mesh.triangles().to_vec()).unwrap()
}

#[test]
#[cfg_attr(not(has_curl), ignore = "needs sh and curl")]
fn generated_meshes_are_marked_and_recognised() {
    let blob = Sample::Blob.mesh(30_000).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let host = |(name, bytes): (&str, Vec<u8>)| {
        let path = directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (name.to_owned(), path)
    };
    let hosts = [("blob.obj", to_obj(&blob)), ("blob.glb", to_glb(&blob))].map(host);
    assert_marked_and_recognised(&hosts);
}

#[test]
#[cfg_attr(
    not(all(has_curl, shared_meshes)),
    ignore = "needs sh, curl and the shared meshes: set QUADMARK_MESHES"
)]
fn real_meshes_are_marked_and_recognised() {
    let names = [
        "obj/paper/bunny.obj",
        "obj/paper/dragon.obj",
        "obj/paper/gear_involute_g7.obj",
        "gltf/converted/bunny.glb",
        "gltf/converted/dragon.glb",
    ];
    let folder = meshes("");
    let hosts = names.map(|name| (name.replace('/', "-"), folder.join(name)));
    assert_marked_and_recognised(&hosts);
}

fn assert_marked_and_recognised(hosts: &[(String, PathBuf)]) {
    let mut served = Served::start(tempfile::tempdir().unwrap());
    let mut marks = Vec::new();
    for (name, host) in hosts {
        let marked = format!("marked-{name}");
        let id = served.mark(host.to_str().unwrap(), &format!("owner-of-{name}"), &marked);
        marks.push((name, id, marked));
    }
    served = served.restart();
    for (name, id, marked) in &marks {
        let owner_id = format!("owner-of-{name}");
        let bytes = std::fs::read(served.path(marked)).unwrap();
        let mesh = hundred(&Asset::read(&bytes, &Limits::default()).unwrap().into_mesh());
        let read = |bytes: &[u8]| Asset::read(bytes, &Limits::default()).unwrap().into_mesh();
        let suspects = [
            ("as it is", bytes),
            ("turned", to_glb(&turned(&mesh))),
            ("reversed", to_obj(&reversed(&mesh))),
            ("converted", to_obj(&read(&to_glb(&read(&to_obj(&mesh)))))),
        ];
        for (change, bytes) in suspects {
            std::fs::write(served.path("suspect"), bytes).unwrap();
            assert_match(&served.verify("suspect"), id, &owner_id, &format!("{name}, {change}"));
        }
    }
    for (name, host) in hosts {
        let verdict = served.verify(host.to_str().unwrap());
        assert_eq!(verdict["verdict"], "no_match", "{name}: {verdict}");
    }
    // Another owner's file, in a request with the first owner's id.
    let script = format!(
        "curl -sS -F file=@{} -F owner_id=owner-of-{} http://127.0.0.1:8080/v1/verifications",
        marks.last().unwrap().2,
        hosts[0].0
    );
    assert_eq!(served.json(&script)["verdict"], "no_match");
}
