//! `quadmark extract`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use quadmark::formats::Asset;
use quadmark::marking::extract_file;
use quadmark::mesh::Mesh;
use quadmark::mesh::surface::Surface;
use quadmark::recognition::{HostModel, SuspectModel, relief_of};
use quadmark::registration::{Budget, WorkLimits};
use quadmark::relief::Amplitude;
use quadmark::watermark::{BitCount, MarkKey, Modulation};
use serde_json::json;

use super::{Failure, Outcome, files, limits};

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
    /// mean or variance: the statistic that the method of the mark moves.
    #[arg(long, default_value = "mean", value_parser = super::parse_modulation)]
    modulation: Modulation,
    /// The host. With it the relief is read instead, against the host, and the answer is how sure
    /// it is that the file carries the relief of this key. The exit code is 1 when it is not sure.
    #[arg(long)]
    host: Option<PathBuf>,
    /// How far the relief moves the surface, as the report of its embedding says: a share of the
    /// diagonal [default: 0.00008].
    #[arg(long, requires = "host", value_name = "SHARE", value_parser = super::parse_amplitude)]
    amplitude: Option<Amplitude>,
    /// Print bits, margins, counts and the frame as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { key, bits, modulation, .. } = arguments;
    if let Some(host) = &arguments.host {
        return relief(arguments, host);
    }
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
            "layout_class": found.layout_class,
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

/// A bound below this is a match. It is the default threshold of the service.
const CERTAIN: f64 = -9.0;

fn relief(arguments: &Arguments, host: &Path) -> Outcome {
    let mesh = |path: &Path| -> Result<Mesh, Failure> {
        Ok(Asset::read(&files::read(path)?, &limits())?.into_mesh())
    };
    let (host, suspect) = (HostModel::new(mesh(host)?), mesh(&arguments.input)?);
    let surface = Surface::new(&suspect);
    let suspect_model = SuspectModel::new(&suspect, &surface);
    let budget = Budget::new(u64::MAX);
    let within = WorkLimits { budget: &budget, stop: &|| false };
    let amplitude = arguments.amplitude.unwrap_or_default();
    let found = relief_of(&host, &suspect_model, &arguments.key, amplitude, within);
    let log10_fp = found.map_or(0.0, |found| found.log10_fp);
    let is_match = log10_fp < CERTAIN;
    if arguments.json {
        files::print_json(&json!({
            "match": is_match,
            "log10_fp": log10_fp,
            "cells_read": found.map(|found| found.read),
            "cells_agreeing": found.map(|found| found.agreeing),
        }))?;
    } else {
        let verdict = if is_match { "match" } else { "no match" };
        println!("{verdict}: log10 of the false-positive bound is {log10_fp:.1}");
    }
    Ok(ExitCode::from(u8::from(!is_match)))
}
