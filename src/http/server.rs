//! Listening, serving, and going down in order.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tracing::{info, warn};

use super::router;
use crate::config::Config;
use crate::service::{Service, StartError};

/// For the answers of jobs that ended at the end of the grace.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// Why the server did not start or did not go on.
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
        /// What the system said.
        source: io::Error,
    },
    /// Serving failed.
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
    let service = Service::open(config).await?;
    serve_on(listener, service, signalled()).await
}

/// Serves on a listener until `shutdown` ends; then lets running requests end and closes the
/// service.
///
/// # Errors
/// [`ServeError::Serve`].
pub async fn serve_on(
    listener: TcpListener,
    service: Arc<Service>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let grace = service.config().shutdown_grace;
    let address = listener.local_addr()?;
    info!(%address, docs = format!("http://{address}/docs"), "listening");
    let going_down = CancellationToken::new();
    let told = going_down.clone();
    let server = axum::serve(listener, router(service.clone()))
        .with_graceful_shutdown(async move {
            shutdown.await;
            told.cancel();
        })
        .into_future();
    let server = tokio::spawn(server);
    let mut server = std::pin::pin!(server);
    let served = tokio::select! {
        // Only when accepting fails for good.
        served = &mut server => Some(served),
        () = going_down.cancelled() => None,
    };
    info!(seconds = grace.as_secs(), "going down; running requests may end");
    let deadline = tokio::time::Instant::now() + grace;
    let drained = service.drain(grace).await;
    let served = if let Some(served) = served {
        served
    } else {
        // Answers are still being written, at least a moment after the last job.
        let deadline = deadline.max(tokio::time::Instant::now() + LAST_WORDS);
        tokio::time::timeout_at(deadline, &mut server).await.unwrap_or(Ok(Ok(())))
    };
    let ended = service.close().await && drained;
    if ended {
        info!("all requests ended; bye");
    } else {
        warn!("some requests were cut off; nothing half done is left");
    }
    served.map_err(io::Error::other)??;
    Ok(())
}

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
