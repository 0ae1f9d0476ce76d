//! One layer of settings, as a file, the environment or flags give them.

use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use zeroize::Zeroizing;

use super::ConfigError;

/// A text that must not be printed: `Debug` hides it, and its memory is wiped on drop.
#[derive(Clone, Deserialize)]
#[serde(from = "String")]
pub struct SecretText(Zeroizing<String>);

impl From<String> for SecretText {
    fn from(text: String) -> Self {
        Self::new(text)
    }
}

impl SecretText {
    /// Wraps a secret.
    #[must_use]
    pub fn new(text: String) -> Self {
        Self(Zeroizing::new(text))
    }

    /// The secret itself, for the code that needs it.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for SecretText {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("(secret)")
    }
}

/// The form of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The source of the settings on a command line: the name of the file, and the flags that override
/// it.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ConfigArgs {
    /// TOML file with settings (the names are those of the flags, with `_` for `-`)
    #[arg(long, env = "QUADMARK_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Settings from flags and the environment.
    #[command(flatten)]
    pub settings: Settings,
}

/// One layer of settings. What it leaves open, the layer below decides.
///
/// A boolean flag may stand alone (`--insecure-listen`) or have a value (`--keep-files=false`).
#[derive(Debug, Clone, Default, Deserialize, clap::Args)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Settings")]
pub struct Settings {
    /// Address and port to listen on [default: 127.0.0.1:8080]
    #[arg(long, env = "QUADMARK_LISTEN", value_name = "ADDR:PORT")]
    pub listen: Option<SocketAddr>,
    /// Directory of registry, files and master key file [default: ./data]
    #[arg(long, env = "QUADMARK_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// 64 hex digits in place of the master key file, or several such keys with commas between
    /// them. The last key makes new marks, as in the file; the others verify old ones. Not a flag.
    #[arg(skip)]
    pub master_key: Option<SecretText>,
    /// File of master keys [default: master.keys in the data directory]
    #[arg(long, env = "QUADMARK_MASTER_KEY_FILE", value_name = "FILE")]
    pub master_key_file: Option<PathBuf>,
    /// Listen on an address that other machines reach, although nothing authenticates them
    #[arg(long, env = "QUADMARK_INSECURE_LISTEN", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub insecure_listen: Option<bool>,
    /// Most bytes of one request body [default: 268435456]
    #[arg(long, env = "QUADMARK_MAX_BODY_BYTES", value_name = "BYTES")]
    pub max_body_bytes: Option<u64>,
    /// Jobs that run at once [default: the number of cores]
    #[arg(long, env = "QUADMARK_WORKERS", value_name = "COUNT")]
    pub workers: Option<usize>,
    /// Jobs that may wait for a worker; more are refused with 503 [default: 16]
    #[arg(long, env = "QUADMARK_QUEUE", value_name = "COUNT")]
    pub queue: Option<usize>,
    /// Memory that running jobs may be estimated to need together [default: 4294967296]
    #[arg(long, env = "QUADMARK_MEMORY_BUDGET_BYTES", value_name = "BYTES")]
    pub memory_budget_bytes: Option<u64>,
    /// Seconds from the end of an upload to its answer, at most [default: 300]
    #[arg(long, env = "QUADMARK_REQUEST_TIMEOUT", value_name = "SECONDS")]
    pub request_timeout: Option<u64>,
    /// Seconds that one upload may take, at most [default: 600]
    #[arg(long, env = "QUADMARK_UPLOAD_TIMEOUT", value_name = "SECONDS")]
    pub upload_timeout: Option<u64>,
    /// Seconds that a connection may stand still: while it waits for the header of a request, while
    /// the bytes of an upload do not come, while nobody reads an answer [default: 30]
    #[arg(long, env = "QUADMARK_IDLE_TIMEOUT", value_name = "SECONDS")]
    pub idle_timeout: Option<u64>,
    /// Connections at once; a few more are served for /livez and /readyz [default: 4096]
    #[arg(long, env = "QUADMARK_MAX_CONNECTIONS", value_name = "COUNT")]
    pub max_connections: Option<usize>,
    /// Uploads on their way at once; more are refused with 503 [default: 64]
    #[arg(long, env = "QUADMARK_MAX_UPLOADS", value_name = "COUNT")]
    pub max_uploads: Option<usize>,
    /// Bytes that all uploads may take of the disk together [default: 16 largest bodies]
    #[arg(long, env = "QUADMARK_UPLOAD_BUDGET_BYTES", value_name = "BYTES")]
    pub upload_budget_bytes: Option<u64>,
    /// Bytes of the disk that stay free; with less, uploads are refused with 507 and /readyz fails
    /// [default: 268435456]
    #[arg(long, env = "QUADMARK_MIN_FREE_BYTES", value_name = "BYTES")]
    pub min_free_bytes: Option<u64>,
    /// Further names by which clients may address the service, with or without a port, beside
    /// loopback names and the address that it listens on. Pages shown under these names may use the
    /// service. Needed behind a proxy, and with --insecure-listen for clients that use a name
    /// instead of an address. `*` allows any name, which gives up the protection against pages that
    /// make their own name lead here [default: none]
    #[arg(long, env = "QUADMARK_ALLOWED_HOSTS", value_name = "NAME,...", value_delimiter = ',')]
    pub allowed_hosts: Option<Vec<String>>,
    /// Seconds that running requests get to end at shutdown [default: 30]
    #[arg(long, env = "QUADMARK_SHUTDOWN_GRACE", value_name = "SECONDS")]
    pub shutdown_grace: Option<u64>,
    /// Files up to this size are also read back by an independent reader [default: 16777216]
    #[arg(long, env = "QUADMARK_INDEPENDENT_CHECK_MAX_BYTES", value_name = "BYTES")]
    pub independent_check_max_bytes: Option<u64>,
    /// Keep every marked file, to hand it out again [default: true]
    #[arg(long, env = "QUADMARK_KEEP_FILES", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub keep_files: Option<bool>,
    /// Keep every host's geometry, for detectors that need it [default: true]
    #[arg(long, env = "QUADMARK_KEEP_HOST", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub keep_host: Option<bool>,
    /// log10 of the false-positive bound below which a verdict is `match` [default: -9]
    #[arg(
        long,
        env = "QUADMARK_MATCH_THRESHOLD_LOG10",
        value_name = "LOG10",
        allow_negative_numbers = true
    )]
    pub match_threshold_log10: Option<f64>,
    /// log10 of the bound below which a verdict is `inconclusive` [default: -3]
    #[arg(
        long,
        env = "QUADMARK_INCONCLUSIVE_THRESHOLD_LOG10",
        value_name = "LOG10",
        allow_negative_numbers = true
    )]
    pub inconclusive_threshold_log10: Option<f64>,
    /// Start although master keys that records need are missing; their marks are not recognised
    #[arg(long, env = "QUADMARK_ALLOW_UNREADABLE_MARKS", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub allow_unreadable_marks: Option<bool>,
    /// Start although the registry is missing, older or another one, or files without a record lie
    /// beside it; these files go to quarantine
    #[arg(long, env = "QUADMARK_ACCEPT_REGISTRY", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub accept_registry: Option<bool>,
    /// Days that files without a record wait in quarantine before a start deletes them [default: 30]
    #[arg(long, env = "QUADMARK_QUARANTINE_DAYS", value_name = "DAYS")]
    pub quarantine_days: Option<u32>,
    /// Form of log lines [default: text]
    #[arg(long, env = "QUADMARK_LOG_FORMAT", value_name = "FORMAT")]
    pub log_format: Option<LogFormat>,
    /// What to log: error, warn, info, debug, trace, or `target=level` pairs [default: info]
    #[arg(long, env = "QUADMARK_LOG_LEVEL", value_name = "LEVEL")]
    pub log_level: Option<String>,
    /// Most vertices of one file [default: 50000000]
    #[arg(long, env = "QUADMARK_MAX_VERTICES", value_name = "COUNT")]
    pub max_vertices: Option<usize>,
    /// Most triangles of one file [default: 100000000]
    #[arg(long, env = "QUADMARK_MAX_TRIANGLES", value_name = "COUNT")]
    pub max_triangles: Option<usize>,
}

