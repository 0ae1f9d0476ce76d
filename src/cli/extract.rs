//! `quadmark extract`.

use std::path::PathBuf;
use std::process::ExitCode;

use quadmark::marking::extract_file;
use quadmark::watermark::{BitCount, MarkKey, Modulation};
use serde_json::json;

use super::{Outcome, files, limits};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The file to read (OBJ, GLB or glTF); - is standard input.
    input: PathBuf,
    /// The mark key, 64 hexadecimal digits.
    #[arg(long, env = "QUADMARK_KEY", hide_env_values = true, value_parser = super::parse_key)]
    key: MarkKey,
    /// How many bits the mark carries.
    #[arg(long, default_value_t, value_parser = super::parse_bits)]
    bits: BitCount,
    /// mean or variance: the statistic of the method it was marked with.
    #[arg(long, default_value = "mean", value_parser = super::parse_modulation)]
    modulation: Modulation,
    /// Print bits, margins, counts and the frame as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { key, bits, modulation, .. } = arguments;
    let found = extract_file(&files::read(&arguments.input)?, key, *bits, *modulation, &limits())?;
    let message = found.message().map(|message| message.to_hex());
    if arguments.json {
        files::print_json(&json!({
            "bits": found.bits.iter().map(|bit| bit.map(u8::from)).collect::<Vec<_>>(),
            "message": message,
            "margins": found.margins,
            "counts": found.counts,
            "centre": found.frame.centre.to_array(),
            "rho_min": found.frame.rho_min,
            "rho_max": found.frame.rho_max,
            "lattice_class": found.lattice_class,
        }))?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(message) = message {
        println!("{message}");
    } else {
        let digit = |bit: &Option<bool>| match bit {
            Some(true) => '1',
            Some(false) => '0',
            None => '?',
        };
        println!("{}", found.bits.iter().map(digit).collect::<String>());
        eprintln!("bits shown as ? lie in bins with too few vertices to be read");
    }
    Ok(ExitCode::SUCCESS)
}
