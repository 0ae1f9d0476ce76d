//! The service over HTTP: router, wire types, uploads, errors.
//!
//! axum and tower appear only here. A handler reads a request, calls one use case and writes the
//! answer; it decides nothing. Must not know how the registry stores records, nor anything of
//! formats and watermarks beyond their names and parameters.

mod accept;
mod code;
mod conditional;
mod connections;
mod contract;
mod docs;
mod document;
mod download;
mod envelope;
mod error;
mod fields;
mod forms;
mod inspections;
mod intake;
mod metrics;
mod operations;
mod origin;
mod range;
mod schemas;
mod server;
mod stall;
mod upload;
mod verifications;
mod watermarks;
mod wire;

use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tower_http::catch_panic::CatchPanicLayer;

use crate::service::Service;

pub use document::openapi_yaml;
pub use server::{ServeError, serve, serve_on};

/// The state that every handler receives.
#[derive(Clone)]
pub(crate) struct App {
    service: Arc<Service>,
    metrics: Arc<metrics::Metrics>,
    origins: Arc<origin::Origins>,
}

/// All routes over a service that listens on `address`.
pub fn router(service: Arc<Service>, address: SocketAddr) -> Router {
    let origins = origin::Origins::new(address, &service.config().allowed_hosts);
    let metrics = Arc::new(metrics::Metrics::default());
    let app = App { service, metrics, origins: Arc::new(origins) };
    Router::new()
        .route("/v1/watermarks", post(watermarks::embed).get(watermarks::page))
        .route("/v1/watermarks/{id}", get(watermarks::record).delete(watermarks::revoke))
        .route("/v1/watermarks/{id}/file", get(watermarks::file))
        .route("/v1/verifications", post(verifications::verify))
        .route("/v1/verifications/{id}", get(verifications::verification))
        .route("/v1/inspections", post(inspections::inspect))
        .route("/livez", get(operations::livez))
        .route("/readyz", get(operations::readyz))
        .route("/metrics", get(operations::metrics))
        .route("/openapi.yaml", get(operations::openapi))
        .route("/docs", get(operations::docs))
        // Bodies are limited in `intake`, which counts every byte of a body, whether it declares
        // its length or not.
        .layer(DefaultBodyLimit::disable())
        .layer(CatchPanicLayer::custom(panicked))
        .layer(from_fn_with_state(app.clone(), envelope::envelope))
        .with_state(app)
}

#[allow(clippy::needless_pass_by_value)] // the layer wants it so
fn panicked(panic: Box<dyn std::any::Any + Send>) -> Response {
    let text = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("a panic without a text");
    error::ApiError::internal(text).into_response()
}
