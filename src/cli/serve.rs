//! `quadmark serve`: the HTTP service.

use quadmark::config::{Config, ConfigArgs, LogFormat};

/// Serve until SIGINT or SIGTERM.
///
/// # Errors
/// A text for the operator: a setting, the data directory, the key file, the address.
pub(crate) fn run(args: ConfigArgs) -> Result<(), Box<dyn std::error::Error>> {
    let config = Config::load(args)?;
    start_log(&config);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let served = runtime.block_on(quadmark::http::serve(config));
    // A job that does not heed its stop must not keep the process alive.
    runtime.shutdown_timeout(std::time::Duration::from_secs(1));
    Ok(served?)
}

/// Log lines go to stderr: stdout belongs to data.
fn start_log(config: &Config) {
    let filter = tracing_subscriber::EnvFilter::new(&config.log_level);
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // Fails only when a log was started before; then that one serves.
    let _ = match config.log_format {
        LogFormat::Text => log.try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
}
