//! `quadmark embed`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use quadmark::marking::{Amplitude, Layers, MarkRequest, MaxDistortion, mark, mark_within};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Strength};
use serde_json::json;

use super::{Failure, Outcome, files, limits};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The host file (OBJ, GLB or glTF); - is standard input.
    input: PathBuf,
    /// Where the marked file goes; - is standard output.
    #[arg(short, long)]
    output: PathBuf,
    /// The 32-byte mark key, 64 hexadecimal digits. Keep it: it alone reads the mark.
    #[arg(long, env = "QUADMARK_KEY", hide_env_values = true, value_parser = super::parse_key)]
    key: MarkKey,
    /// The message in hexadecimal digits, filled up with zero bits; random when not given.
    #[arg(long)]
    message: Option<String>,
    /// cho-mean, cho-var, qsp-mean, qsp-var, exact-mean or exact-var.
    #[arg(long, default_value_t, value_parser = super::parse_method)]
    method: Method,
    /// blind, relief or both. The relief survives a new tessellation and fragments. It is read
    /// against the host with `extract --host`: keep the host.
    #[arg(long, default_value = "blind", value_parser = super::parse_layers)]
    layers: Layers,
    /// How far each bin's statistic is moved: 0.01 to 0.25; 0.15 when not given.
    #[arg(long, value_parser = super::parse_strength)]
    strength: Option<Strength>,
    /// Mark as strongly as this distortion allows (MRMS as a share of the diagonal, 0.000001 to
    /// 0.1), with at most --strength if that is given.
    #[arg(long)]
    max_distortion: Option<MaxDistortion>,
    /// How many bits the mark carries: 16 to 256.
    #[arg(long, default_value_t, value_parser = super::parse_bits)]
    bits: BitCount,
    /// The paper's single pass, for comparison: the result is not checked and may misread.
    #[arg(long)]
    open_loop: bool,
    /// Print a report as JSON (to standard error when the file goes to standard output).
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let message = match &arguments.message {
        Some(digits) => Message::from_hex(digits, arguments.bits)?,
        None => random_message(arguments.bits)?,
    };
    let host = files::read(&arguments.input)?;
    let request = MarkRequest {
        key: &arguments.key,
        others: &[],
        message: &message,
        params: EmbedParams {
            method: arguments.method,
            strength: arguments.strength.unwrap_or_default(),
            bits: arguments.bits,
            closed_loop: !arguments.open_loop,
        },
        limits: limits(),
        stop: &|| false,
        layers: arguments.layers,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 16 << 20,
    };
    let marked = match arguments.max_distortion {
        None => mark(&host, &request)?,
        Some(limit) => {
            let strongest = arguments.strength.unwrap_or(Strength::MAX);
            mark_within(&host, &request, limit, strongest)?
        }
    };
    files::write(&arguments.output, &marked.bytes)?;
    let report = json!({
        "message": message.to_hex(),
        "method": arguments.method.name(),
        "strength": marked.report.strength.get(),
        "bits": arguments.bits.get(),
        "format": marked.format.extension(),
        "report": marked.report,
    });
    if !arguments.json {
        eprintln!(
            "marked {} with message {} ({} of {} bins, {} rounds, smallest margin {:.4}, mrms \
             {:.2e} of the diagonal, {} coordinates with more decimals)",
            arguments.output.display(),
            message.to_hex(),
            marked.report.usable_bins,
            arguments.bits,
            marked.report.rounds,
            marked.report.smallest_margin,
            marked.report.quality.mrms,
            marked.report.more_decimals,
        );
    } else if arguments.output == Path::new("-") {
        eprintln!("{report}");
    } else {
        files::print_json(&report)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn random_message(bits: BitCount) -> Result<Message, Failure> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes)?;
    let all = bytes.iter().flat_map(|byte| (0..8).map(move |k| byte >> k & 1 == 1));
    Ok(Message::from_bits(all.take(bits.get()).collect())?)
}
