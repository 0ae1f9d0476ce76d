//! What is stored, which starts are refused, and the check of a data directory.

use std::path::{Path, PathBuf};
use std::process::Command;

use quadmark::config::{Config, Settings};
use quadmark::formats::{Asset, Limits};
use quadmark::keys::KeyRing;
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_glb, to_obj};
use quadmark::service::{Service, StartError};
use serde_json::Value;

use crate::server::{Server, file_form, glb, marked, obj, other_obj, problem};

/// File names in a part of the data directory.
fn names(data: &Path, part: &str) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(data.join(part)) else { return Vec::new() };
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// All files below a directory with their bytes. A refused start must not change them. Files that
/// `SQLite` keeps beside a database while it is read are left out.
fn everything(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut directories = vec![directory.to_owned()];
    while let Some(directory) = directories.pop() {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            let name = path.to_str().unwrap();
            if path.is_dir() {
                directories.push(path);
            } else if !name.ends_with("-shm") && !name.ends_with("-wal") {
                found.push((path.clone(), std::fs::read(path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

fn settings() -> Settings {
    Settings { workers: Some(2), queue: Some(2), ..Settings::default() }
}

/// A start that is refused and changes nothing.
async fn refused(directory: &tempfile::TempDir, settings: Settings) -> StartError {
    let data = directory.path().join("data");
    let before = everything(&data);
    let own = Settings { data: Some(data.clone()), ..Settings::default() };
    let config = Config::decide(own.over(settings)).unwrap();
    let Err(error) = Service::open(config).await else { panic!("it starts") };
    assert!(everything(&data) == before, "a refused start changed something: {error}");
    error
}

/// Exit code and findings of `quadmark check`.
fn check(data: &Path) -> (Option<i32>, Vec<(String, String)>) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_quadmark"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("QUADMARK_")) {
        command.env_remove(name);
    }
    let output = command.args(["check", "--json", "--data"]).arg(data).output().unwrap();
    let checked: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let text = |finding: &Value, member: &str| finding[member].as_str().unwrap().to_owned();
    let findings = checked["findings"].as_array().cloned().unwrap_or_default();
    let mut found: Vec<(String, String)> =
        findings.iter().map(|one| (text(one, "kind"), text(one, "what"))).collect();
    found.sort();
    (output.status.code(), found)
}

#[tokio::test]
async fn a_host_is_stored_once_for_all_its_recipients_and_formats() {
    let server = Server::start().await;
    // The same numbers as OBJ and as GLB, in single precision.
    let limits = Limits::default();
    let mesh = Asset::read(glb(), &limits).unwrap().into_mesh();
    let text = exact_obj(&mesh);
    let same = Asset::read(&text, &limits).unwrap().into_mesh();
    assert!(same.positions() == mesh.positions() && same.triangles() == mesh.triangles());
    let mut ids = Vec::new();
    for (recipient, file) in ["a", "b", "c"].into_iter().zip([glb(), &text, glb()]) {
        let form = file_form(file).text("owner_id", "acme").text("recipient", recipient);
        ids.push(marked(server.post("/v1/watermarks", form).await).await);
    }
    assert_eq!(names(&server.data(), "blobs/hosts").len(), 1);
    server.mark(other_obj(), "acme").await;
    assert_eq!(names(&server.data(), "blobs/hosts").len(), 2);
    let server = server.restart().await;
    for (id, file) in &ids {
        let verdict = server.verify(file_form(file)).await;
        assert_eq!(verdict["matches"][0]["watermark_id"], id.as_str());
    }
    for (id, _) in &ids {
        let url = server.url(&format!("/v1/watermarks/{id}"));
        assert!(server.client.delete(url).send().await.unwrap().status().is_success());
    }
    let server = server.restart().await;
    assert_eq!(names(&server.data(), "blobs/hosts").len(), 2, "revoked records count");
    assert!(names(&server.data(), "blobs/quarantine").is_empty());
    assert_eq!(check(&server.data()), (Some(0), Vec::new()), "beside the running service");
}

#[tokio::test]
async fn registrations_of_one_host_at_once_keep_it() {
    let server = Server::with(Settings { workers: Some(2), ..Settings::default() }).await;
    let mark = || server.mark(obj(), "acme");
    let marks = futures::future::join_all((0..6).map(|_| mark())).await;
    assert_eq!(marks.len(), 6);
    assert_eq!(names(&server.data(), "blobs/hosts").len(), 1);
    assert_eq!(names(&server.data(), "blobs/files").len(), 6);
    assert_eq!(check(&server.data()), (Some(0), Vec::new()));
}

#[tokio::test]
async fn a_registry_that_is_gone_or_older_is_refused_and_nothing_is_lost() {
    let server = Server::with(settings()).await;
    let (first, _) = server.mark(obj(), "acme").await;
    let directory = server.stop().await;
    let data = directory.path().join("data");
    let registry = data.join("registry.sqlite");
    let older = std::fs::read(&registry).unwrap();
    let server = Server::on(directory, settings()).await;
    let (second, file) = server.mark(obj(), "acme").await;
    let directory = server.stop().await;
    let newest = std::fs::read(&registry).unwrap();

    std::fs::remove_file(&registry).unwrap();
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::RegistryGone { files: 3, .. }), "{error}");
    assert!(error.to_string().contains("--accept-registry"), "{error}");
    // Also if an accident has removed the note.
    let note = std::fs::read(data.join("registry.seen")).unwrap();
    std::fs::remove_file(data.join("registry.seen")).unwrap();
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::RegistryGone { .. }), "{error}");
    std::fs::write(data.join("registry.seen"), note).unwrap();

    std::fs::write(&registry, &older).unwrap();
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::OlderRegistry { found: 1, noted: 2, .. }), "{error}");
    let mine = |name: &str| (name.to_owned(), "registry.sqlite".to_owned());
    let expected =
        vec![("blob_without_record".to_owned(), format!("files/{second}")), mine("registry_older")];
    assert_eq!(check(&data), (Some(1), expected));

    // Accepted: blobs that the older registry does not have go to quarantine.
    let accept = Settings { accept_registry: Some(true), ..settings() };
    let server = Server::on(directory, accept).await;
    assert_eq!(names(&data, "blobs/files"), std::slice::from_ref(&first));
    let batch = names(&data, "blobs/quarantine").pop().unwrap();
    assert_eq!(
        names(&data, &format!("blobs/quarantine/{batch}/files")),
        std::slice::from_ref(&second)
    );
    assert_eq!(names(&data, "blobs/hosts").len(), 1);
    assert_eq!(server.verify(file_form(&file)).await["verdict"], "no_match");
    let directory = server.stop().await;
    // The newest registry is found again, and the file is put back.
    let quarantined = data.join(format!("blobs/quarantine/{batch}/files/{second}"));
    std::fs::rename(quarantined, data.join(format!("blobs/files/{second}"))).unwrap();
    std::fs::write(&registry, &newest).unwrap();
    let server = Server::on(directory, settings()).await;
    assert_eq!(server.verify(file_form(&file)).await["verdict"], "match");
    let directory = server.stop().await;

    // Another registry.
    let other = tempfile::tempdir().unwrap();
    let server = Server::on(other, settings()).await;
    server.mark(other_obj(), "acme").await;
    let other = server.stop().await;
    std::fs::copy(other.path().join("data/registry.sqlite"), &registry).unwrap();
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::OtherRegistry { .. }), "{error}");
}

