//! The quadmark command: the service, and the same work on files without a server.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
