//! `/v1/verifications`: whose mark does a file carry?

use axum::Json;
use axum::extract::{Path, Request, State};

use super::App;
use super::error::ApiError;
use super::forms::VerifyForm;
use super::upload::receive;
use super::watermarks::parse_id;
use crate::service::{Verification, VerifyRequest};

const FIELDS: &[&str] = &["owner_id", "watermark_id", "depth"];

/// Compare a file with the registered marks. No match is an answer, not an error.
#[utoipa::path(
    post, path = "/v1/verifications", tag = "verifications", operation_id = "verify",
    request_body(content = VerifyForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "The verdict", body = Verification),
    )
)]
pub(super) async fn verify(
    State(app): State<App>,
    request: Request,
) -> Result<Json<Verification>, ApiError> {
    let (file, fields) = receive(&app, request, FIELDS).await?;
    let request = VerifyRequest {
        file,
        owner_id: fields.text("owner_id")?,
        watermark_id: fields.parsed("watermark_id", |text| {
            text.parse().map_err(|_| "must be the id of a watermark, a UUID")
        })?,
        depth: fields.parsed("depth", str::parse)?.unwrap_or_default(),
    };
    Ok(Json(app.service.verify(request).await?))
}

/// Get a verdict again, as it was answered.
#[utoipa::path(
    get, path = "/v1/verifications/{id}", tag = "verifications",
    operation_id = "get_verification",
    params(("id" = String, Path, format = "uuid", description = "Id of the verification")),
    responses(
        (status = 200, description = "The verdict", body = Verification),
    )
)]
pub(super) async fn verification(
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<serde_json::Value>, ApiError> {
    Ok(Json(app.service.verification(parse_id(&id)?).await?))
}
