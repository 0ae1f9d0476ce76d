//! `quadmark keys list|rotate`: master keys by their ids. No key is ever printed.

use clap::Subcommand;
use quadmark::config::{Config, ConfigArgs};
use quadmark::keys::KeyRing;

/// What to do with the master keys.
#[derive(Debug, Subcommand)]
pub(crate) enum KeysCommand {
    /// List the ids, oldest first; the last one makes new marks
    List(ConfigArgs),
    /// Add a new key for new marks; old ones stay, to verify old marks. Restart the service and
    /// back the key file up afterwards
    Rotate(ConfigArgs),
}

/// # Errors
/// A text: the key file cannot be read or written.
pub(crate) fn run(command: KeysCommand) -> Result<(), Box<dyn std::error::Error>> {
    match command {
        KeysCommand::List(args) => {
            for id in open(args)?.ids() {
                println!("{id}");
            }
        }
        KeysCommand::Rotate(args) => println!("{}", open(args)?.rotate()?),
    }
    Ok(())
}

fn open(args: ConfigArgs) -> Result<KeyRing, Box<dyn std::error::Error>> {
    let config = Config::load(args)?;
    Ok(match &config.master_key {
        Some(key) => KeyRing::from_hex(key.reveal())?,
        // Not made here: a mistyped --data should not make a key that nobody uses.
        None => KeyRing::open(&config.master_key_file)?,
    })
}
