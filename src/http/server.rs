//! Listening, serving, and an orderly shutdown.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tracing::{info, warn};

use super::connections::{Connections, SPARE};
use super::router;
use crate::config::Config;
use crate::service::{Service, StartError};

/// Time for the answers of jobs that ended at the end of the grace period.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// Pause after a connection could not be accepted.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);
/// Files that are open beside connections: those of the registry, uploads, and blobs that are read.
const OTHER_FILES: usize = 512;

/// Why the server did not start or stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The service behind it did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The address cannot be used.
    #[error("cannot listen on {address}: {source}; choose another with --listen ADDR:PORT")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        source: io::Error,
    },
    /// The system does not report the listener's address.
    #[error("the server failed: {0}")]
    Serve(#[from] io::Error),
}

/// Opens the service, listens, and serves until SIGINT or SIGTERM; then drains.
///
/// # Errors
/// [`ServeError`], with a text for the operator.
pub async fn serve(config: Config) -> Result<(), ServeError> {
    let address = config.listen;
    // The address first: a taken port should not cost a load of the whole registry.
    let listener = TcpListener::bind(address)
        .await
        .map_err(|source| ServeError::Listen { address, source })?;
    if !address.ip().is_loopback() {
        warn!(%address, "other machines can reach this service and it does not authenticate them");
    }
    raise_file_limit(config.max_connections);
    let service = Service::open(config).await?;
    serve_on(listener, service, signalled()).await
}

/// Serves on a listener until `shutdown` ends, then lets running requests end and closes the
/// service.
///
/// # Errors
/// [`ServeError::Serve`].
pub async fn serve_on(
    listener: TcpListener,
    service: Arc<Service>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let config = service.config();
    let grace = config.shutdown_grace;
    let address = listener.local_addr()?;
    info!(%address, docs = format!("http://{address}/docs"), "listening");
    let going_down = CancellationToken::new();
    let connections = Connections::new(
        router(service.clone(), address),
        config.max_connections,
        config.idle_timeout,
        going_down.clone(),
    );
    tokio::select! {
        () = accept(&listener, &connections) => {}
        () = shutdown => {}
    }
    drop(listener);
    going_down.cancel();
    info!(seconds = grace.as_secs(), "going down; running requests may end");
    let deadline = tokio::time::Instant::now() + grace;
    let drained = service.drain(grace).await;
    // Answers may still be being written, at least shortly after the last job.
    let deadline = deadline.max(tokio::time::Instant::now() + LAST_WORDS);
    if tokio::time::timeout_at(deadline, connections.ended()).await.is_err() {
        connections.cut();
    }
    let ended = service.close().await && drained;
    if ended {
        info!("all requests ended; bye");
    } else {
        warn!("some requests were cut off; nothing half done is left");
    }
    Ok(())
}

/// Accepts connections until it is dropped.
async fn accept(listener: &TcpListener, connections: &Connections) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => connections.take(stream),
            // The client was gone before its connection was accepted.
            Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
            Err(error) => {
                // Mostly the limit of open files is reached; the end of a connection helps.
                warn!(%error, "a connection cannot be accepted");
                tokio::time::sleep(ACCEPT_AGAIN).await;
            }
        }
    }
}

/// Lets the process open as many files as its connections need, if the system allows it: many
/// systems start with a limit of 1,024.
#[cfg(unix)]
fn raise_file_limit(connections: usize) {
    use rustix::process::{Resource, getrlimit, setrlimit};
    let wanted = u64::try_from(connections + SPARE + OTHER_FILES).unwrap_or(u64::MAX);
    let mut limit = getrlimit(Resource::Nofile);
    if limit.current.is_none_or(|current| current >= wanted) {
        return;
    }
    let allowed = limit.maximum.map_or(wanted, |most| most.min(wanted));
    limit.current = Some(allowed);
    if setrlimit(Resource::Nofile, limit).is_err() || allowed < wanted {
        warn!(allowed, wanted, "fewer files may be open than max_connections wants (ulimit -n)");
    }
}

#[cfg(not(unix))]
fn raise_file_limit(_: usize) {}

async fn signalled() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        match signal(SignalKind::terminate()) {
            Ok(mut terminate) => tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            },
            Err(_) => {
                let _ = tokio::signal::ctrl_c().await;
            }
        }
    }
    #[cfg(not(unix))]
    {
        let _ = tokio::signal::ctrl_c().await;
    }
}