#[tokio::test]
async fn more_orphans_than_a_crash_leaves_are_refused_and_fewer_quarantined() {
    let server = Server::with(settings()).await;
    let directory = server.stop().await;
    let data = directory.path().join("data");
    let orphan = || data.join(format!("blobs/files/{}", uuid::Uuid::now_v7()));
    // Two workers and two in the queue, with a file and a host each.
    for _ in 0..9 {
        std::fs::write(orphan(), "x").unwrap();
    }
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::Orphans { files: 9, few: 8, .. }), "{error}");
    std::fs::remove_file(data.join("blobs/files").join(&names(&data, "blobs/files")[0])).unwrap();
    std::fs::write(data.join("blobs/hosts/half#1"), "x").unwrap();
    std::fs::write(data.join("uploads/half"), "x").unwrap();
    std::fs::write(data.join("master.keys.new-1"), "x").unwrap();
    let server = Server::on(directory, settings()).await;
    server.assert_empty("orphans and unfinished files").await;
    let batch = names(&data, "blobs/quarantine").pop().unwrap();
    assert_eq!(names(&data, &format!("blobs/quarantine/{batch}/files")).len(), 8);
    assert!(names(&data, "blobs/hosts").is_empty());
    assert!(!data.join("master.keys.new-1").exists());
}

