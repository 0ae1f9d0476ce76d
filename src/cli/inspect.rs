//! `quadmark inspect`.

use std::path::PathBuf;
use std::process::ExitCode;

use quadmark::forecast::{Expected, expected};
use quadmark::formats::Asset;
use quadmark::marking::{Inspection, inspect_asset};
use quadmark::watermark::{BitCount, EmbedParams, Method, Strength};

use super::{Outcome, files, limits};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The file to inspect (OBJ, GLB or glTF); - is standard input.
    input: PathBuf,
    /// The method that a mark would use.
    #[arg(long, default_value_t, value_parser = super::parse_method)]
    method: Method,
    /// The strength that a mark would have.
    #[arg(long, default_value = "0.1", value_parser = super::parse_strength)]
    strength: Strength,
    /// How many bits a mark would carry.
    #[arg(long, default_value_t, value_parser = super::parse_bits)]
    bits: BitCount,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let Arguments { method, strength, bits, .. } = *arguments;
    let params = EmbedParams { method, strength, bits, ..EmbedParams::default() };
    let asset = Asset::read(&files::read(&arguments.input)?, &limits())?;
    let seen = inspect_asset(&asset, &params)?;
    let expected = expected(asset.mesh(), &seen, &params, &|| false);
    if arguments.json {
        files::print_json(&InspectedFile { inspection: &seen, expected: &expected })?;
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "{}: {} vertices, {} triangles, {} carriers",
        seen.format, seen.vertices, seen.triangles, seen.carriers
    );
    println!(
        "a mark of {} bits would have {} usable bins of {} needed; bins of {} vertices \
         (median), {} (poorest)",
        seen.bits, seen.usable_bins, seen.needed_bins, seen.median_count, seen.least_count
    );
    println!(
        "{}; best log10 of the false-positive bound {:.1}; signal over sampling noise {:.1}",
        if seen.markable { "it can be marked" } else { "it cannot be marked" },
        seen.best_log10_fp,
        seen.expected_margin
    );
    for Expected { attack, log10_fp, error, .. } in expected {
        println!("after {attack}: log10 of the bound about {log10_fp:.1}, give or take {error:.1}");
    }
    Ok(ExitCode::SUCCESS)
}

/// The output as JSON.
#[derive(serde::Serialize)]
struct InspectedFile<'a> {
    #[serde(flatten)]
    inspection: &'a Inspection,
    expected: &'a [Expected],
}
