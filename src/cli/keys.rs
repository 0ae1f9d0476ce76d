//! `quadmark keys list|rotate`: master keys by their ids. No key is ever printed.

use std::process::ExitCode;

use clap::Subcommand;
use quadmark::config::{Config, ConfigArgs};
use quadmark::keys::KeyRing;

use super::{Failure, Outcome};

/// What to do with the master keys.
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// List the ids, oldest first; the last one makes new marks.
    List(ConfigArgs),
    /// Add a new key for new marks; old ones stay, to verify old marks. Restart the service and
    /// back the key file up afterwards.
    Rotate(ConfigArgs),
}

/// Prints ids.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    match &arguments.command {
        Command::List(args) => {
            for id in open(args)?.ids() {
                println!("{id}");
            }
        }
        Command::Rotate(args) => println!("{}", open(args)?.rotate()?),
    }
    Ok(ExitCode::SUCCESS)
}

fn open(args: &ConfigArgs) -> Result<KeyRing, Failure> {
    let mut args = args.clone();
    // No address is used here, so no address is refused.
    args.settings.insecure_listen = Some(true);
    let config = Config::load(args)?;
    Ok(match &config.master_key {
        Some(key) => KeyRing::from_hex(key.reveal())?,
        // No key is made here: a mistyped --data should not make a key that nobody uses.
        None => KeyRing::open(&config.master_key_file)?,
    })
}