#[tokio::test]
async fn missing_keys_refuse_the_start_and_are_named() {
    let server = Server::with(settings()).await;
    let (id, file) = server.mark(obj(), "acme").await;
    let directory = server.stop().await;
    let data = directory.path().join("data");
    let keys = data.join("master.keys");
    let key_id = KeyRing::open(&keys).unwrap().current().to_owned();
    let right = std::fs::read(&keys).unwrap();
    let named = |error: &StartError| {
        let text = error.to_string();
        assert!(matches!(error, StartError::MissingKeys { .. }), "{text}");
        assert!(text.contains(&format!("{key_id} (of 1 records)")), "{text}");
    };

    std::fs::remove_file(&keys).unwrap();
    named(&refused(&directory, settings()).await);
    assert!(!keys.exists(), "no key was made");
    KeyRing::open_or_create(&keys).unwrap();
    named(&refused(&directory, settings()).await);
    let wrong = std::fs::read(&keys).unwrap();
    std::fs::write(&keys, &right).unwrap();
    let environment = || {
        let mut settings = settings();
        settings.master_key = Some(quadmark::config::SecretText::new("ab".repeat(32)));
        settings
    };
    named(&refused(&directory, environment()).await);
    std::fs::write(&keys, &wrong).unwrap();
    let (code, found) = check(&data);
    assert_eq!((code, found), (Some(1), vec![("key_missing".to_owned(), key_id.clone())]));

    // `quadmark verify` says the same.
    let config = |settings: Settings| {
        let own = Settings { data: Some(data.clone()), ..Settings::default() };
        Config::decide(own.over(settings)).unwrap()
    };
    let error = Service::open_to_verify(config(settings())).await.err().unwrap();
    named(&error);

    // The operator has lost the key.
    let allow = Settings { allow_unreadable_marks: Some(true), ..settings() };
    Service::open_to_verify(config(allow.clone())).await.unwrap().close().await;
    let server = Server::on(directory, allow.clone()).await;
    assert_eq!(server.get_json("/readyz").await["unreadable_marks"], 1);
    assert_eq!(server.get_json("/livez").await["unreadable_marks"], Value::Null);
    let page = server.get("/metrics").await.text().await.unwrap();
    assert!(page.contains("\nquadmark_marks_unreadable 1\n"), "{page}");
    let asked = server.post("/v1/verifications", file_form(&file)).await;
    problem(asked, 422, "nothing_to_compare").await;
    let url = server.url(&format!("/v1/watermarks/{id}"));
    for _ in 0..2 {
        assert!(server.client.delete(&url).send().await.unwrap().status().is_success());
    }
    assert_eq!(server.get_json("/readyz").await["unreadable_marks"], Value::Null);
    // A revoked mark is not searched for and needs no key.
    let directory = server.stop().await;
    let server = Server::on(directory, settings()).await;
    assert_eq!(server.get_json("/readyz").await["status"], "ok");
    let directory = server.stop().await;
    // A new key is made only for an empty registry.
    std::fs::remove_file(&keys).unwrap();
    let error = refused(&directory, settings()).await;
    assert!(matches!(error, StartError::MissingKeys { .. }), "{error}");
    let _server = Server::on(directory, allow).await;
    assert!(keys.exists());
}

/// A fault: its name in the check, the file it is about, and how to make it.
type Fault<'a> = (&'a str, String, Box<dyn Fn() + 'a>);

