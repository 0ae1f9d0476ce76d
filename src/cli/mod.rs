//! The command line: one file per command.
//!
//! Results go to standard output, messages for a person to standard error. Exit code 0: done, or a
//! match; 1: no match, or a faulty data directory; 2: error.

mod check;
mod compare;
mod embed;
mod extract;
mod files;
mod health;
mod inspect;
mod keys;
mod lab;
mod names;
mod sample;
mod serve;
mod verify;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use quadmark::formats::Limits;
use quadmark::relief::{Amplitude, Layers};
use quadmark::watermark::{BitCount, MarkKey, Method, Modulation, Strength, WatermarkError};

/// The exit code of a command, or an error text for the user.
type Outcome = Result<ExitCode, Failure>;

/// An error as the user reads it: the error and all its causes in one line.
struct Failure(String);

impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        let mut text = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            let cause_text = cause.to_string();
            // A transparent error has the text of its source, which is not repeated.
            if !text.contains(&cause_text) {
                text = format!("{text}: {cause_text}");
            }
            source = cause.source();
        }
        Self(text)
    }
}

#[derive(Parser)]
#[command(name = "quadmark", version, about, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve over HTTP until SIGINT or SIGTERM.
    Serve(Box<serve::Arguments>),
    /// Mark a file with a key of your own; no server, no registry.
    Embed(embed::Arguments),
    /// Read the message of a marked file blindly.
    Extract(extract::Arguments),
    /// Say what a file is and how well it can carry a mark.
    Inspect(inspect::Arguments),
    /// Measure the distance between two surfaces (MRMS and Hausdorff, as Metro does).
    Compare(compare::Arguments),
    /// Mark, attack and read meshes: what a mark costs and what it survives, as tables and a report.
    Lab(Box<lab::Arguments>),
    /// Compare a file with the marks of a data directory; a service may be running on it.
    Verify(Box<verify::Arguments>),
    /// Check that a data directory is whole: records, files, hosts, keys, database.
    Check(Box<check::Arguments>),
    /// List or rotate master keys, by their ids.
    Keys(Box<keys::Arguments>),
    /// Ask a running service whether it is ready.
    Health(Box<health::Arguments>),
    /// Print the `OpenAPI` document.
    Openapi,
    /// Write a generated mesh, to try things on.
    Sample(sample::Arguments),
}

/// Runs the command that the process was started with.
pub(crate) fn run() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Embed(arguments) => embed::run(&arguments),
        Command::Extract(arguments) => extract::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Lab(arguments) => lab::run(&arguments),
        Command::Serve(arguments) => serve::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Keys(arguments) => keys::run(&arguments),
        Command::Health(arguments) => health::run(&arguments),
        Command::Openapi => {
            print!("{}", quadmark::http::openapi_yaml());
            Ok(ExitCode::SUCCESS)
        }
        Command::Sample(arguments) => sample::run(&arguments),
    };
    outcome.unwrap_or_else(|Failure(text)| {
        eprintln!("quadmark: {text}");
        ExitCode::from(2)
    })
}

/// On the command line the caller's own files are read, so only the machine limits them.
fn limits() -> Limits {
    Limits { max_vertices: 1 << 31, max_triangles: 1 << 31, max_bytes: usize::MAX }
}

fn parse_key(digits: &str) -> Result<MarkKey, WatermarkError> {
    MarkKey::from_hex(digits)
}

fn parse_method(name: &str) -> Result<Method, WatermarkError> {
    name.parse()
}

fn parse_layers(name: &str) -> Result<Layers, &'static str> {
    name.parse()
}

fn parse_modulation(name: &str) -> Result<Modulation, WatermarkError> {
    name.parse()
}

fn parse_strength(text: &str) -> Result<Strength, String> {
    let alpha: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    Strength::new(alpha).map_err(|error| error.to_string())
}

fn parse_amplitude(text: &str) -> Result<Amplitude, String> {
    Amplitude::new(text.parse().map_err(|_| format!("{text:?} is not a number"))?)
}

fn parse_bits(text: &str) -> Result<BitCount, String> {
    let bits: u32 = text.parse().map_err(|_| format!("{text:?} is not a whole number"))?;
    BitCount::new(bits).map_err(|error| error.to_string())
}
