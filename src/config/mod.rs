//! Settings in layers: defaults, then a TOML file, then `QUADMARK_...` in the environment, then
//! flags. Each layer overrides the one before it.
//!
//! Every `Config` comes from [`Config::load`] or [`Config::decide`] and so has been validated. This
//! module must not open any file but the configuration file, and must not print a secret: the
//! master key is never a flag, because other users see the flags of a process, and never in
//! `Debug`.

#[cfg(test)]
mod document;
mod settings;

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use crate::formats::Limits;

pub use settings::{ConfigArgs, LogFormat, SecretText, Settings};

/// Bytes of memory that one job is estimated to need per byte of its upload.
pub const MEMORY_PER_UPLOAD_BYTE: u64 = 12;

/// Longest timeout, a week: a longer one is a typing error.
const LONGEST_TIMEOUT: Duration = Duration::from_hours(7 * 24);

/// Longest wait in quarantine, a century.
const LONGEST_QUARANTINE_DAYS: u32 = 36_500;

/// Why the configuration cannot be used. The text names the setting and says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file named by `--config` or `QUADMARK_CONFIG` cannot be read.
    #[error("the configuration file {path} cannot be read: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file is not TOML, or has a key that is not a setting.
    #[error("the configuration file {path} is not valid: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, and what is wrong there.
        reason: String,
    },
    /// A setting has a value that cannot be used.
    #[error("{setting}: {reason}")]
    Invalid {
        /// The setting's name, as in the TOML file.
        setting: &'static str,
        /// What is wrong, and which values are right.
        reason: String,
    },
}

/// All settings, with defaults filled in, and validated.
#[derive(Debug, Clone)]
#[allow(missing_docs)] // each is documented where it is read: in `Settings`
#[allow(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
pub struct Config {
    pub listen: SocketAddr,
    pub data: PathBuf,
    pub master_key: Option<SecretText>,
    pub master_key_file: PathBuf,
    pub insecure_listen: bool,
    pub max_body_bytes: u64,
    pub workers: usize,
    pub queue: usize,
    pub memory_budget_bytes: u64,
    pub request_timeout: Duration,
    pub upload_timeout: Duration,
    pub idle_timeout: Duration,
    pub max_connections: usize,
    pub max_uploads: usize,
    pub upload_budget_bytes: u64,
    pub min_free_bytes: u64,
    pub allowed_hosts: Vec<String>,
    pub shutdown_grace: Duration,
    pub independent_check_max_bytes: usize,
    pub keep_files: bool,
    pub keep_host: bool,
    pub match_threshold_log10: f64,
    pub inconclusive_threshold_log10: f64,
    pub allow_unreadable_marks: bool,
    pub accept_registry: bool,
    pub quarantine_days: u32,
    pub log_format: LogFormat,
    pub log_level: String,
    pub limits: Limits,
}

impl Config {
    /// Reads the configuration file if one is named, puts environment and flags over it, and
    /// validates.
    ///
    /// # Errors
    /// [`ConfigError`], which names the file or the setting.
    pub fn load(args: ConfigArgs) -> Result<Self, ConfigError> {
        let file = args.config.as_deref().map(Settings::from_file).transpose()?;
        let mut settings = args.settings;
        if settings.master_key.is_none() {
            settings.master_key = std::env::var("QUADMARK_MASTER_KEY").ok().map(SecretText::new);
        }
        Self::decide(settings.over(file.unwrap_or_default()))
    }