#[tokio::test]
async fn the_check_finds_each_fault_and_changes_nothing() {
    let server = Server::with(settings()).await;
    let (first, _) = server.mark(obj(), "acme").await;
    let (second, _) = server.mark(other_obj(), "acme").await;
    let directory = server.stop().await;
    let data = directory.path().join("data");
    assert_eq!(check(&data), (Some(0), Vec::new()));
    assert_eq!(check(&data.join("nothing")).0, Some(2));
    let files = everything(&data);
    let restore = || {
        std::fs::remove_dir_all(&data).unwrap();
        for (path, bytes) in &files {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        std::fs::set_permissions(data.join("master.keys"), private()).unwrap();
    };
    let file = |id: &str| data.join("blobs/files").join(id);
    let host = data.join("blobs/hosts").join(&names(&data, "blobs/hosts")[0]);
    let host_name = format!("hosts/{}", names(&data, "blobs/hosts")[0]);
    let flip = |path: &Path| {
        let mut bytes = std::fs::read(path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(path, bytes).unwrap();
    };
    let stranger = uuid::Uuid::now_v7().to_string();
    let faults: [Fault<'_>; 7] = [
        (
            "file_missing",
            format!("files/{first}"),
            Box::new(|| std::fs::remove_file(file(&first)).unwrap()),
        ),
        ("file_damaged", format!("files/{second}"), Box::new(|| flip(&file(&second)))),
        ("host_missing", host_name.clone(), Box::new(|| std::fs::remove_file(&host).unwrap())),
        ("host_damaged", host_name, Box::new(|| flip(&host))),
        (
            "blob_without_record",
            format!("files/{stranger}"),
            Box::new(|| std::fs::write(file(&stranger), "x").unwrap()),
        ),
        (
            "unfinished",
            format!("{}#1", file(&first).display()),
            Box::new(|| std::fs::write(format!("{}#1", file(&first).display()), "x").unwrap()),
        ),
        (
            "keys_unusable",
            data.join("master.keys").display().to_string(),
            Box::new(|| std::fs::write(data.join("master.keys"), "x").unwrap()),
        ),
    ];
    for (kind, what, harm) in &faults {
        restore();
        harm();
        let before = everything(&data);
        let (code, mut found) = check(&data);
        assert_eq!(code, Some(1), "{kind}");
        found.retain(|(found, _)| found != "key_missing");
        assert_eq!(found, [((*kind).to_owned(), what.clone())]);
        assert!(everything(&data) == before, "{kind}: the check changed something");
    }
    restore();
    let registry = data.join("registry.sqlite");
    let mut bytes = std::fs::read(&registry).unwrap();
    for byte in bytes.iter_mut().skip(5000).take(20_000) {
        *byte = 0x55;
    }
    std::fs::write(&registry, bytes).unwrap();
    let (code, found) = check(&data);
    assert!(code == Some(1) && found.iter().any(|(kind, _)| kind == "database"), "{found:?}");
}

fn private() -> std::fs::Permissions {
    #[cfg(unix)]
    return std::os::unix::fs::PermissionsExt::from_mode(0o600);
    #[cfg(not(unix))]
    return std::fs::metadata(env!("CARGO_MANIFEST_DIR")).unwrap().permissions();
}

#[tokio::test]
async fn hosts_of_the_old_layout_move_to_the_new_one() {
    let server = Server::with(settings()).await;
    let mesh = Sample::Blob.mesh(10_000).unwrap();
    let (first, file) = server.mark(&to_glb(&mesh), "acme").await;
    let (second, _) = server.mark(&to_glb(&mesh), "acme").await;
    let directory = server.stop().await;
    let data = directory.path().join("data");
    let hosts = data.join("blobs/hosts");
    let key = names(&data, "blobs/hosts").pop().unwrap();
    for id in [&first, &second] {
        std::fs::copy(hosts.join(&key), hosts.join(id)).unwrap();
    }
    std::fs::remove_file(hosts.join(&key)).unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(data.join("registry.sqlite"));
    let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
    for statement in [
        "INSERT INTO hosts SELECT host_sha256, (SELECT sketch FROM geometries) FROM watermarks LIMIT 1",
        "DELETE FROM geometries",
        "UPDATE watermarks SET host_geometry = NULL",
    ] {
        sqlx::query(statement).execute(&pool).await.unwrap();
    }
    pool.close().await;
    let server = Server::on(directory, settings()).await;
    assert_eq!(names(&data, "blobs/hosts"), [key]);
    assert_eq!(check(&data), (Some(0), Vec::new()));
    // A part is recognised through its host.
    let suspect = half_of(&file);
    let verdict = server.verify(file_form(&suspect)).await;
    assert_eq!(verdict["matches"][0]["watermark_id"], first.as_str(), "{verdict}");
}

/// Every number with the fewest digits that read back to it.
fn exact_obj(mesh: &Mesh) -> Vec<u8> {
    let vertex = |p: &glam::DVec3| format!("v {} {} {}\n", p.x, p.y, p.z);
    let face = |t: &[u32; 3]| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
    let vertices = mesh.positions().iter().map(vertex);
    vertices.chain(mesh.triangles().iter().map(face)).collect::<String>().into_bytes()
}

/// The triangles of one half of the mesh, scaled and moved.
fn half_of(file: &[u8]) -> Vec<u8> {
    let mesh = Asset::read(file, &Limits::default()).unwrap().into_mesh();
    let shift = glam::DVec3::new(1.5, -0.25, 3.0);
    let positions: Vec<glam::DVec3> = mesh.positions().iter().map(|p| 1.25 * p + shift).collect();
    let middle = positions.iter().map(|p| p.x).sum::<f64>() / positions.len() as f64;
    let kept = |t: &&[u32; 3]| positions[t[0] as usize].x > middle;
    let triangles = mesh.triangles().iter().filter(kept).copied().collect();
    to_obj(&Mesh::new(positions.clone(), triangles).unwrap())
}
