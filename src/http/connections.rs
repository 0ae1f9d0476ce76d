//! Connections: how many there may be, and how long one may stand still.
//!
//! Beyond the cap, a few more connections are served for one request each, so that a full service
//! still answers `/livez` and `/readyz`. Other requests on them are told to try again later. Beyond
//! these, new connections are closed at once.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1::Builder;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt as _;
use tracing::debug;

use super::stall::Writes;

/// Number of connections beyond the cap that are served for one request each.
pub(super) const SPARE: usize = 64;
/// Longest wait for the request on a connection beyond the cap.
const SPARE_TIMEOUT: Duration = Duration::from_secs(5);
/// Most bytes of the header of a request, with all lines before the body: far more than any client
/// sends, far fewer than would do harm.
const MOST_HEADER_BYTES: usize = 32 << 10;
/// Most header lines of a request.
const MOST_HEADERS: usize = 100;
/// Most bytes per connection that are read ahead of a body or wait to be written.
const BUFFER: usize = 64 << 10;

/// Marks requests that came on a connection beyond the cap.
#[derive(Debug, Clone, Copy)]
pub(super) struct OverCap;

/// All connections of a server.
pub(super) struct Connections {
    router: Router,
    idle: Duration,
    places: Arc<Semaphore>,
    spare: Arc<Semaphore>,
    tasks: TaskTracker,
    going_down: CancellationToken,
    cut: CancellationToken,
}

impl Connections {
    /// Accepts at most `most` connections to `router`, each of which may stand still for at most
    /// `idle`.
    pub(super) fn new(
        router: Router,
        most: usize,
        idle: Duration,
        going_down: CancellationToken,
    ) -> Self {
        Self {
            router,
            idle,
            places: Arc::new(Semaphore::new(most.min(Semaphore::MAX_PERMITS))),
            spare: Arc::new(Semaphore::new(SPARE)),
            tasks: TaskTracker::new(),
            going_down,
            cut: CancellationToken::new(),
        }
    }

    /// Serves a new connection, or closes it.
    pub(super) fn take(&self, stream: TcpStream) {
        let (place, crowded) = match self.places.clone().try_acquire_owned() {
            Ok(place) => (place, false),
            Err(_) => match self.spare.clone().try_acquire_owned() {
                Ok(place) => (place, true),
                Err(_) => return,
            },
        };
        // Whole answers are written at once; waiting for more data gains nothing.
        let _ = stream.set_nodelay(true);
        let service = self.router.clone().map_request(move |mut request: Request<Incoming>| {
            if crowded {
                request.extensions_mut().insert(OverCap);
            }
            request
        });
        let header_timeout = if crowded { self.idle.min(SPARE_TIMEOUT) } else { self.idle };
        let mut builder = Builder::new();
        builder
            .timer(TokioTimer::new())
            // Limits the read of a header, and the wait of a connection for its next request.
            .header_read_timeout(header_timeout)
            .max_header_size(MOST_HEADER_BYTES)
            .max_headers(MOST_HEADERS)
            .max_buf_size(BUFFER)
            .keep_alive(!crowded);
        let stream = TokioIo::new(Writes::new(stream, self.idle));
        let connection = builder.serve_connection(stream, TowerToHyperService::new(service));
        let (going_down, cut) = (self.going_down.clone(), self.cut.clone());
        self.tasks.spawn(async move {
            let _place = place;
            let mut connection = std::pin::pin!(connection);
            let mut told = false;
            let ended = loop {
                tokio::select! {
                    ended = connection.as_mut() => break ended,
                    () = going_down.cancelled(), if !told => {
                        told = true;
                        connection.as_mut().graceful_shutdown();
                    }
                    () = cut.cancelled() => return,
                }
            };
            if let Err(error) = ended {
                debug!(%error, "a connection ended early");
            }
        });
    }

    /// Waits until all connections have ended, as they do when the server shuts down.
    pub(super) async fn ended(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }

    /// Ends the remaining connections.
    pub(super) fn cut(&self) {
        self.cut.cancel();
    }
}
