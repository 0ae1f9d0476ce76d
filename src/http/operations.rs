//! Health, metrics and documentation.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};

use super::App;
use super::docs::docs_page;
use super::document::openapi_yaml;
use super::error::ApiError;
use super::wire::HealthBody;

const OK: HealthBody =
    HealthBody { status: "ok", version: env!("CARGO_PKG_VERSION"), unreadable_marks: None };

/// Whether the process is alive.
#[utoipa::path(
    get, path = "/livez", tag = "operations", operation_id = "livez",
    responses((status = 200, description = "It is", body = HealthBody))
)]
pub(super) async fn livez() -> Json<HealthBody> {
    Json(OK)
}

/// Whether requests can be served: the registry answers, the disk has room, no shutdown is running.
#[utoipa::path(
    get, path = "/readyz", tag = "operations", operation_id = "readyz",
    responses(
        (status = 200, description = "They can", body = HealthBody),
    )
)]
pub(super) async fn readyz(State(app): State<App>) -> Result<Json<HealthBody>, ApiError> {
    app.service.ready().await?;
    let unreadable = app.service.unreadable_marks() as u64;
    Ok(Json(HealthBody { unreadable_marks: (unreadable > 0).then_some(unreadable), ..OK }))
}

/// Counters for Prometheus.
#[utoipa::path(
    get, path = "/metrics", tag = "operations", operation_id = "metrics",
    responses((status = 200, description = "The counters", body = String))
)]
pub(super) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let kind = [(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
    (kind, app.metrics.page(&app.service))
}

/// This document.
#[utoipa::path(
    get, path = "/openapi.yaml", tag = "operations", operation_id = "openapi",
    responses((status = 200, description = "OpenAPI 3.1", body = String,
        content_type = "application/yaml"))
)]
pub(super) async fn openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/yaml")], openapi_yaml())
}

/// The operations and error codes, for people.
#[utoipa::path(
    get, path = "/docs", tag = "operations", operation_id = "docs",
    responses((status = 200, description = "A page", body = String, content_type = "text/html"))
)]
pub(super) async fn docs() -> Response {
    let mut response = Html(docs_page()).into_response();
    // The page loads nothing, and this header enforces it.
    let policy = HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'");
    response.headers_mut().insert(HeaderName::from_static("content-security-policy"), policy);
    response
}
