//! A service built from parts that a test chooses.

use std::path::Path;
use std::sync::Arc;

use super::Service;
use crate::blobs::Blobs;
use crate::config::{Config, Settings};
use crate::keys::KeyRing;
use crate::registry::Registry;

/// The key of these services.
pub(super) fn keys() -> KeyRing {
    KeyRing::from_hex(&"0a".repeat(32)).unwrap()
}

/// A service on a directory, with nothing loaded.
pub(super) fn service(data: &Path, registry: impl Registry + 'static) -> Arc<Service> {
    let settings = Settings { data: Some(data.to_owned()), ..Settings::default() };
    let config = Config::decide(settings).unwrap();
    let blobs = Blobs::local(&data.join("blobs")).unwrap();
    Service::over(config, keys(), registry, blobs, data.to_owned(), false)
}
