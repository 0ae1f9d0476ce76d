//! The table of settings in `docs/settings.md`, made from the definition of the flags. A test holds the
//! document to it.

use clap::Args as _;

use super::Settings;

/// The head of the table.
const HEAD: &str = "| flag, variable | default | meaning |\n|---|---|---|\n";

/// The one setting that is no flag: other users of a machine see the flags of a process.
const MASTER_KEY: &str = "| `QUADMARK_MASTER_KEY` | none | 64 hexadecimal digits that stand in for \
    the master key file, or several such keys with commas between them. The last one makes new marks, \
    the others verify old ones. |\n";

/// A default that stands for itself, not for words.
fn is_literal(default: &str) -> bool {
    default.chars().all(|c| !c.is_whitespace())
}

/// The table, one row per setting in the order of the fields.
fn table() -> String {
    let command = Settings::augment_args(clap::Command::new("settings"));
    let mut rows = vec![HEAD.to_owned()];
    for argument in command.get_arguments() {
        let flag = argument.get_long().unwrap();
        let variable = argument.get_env().unwrap().to_str().unwrap();
        if variable == "QUADMARK_MASTER_KEY_FILE" {
            rows.push(MASTER_KEY.to_owned());
        }
        let help = argument.get_long_help().or(argument.get_help()).unwrap().to_string();
        let help = help.replace('\n', " ");
        let (meaning, default) = match help.split_once(" [default: ") {
            Some((meaning, rest)) => {
                let (default, after) = rest.split_once(']').unwrap();
                (format!("{meaning}{after}"), default)
            }
            None => (help.clone(), "false"),
        };
        let default = if is_literal(default) { format!("`{default}`") } else { default.to_owned() };
        let default = if default == "`none`" { "none".to_owned() } else { default };
        let meaning = meaning.trim_end_matches('.');
        rows.push(format!("| `--{flag}` `{variable}` | {default} | {meaning}. |\n"));
    }
    rows.concat()
}

#[test]
fn the_document_of_settings_is_current() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/settings.md");
    let committed = std::fs::read_to_string(path).unwrap();
    let start = committed.find(HEAD).unwrap();
    let end = start + committed[start..].find("\n\n").unwrap() + 1;
    let now = [&committed[..start], &table(), &committed[end..]].concat();
    if std::env::var_os("QUADMARK_UPDATE_GOLDEN").is_some() {
        std::fs::write(path, &now).unwrap();
    } else {
        assert!(
            committed == now,
            "docs/settings.md differs from the flags: run QUADMARK_UPDATE_GOLDEN=1 cargo test --lib \
             the_document_of_settings"
        );
    }
}