macro_rules! layered {
    ($top:ident over $below:ident: $($name:ident)*) => {
        Settings { $($name: $top.$name.or($below.$name)),* }
    };
}

impl Settings {
    /// These settings, completed by those of `below`.
    #[must_use]
    pub fn over(self, below: Self) -> Self {
        let top = self;
        layered!(top over below: listen data master_key master_key_file insecure_listen
            max_body_bytes workers queue memory_budget_bytes request_timeout upload_timeout
            idle_timeout max_connections max_uploads upload_budget_bytes min_free_bytes allowed_hosts
            shutdown_grace independent_check_max_bytes keep_files keep_host match_threshold_log10
            inconclusive_threshold_log10 allow_unreadable_marks accept_registry
            quarantine_days log_format log_level max_vertices max_triangles)
    }

    pub(super) fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
        // The message alone is reported: the full text quotes the line, which may hold the master
        // key.
        toml::from_str(&text).map_err(|error: toml::de::Error| {
            let line = error
                .span()
                .and_then(|span| text.get(..span.start))
                .map_or(1, |before| before.matches('\n').count() + 1);
            let reason = format!("line {line}: {}", without_values(error.message()));
            ConfigError::Malformed { path: path.to_owned(), reason }
        })
    }
}

/// A parser's message without quoted values (`string "..."`), which may be secrets.
fn without_values(message: &str) -> String {
    match message.find("string \"") {
        Some(at) => format!("{}a string of the wrong form", message.get(..at).unwrap_or_default()),
        None => message.to_owned(),
    }
}
