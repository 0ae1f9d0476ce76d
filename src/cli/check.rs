//! `quadmark check`: whether a data directory is whole.

use std::process::ExitCode;

use quadmark::config::{Config, ConfigArgs};
use quadmark::service::check;

use super::{Outcome, files};

/// The data directory to check.
///
/// Reads every record, every marked file and every host, and compares their hashes. Looks for files
/// that no record owns and for missing master keys, and lets the database check itself. Nothing is
/// changed. While a service runs on the directory, a mark that is being registered at that moment
/// may be listed as a file without a record, or as unfinished: then check again. Exit code 0:
/// everything is as it should be; 1: something is not, with one line for each finding; 2: the
/// directory cannot be checked.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Print what was found as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

/// Prints one line for each finding.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut args = arguments.config.clone();
    // No address is used here, so no address is refused.
    args.settings.insecure_listen = Some(true);
    let config = Config::load(args)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let checked = runtime.block_on(check(&config))?;
    if arguments.json {
        files::print_json(&checked)?;
    } else {
        for finding in &checked.findings {
            println!("{}  {}  {}", finding.kind, finding.what, finding.detail);
        }
    }
    eprintln!(
        "{} records, {} files and {} hosts as they should be; {} findings",
        checked.records,
        checked.files,
        checked.hosts,
        checked.findings.len()
    );
    for (kind, count) in checked.kinds() {
        eprintln!("  {kind}: {count}");
    }
    Ok(ExitCode::from(u8::from(!checked.findings.is_empty())))
}
