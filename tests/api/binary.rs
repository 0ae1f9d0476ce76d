//! The program itself, started as by a user and stopped as by an operator.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

const PROGRAM: &str = env!("CARGO_BIN_EXE_quadmark");

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub(crate) fn program() -> Command {
    let mut command = Command::new(PROGRAM);
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("QUADMARK_")) {
        command.env_remove(name);
    }
    command
}

#[test]
fn serves_reports_and_goes_down_in_order() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let child = program()
        .args(["serve", "--listen", "127.0.0.1:0", "--log-format", "json", "--data"])
        .arg(&data)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut running = Running(child);
    let mut lines = BufReader::new(running.0.stderr.take().unwrap()).lines();
    let mut log = String::new();
    let address = lines
        .by_ref()
        .map(|line| line.unwrap())
        .find_map(|line| {
            log.push_str(&line);
            let line: serde_json::Value = serde_json::from_str(&line).unwrap();
            (line["message"] == "listening").then(|| line["address"].as_str().unwrap().to_owned())
        })
        .expect("it listens");
    let key_file = std::fs::read_to_string(data.join("master.keys")).unwrap();
    let (key_id, key) = key_file.trim().split_once(' ').unwrap();
    assert!(log.contains("master.keys") && log.contains(key_id) && !log.contains(key), "{log}");
    let health = program().args(["health", "--listen", &address]).output().unwrap();
    assert!(health.status.success(), "{}", String::from_utf8_lossy(&health.stderr));
    let keys = program().args(["keys", "list", "--data"]).arg(&data).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&keys.stdout).trim(), key_id);
    // Verifying from the command line does not disturb the service.
    let mesh = directory.path().join("mesh.obj");
    std::fs::write(&mesh, crate::server::obj()).unwrap();
    let verify = program().args(["verify", "--json"]).arg(&mesh).arg("--data").arg(&data).output();
    let verify = verify.unwrap();
    assert_eq!(verify.status.code(), Some(1), "{}", String::from_utf8_lossy(&verify.stderr));
    let verdict: serde_json::Value = serde_json::from_slice(&verify.stdout).unwrap();
    assert_eq!(verdict["verdict"], "no_match");
    // A second service on the same directory is refused.
    let second =
        program().args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(&data).output().unwrap();
    assert_eq!(second.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&second.stderr).contains("in use"), "{second:?}");
    let kill = Command::new("kill").arg(running.0.id().to_string()).status();
    if kill.is_ok_and(|status| status.success()) {
        let rest: Vec<String> = lines.map(|line| line.unwrap()).collect();
        assert_eq!(running.0.wait().unwrap().code(), Some(0), "{rest:?}");
    }
    let open = program().args(["serve", "--listen", "0.0.0.0:0", "--data"]).arg(&data).output();
    let open = open.unwrap();
    assert_eq!(open.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&open.stderr).contains("--insecure-listen"), "{open:?}");
}

#[test]
fn settings_from_a_file_the_environment_and_flags() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("quadmark.toml");
    // The key of the golden derivation; its id is pinned there.
    let key = hex::encode(std::array::from_fn::<u8, 32, _>(|byte| u8::try_from(byte).unwrap()));
    let list = |prepare: &dyn Fn(&mut Command)| {
        let mut command = program();
        command.args(["keys", "list"]);
        prepare(&mut command);
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let known = (Some(0), "7f2971a5".to_owned());
    assert_eq!(list(&|command| _ = command.env("QUADMARK_MASTER_KEY", &key)), known);
    std::fs::write(&file, format!("master_key = \"{key}\"\nkeep_files = false\n")).unwrap();
    assert_eq!(list(&|command| _ = command.arg("--config").arg(&file)), known);
    assert_eq!(list(&|command| _ = command.env("QUADMARK_CONFIG", &file)), known);
    let booleans = |command: &mut Command| {
        command.env("QUADMARK_CONFIG", &file);
        command.env("QUADMARK_KEEP_FILES", "true").env("QUADMARK_INSECURE_LISTEN", "true");
        command.env("QUADMARK_LISTEN", "0.0.0.0:80").env("QUADMARK_MATCH_THRESHOLD_LOG10", "-12");
    };
    assert_eq!(list(&booleans), known);
    let code = |prepare: &dyn Fn(&mut Command)| list(prepare).0;
    assert_eq!(code(&|command| _ = command.arg("--data").arg(directory.path())), Some(2));
    assert_eq!(code(&|command| _ = command.env("QUADMARK_WORKERS", "none")), Some(2));
    std::fs::write(&file, "master_kee = 1").unwrap();
    assert_eq!(code(&|command| _ = command.arg("--config").arg(&file)), Some(2));
    assert!(!directory.path().join("master.keys").exists());
}
