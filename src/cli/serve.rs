//! `quadmark serve`: the HTTP service.

use std::io::IsTerminal;
use std::process::ExitCode;
use std::time::Duration;

use quadmark::config::{Config, ConfigArgs, LogFormat};

use super::Outcome;

/// The source of the settings.
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    config: ConfigArgs,
}

/// Serves until SIGINT or SIGTERM.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = Config::load(arguments.config.clone())?;
    start_log(&config);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let served = runtime.block_on(quadmark::http::serve(config));
    // A job that ignores its stop signal must not keep the process alive.
    runtime.shutdown_timeout(Duration::from_secs(1));
    served?;
    Ok(ExitCode::SUCCESS)
}

/// Log lines go to standard error: standard output belongs to data.
fn start_log(config: &Config) {
    let filter = tracing_subscriber::EnvFilter::new(&config.log_level);
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    // Fails only if a log was started before; then that one is used.
    let _ = match config.log_format {
        LogFormat::Text => log.try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
}
