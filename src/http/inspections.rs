//! `/v1/inspections`: what a file is and how well it can carry a mark.

use axum::Json;
use axum::extract::{Request, State};

use super::App;
use super::error::ApiError;
use super::forms::InspectForm;
use super::upload::receive;
use super::watermarks::{parse_bits, parse_strength};
use super::wire::InspectionBody;
use crate::watermark::EmbedParams;

const FIELDS: &[&str] = &["method", "strength", "bits"];

/// Inspect a file without marking it. Registers nothing.
#[utoipa::path(
    post, path = "/v1/inspections", tag = "inspections", operation_id = "inspect",
    request_body(content = InspectForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "What was found", body = InspectionBody),
    )
)]
pub(super) async fn inspect(
    State(app): State<App>,
    request: Request,
) -> Result<Json<InspectionBody>, ApiError> {
    let (file, fields) = receive(&app, request, FIELDS).await?;
    let params = EmbedParams {
        method: fields.parsed("method", str::parse)?.unwrap_or_default(),
        strength: fields.parsed("strength", parse_strength)?.unwrap_or_default(),
        bits: fields.parsed("bits", parse_bits)?.unwrap_or_default(),
        ..EmbedParams::default()
    };
    Ok(Json(app.service.inspect(file, params).await?.into()))
}