    /// Fills in the defaults and validates.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`], which names the setting.
    pub fn decide(settings: Settings) -> Result<Self, ConfigError> {
        let data = settings.data.unwrap_or_else(|| PathBuf::from("data"));
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let max_body_bytes = settings.max_body_bytes.unwrap_or(256 << 20);
        let standard = Limits::default();
        let too_large = |setting| ConfigError::Invalid {
            setting,
            reason: "more than this machine can address; choose a smaller number".to_owned(),
        };
        let config = Self {
            listen: settings.listen.unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 8080))),
            master_key: settings.master_key,
            master_key_file: settings.master_key_file.unwrap_or_else(|| data.join("master.keys")),
            insecure_listen: settings.insecure_listen.unwrap_or(false),
            max_body_bytes,
            workers: settings.workers.unwrap_or(cores),
            queue: settings.queue.unwrap_or(16),
            memory_budget_bytes: settings.memory_budget_bytes.unwrap_or(4 << 30),
            request_timeout: Duration::from_secs(settings.request_timeout.unwrap_or(300)),
            upload_timeout: Duration::from_secs(settings.upload_timeout.unwrap_or(600)),
            idle_timeout: Duration::from_secs(settings.idle_timeout.unwrap_or(30)),
            max_connections: settings.max_connections.unwrap_or(4096),
            max_uploads: settings.max_uploads.unwrap_or(64),
            upload_budget_bytes: settings
                .upload_budget_bytes
                .unwrap_or_else(|| max_body_bytes.saturating_mul(16)),
            min_free_bytes: settings.min_free_bytes.unwrap_or(256 << 20),
            allowed_hosts: settings.allowed_hosts.unwrap_or_default(),
            shutdown_grace: Duration::from_secs(settings.shutdown_grace.unwrap_or(30)),
            independent_check_max_bytes: usize::try_from(
                settings.independent_check_max_bytes.unwrap_or(16 << 20),
            )
            .map_err(|_| too_large("independent_check_max_bytes"))?,
            keep_files: settings.keep_files.unwrap_or(true),
            keep_host: settings.keep_host.unwrap_or(true),
            match_threshold_log10: settings.match_threshold_log10.unwrap_or(-9.0),
            inconclusive_threshold_log10: settings.inconclusive_threshold_log10.unwrap_or(-3.0),
            allow_unreadable_marks: settings.allow_unreadable_marks.unwrap_or(false),
            accept_registry: settings.accept_registry.unwrap_or(false),
            quarantine_days: settings.quarantine_days.unwrap_or(30),
            log_format: settings.log_format.unwrap_or(LogFormat::Text),
            log_level: settings.log_level.unwrap_or_else(|| "info".to_owned()),
            limits: Limits {
                max_vertices: settings.max_vertices.unwrap_or(standard.max_vertices),
                max_triangles: settings.max_triangles.unwrap_or(standard.max_triangles),
                max_bytes: usize::try_from(max_body_bytes)
                    .map_err(|_| too_large("max_body_bytes"))?,
            },
            data,
        };
        config.validate()?;
        Ok(config)
    }

    fn validate(&self) -> Result<(), ConfigError> {
        let refuse = |setting, reason: &str| {
            Err(ConfigError::Invalid { setting, reason: reason.to_owned() })
        };
        if !self.insecure_listen && !self.listen.ip().is_loopback() {
            return refuse(
                "listen",
                "this address can be reached from other machines and the service does not \
                 authenticate them; listen on 127.0.0.1 behind a proxy that does, or say \
                 --insecure-listen if the network is trusted",
            );
        }
        if self.workers == 0 || self.workers > 1024 {
            return refuse("workers", "must be from 1 to 1024");
        }
        if self.queue > 100_000 {
            return refuse("queue", "must be at most 100000");
        }
        if self.max_body_bytes == 0 {
            return refuse("max_body_bytes", "must be at least 1");
        }
        if self.memory_budget_bytes == 0 {
            return refuse("memory_budget_bytes", "must be at least 1");
        }
        if self.max_connections == 0 || self.max_connections > 1_000_000 {
            return refuse("max_connections", "must be from 1 to 1000000");
        }
        if self.max_uploads == 0 {
            return refuse("max_uploads", "must be at least 1");
        }
        if self.upload_budget_bytes < self.max_body_bytes {
            return refuse(
                "upload_budget_bytes",
                "must be at least max_body_bytes: the largest upload would never fit",
            );
        }
        let is_host = |name: &String| {
            !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic() && !b"/@?#,".contains(&b))
        };
        if !self.allowed_hosts.iter().all(is_host) {
            return refuse(
                "allowed_hosts",
                "must be names without scheme and path, such as marks.example.com or marks:8443",
            );
        }
        let timeouts = [
            ("request_timeout", self.request_timeout),
            ("upload_timeout", self.upload_timeout),
            ("idle_timeout", self.idle_timeout),
            ("shutdown_grace", self.shutdown_grace),
        ];
        for (setting, timeout) in timeouts {
            if timeout.is_zero() || timeout > LONGEST_TIMEOUT {
                return refuse(setting, "must be from 1 second to 7 days (604800)");
            }
        }
        let certain = self.match_threshold_log10;
        let unclear = self.inconclusive_threshold_log10;
        if !(-300.0..0.0).contains(&certain) {
            return refuse(
                "match_threshold_log10",
                "must be below 0 and at least -300, such as -9: one false match in 10^9 requests",
            );
        }
        if !(certain..=0.0).contains(&unclear) {
            return refuse(
                "inconclusive_threshold_log10",
                "must lie between match_threshold_log10 and 0",
            );
        }
        if !(1..=LONGEST_QUARANTINE_DAYS).contains(&self.quarantine_days) {
            return refuse("quarantine_days", "must be from 1 to 36500");
        }
        if self.limits.max_vertices == 0 || u32::try_from(self.limits.max_vertices).is_err() {
            return refuse("max_vertices", "must be from 1 to 4294967295");
        }
        if self.limits.max_triangles == 0 || u32::try_from(self.limits.max_triangles).is_err() {
            return refuse("max_triangles", "must be from 1 to 4294967295");
        }
        if self.log_level.parse::<tracing_subscriber::EnvFilter>().is_err() {
            return refuse("log_level", "must be error, warn, info, debug, trace, or target=level");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use clap::{Args, FromArgMatches};

    fn from_flags(flags: &[&str]) -> Settings {
        let command = ConfigArgs::augment_args(clap::Command::new("serve"));
        let words = std::iter::once("serve").chain(flags.iter().copied());
        ConfigArgs::from_arg_matches(&command.get_matches_from(words)).unwrap().settings
    }

    #[test]
    fn defaults_need_nothing() {
        let config = Config::decide(Settings::default()).unwrap();
        assert_eq!(config.listen.to_string(), "127.0.0.1:8080");
        assert_eq!(config.data, Path::new("data"));
        assert_eq!(config.master_key_file, Path::new("data/master.keys"));
        assert_eq!(config.max_body_bytes, 268_435_456);
        assert!(config.keep_files && config.keep_host && !config.insecure_listen);
    }

    #[test]
    fn flags_win_over_the_file() {
        let file: Settings = toml::from_str("queue = 3\nworkers = 7\nkeep_files = true").unwrap();
        let flags = from_flags(&["--queue", "5", "--keep-files=false", "--data", "/tmp/x"]);
        let config = Config::decide(flags.over(file)).unwrap();
        assert_eq!((config.queue, config.workers, config.keep_files), (5, 7, false));
        assert_eq!(config.master_key_file, Path::new("/tmp/x/master.keys"));
    }

    #[test]
    fn refusals_name_the_setting() {
        let cases = [
            ("listen = '0.0.0.0:80'", "listen"),
            ("workers = 0", "workers"),
            ("queue = 1000000", "queue"),
            ("max_body_bytes = 0", "max_body_bytes"),
            ("request_timeout = 0", "request_timeout"),
            ("match_threshold_log10 = 1.0", "match_threshold_log10"),
            ("match_threshold_log10 = nan", "match_threshold_log10"),
            ("inconclusive_threshold_log10 = -20.0", "inconclusive_threshold_log10"),
            ("idle_timeout = 0", "idle_timeout"),
            ("max_connections = 0", "max_connections"),
            ("max_uploads = 0", "max_uploads"),
            ("upload_budget_bytes = 1", "upload_budget_bytes"),
            ("allowed_hosts = ['https://marks.test']", "allowed_hosts"),
            ("max_vertices = 5000000000", "max_vertices"),
            ("quarantine_days = 0", "quarantine_days"),
            ("log_level = '=='", "log_level"),
        ];
        for (text, setting) in cases {
            let error = Config::decide(toml::from_str(text).unwrap()).unwrap_err();
            assert!(error.to_string().starts_with(setting), "{text}: {error}");
        }
        let open = "listen = '0.0.0.0:80'\ninsecure_listen = true";
        assert!(Config::decide(toml::from_str(open).unwrap()).is_ok());
    }

    #[test]
    fn unknown_keys_and_secrets_in_files() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("quadmark.toml");
        std::fs::write(&path, "queue = 3\nqueu = 4\n").unwrap();
        let error = Settings::from_file(&path).unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("queu"), "{error}");
        std::fs::write(&path, "queue = \"cafe0123\"\n").unwrap();
        let error = Settings::from_file(&path).unwrap_err().to_string();
        assert!(error.contains("line 1") && !error.contains("cafe0123"), "{error}");
        std::fs::write(&path, "master_key = \"cafe0123\"\n").unwrap();
        let settings = Settings::from_file(&path).unwrap();
        assert!(!format!("{settings:?}").contains("cafe0123"));
    }
}
