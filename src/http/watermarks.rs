//! `/v1/watermarks`: embed, list, show, fetch the file, revoke.

use axum::Json;
use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use uuid::Uuid;

use super::App;
use super::accept::{Accept, AnswerForm};
use super::code::Code;
use super::conditional::{Outcome, evaluate, range_applies};
use super::download::{EXISTING, answer_file, etag};
use super::error::ApiError;
use super::forms::EmbedForm;
use super::range::{self, wanted};
use super::upload::receive;
use super::wire::{PageQuery, WatermarkBody, WatermarkPageBody};
use crate::registry::{Filter, Order};
use crate::service::{EmbedRequest, Embedded, OnExisting, Text};
use crate::watermark::{BitCount, Strength};

const FIELDS: &[&str] = &[
    "owner_id",
    "recipient",
    "label",
    "method",
    "layers",
    "strength",
    "max_distortion",
    "bits",
    "payload",
    "keep_file",
    "keep_host",
    "on_existing",
];
const REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");
const DEFAULT_PAGE: u32 = 50;

/// Mark a mesh and register the mark.
#[utoipa::path(
    post, path = "/v1/watermarks", tag = "watermarks", operation_id = "embed",
    params(
        ("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255,
            pattern = "^[!-~]+$", description = "A retry with the same key and request gets the same record and bytes"),
        ("Accept" = Option<String>, Header, description =
            "`application/json` answers with the record, anything that takes the file with the file"),
    ),
    request_body(content = EmbedForm, content_type = "multipart/form-data"),
    responses(
        (status = 201, description = "The marked file (same format as the upload), or the record",
            body = WatermarkBody),
    )
)]
pub(super) async fn embed(State(app): State<App>, request: Request) -> Result<Response, ApiError> {
    let accept = Accept::of(request.headers());
    let mut formats = accept.formats()?;
    let idempotency_key = idempotency_key(request.headers())?;
    let (file, fields) = receive(&app, request, FIELDS).await?;
    let config = app.service.config();
    let keep_file = fields.flag("keep_file", config.keep_files)?;
    if !keep_file {
        formats.retain(|&format| accept.wanted(format) == Some(AnswerForm::File));
    }
    if formats.is_empty() {
        return Err(ApiError::new(
            Code::InvalidParameter,
            "keep_file: false and Accept: application/json together would lose the marked file; \
             leave out one of them",
        ));
    }
    let request = EmbedRequest {
        file,
        owner_id: fields.required_text("owner_id")?,
        recipient: fields.text("recipient")?,
        label: fields.text("label")?,
        method: fields.parsed("method", str::parse)?.unwrap_or_default(),
        layers: fields.parsed("layers", str::parse)?,
        strength: fields.parsed("strength", parse_strength)?,
        max_distortion: fields.parsed("max_distortion", str::parse)?,
        bits: fields.parsed("bits", parse_bits)?.unwrap_or_default(),
        payload: fields.parsed("payload", |text| {
            hex::decode(text).map_err(|_| "must be an even number of hexadecimal digits")
        })?,
        keep_file,
        keep_host: fields.flag("keep_host", config.keep_host)?,
        on_existing: fields.parsed("on_existing", str::parse)?.unwrap_or_default(),
        formats,
        idempotency_key,
    };
    let silent = request.on_existing == OnExisting::Allow;
    let Embedded { record, content, replayed } = app.service.embed(request).await?;
    let id = record.id.to_string();
    let location = format!("/v1/watermarks/{id}");
    let link = format!("<{location}>; rel=\"describedby\"");
    let mut response = if accept.wanted(record.format) == Some(AnswerForm::Record) {
        Json(WatermarkBody::from(record)).into_response()
    } else {
        let bytes = content.bytes();
        answer_file(&record, Body::from_stream(content.begin(0..bytes).await?), bytes)
    };
    *response.status_mut() = StatusCode::CREATED;
    let headers = response.headers_mut();
    let told = [
        (HeaderName::from_static("quadmark-watermark-id"), id),
        (header::LOCATION, location),
        (header::LINK, link),
    ];
    for (name, value) in told {
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(name, value);
        }
    }
    if silent {
        headers.remove(EXISTING);
    }
    if replayed {
        headers.insert(REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// List registered marks, a page at a time, in the order of their registration.
#[utoipa::path(
    get, path = "/v1/watermarks", tag = "watermarks", operation_id = "list_watermarks",
    params(PageQuery),
    responses(
        (status = 200, description = "A page", body = WatermarkPageBody),
    )
)]
pub(super) async fn page(
    State(app): State<App>,
    query: Result<Query<PageQuery>, QueryRejection>,
) -> Result<Json<WatermarkPageBody>, ApiError> {
    let Query(query) =
        query.map_err(|rejection| ApiError::new(Code::InvalidParameter, rejection.body_text()))?;
    let text = |name, text: Option<String>| {
        text.map(|text| Text::parse(name, &text).map(|text| text.as_str().to_owned())).transpose()
    };
    let filter = Filter {
        owner_id: text("owner_id", query.owner_id)?,
        recipient: text("recipient", query.recipient)?,
    };
    let limit = query.limit.unwrap_or(DEFAULT_PAGE);
    let order = query.order.as_deref().map(str::parse).transpose();
    let order = order
        .map_err(|error: &str| ApiError::new(Code::InvalidParameter, format!("order: {error}")))?;
    let order: Order = order.unwrap_or_default();
    let page = app.service.page(&filter, order, query.cursor.as_deref(), limit).await?;
    Ok(Json(page.into()))
}

/// Get a registered mark.
#[utoipa::path(
    get, path = "/v1/watermarks/{id}", tag = "watermarks", operation_id = "get_watermark",
    params(("id" = String, Path, format = "uuid", description = "Id of the record")),
    responses(
        (status = 200, description = "The record", body = WatermarkBody),
    )
)]
pub(super) async fn record(
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<WatermarkBody>, ApiError> {
    Ok(Json(app.service.record(parse_id(&id)?).await?.into()))
}

/// Revoke a mark: the record is kept, and the mark is no longer searched for.
#[utoipa::path(
    delete, path = "/v1/watermarks/{id}", tag = "watermarks", operation_id = "revoke_watermark",
    params(("id" = String, Path, format = "uuid", description = "Id of the record")),
    responses(
        (status = 200, description = "The record, revoked", body = WatermarkBody),
    )
)]
pub(super) async fn revoke(
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<WatermarkBody>, ApiError> {
    Ok(Json(app.service.revoke(parse_id(&id)?).await?.into()))
}

/// Fetch the marked file again, whole or in part.
#[utoipa::path(
    get, path = "/v1/watermarks/{id}/file", tag = "watermarks", operation_id = "get_marked_file",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the record"),
        ("Range" = Option<String>, Header, description =
            "One range of bytes; several are ignored"),
        ("If-Range" = Option<String>, Header, description =
            "The range counts only while the ETag is this one"),
        ("If-None-Match" = Option<String>, Header, description =
            "Answers 304 when the ETag is among these"),
        ("If-Match" = Option<String>, Header, description =
            "Answers 412 when the ETag is not among these"),
    ),
    responses(
        (status = 200, description = "The marked file"),
        (status = 206, description = "The part that the Range says"),
        (status = 304, description = "As the If-None-Match says"),
    )
)]
pub(super) async fn file(
    State(app): State<App>,
    Path(id): Path<String>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    // Conditions count only if there would be an answer without them.
    let record = app.service.kept_file(parse_id(&id)?).await?;
    let (tag, bytes) = (etag(&record), record.marked_bytes);
    match evaluate(&headers, &tag) {
        Outcome::Proceed => {}
        Outcome::NotModified => {
            return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
        }
        Outcome::Failed => {
            let text = format!("the file has the ETag {tag}, which If-Match does not name");
            return Err(ApiError::new(Code::PreconditionFailed, text));
        }
    }
    let accepts = (header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    if method == Method::HEAD {
        return Ok(([accepts], answer_file(&record, Body::empty(), bytes)).into_response());
    }
    let wanted = if range_applies(&headers, &tag) {
        wanted(&headers, bytes)
    } else {
        range::RequestedRange::Whole
    };
    let (status, range) = match wanted {
        range::RequestedRange::Whole => (StatusCode::OK, 0..bytes),
        range::RequestedRange::Part(range) => (StatusCode::PARTIAL_CONTENT, range),
        range::RequestedRange::Unsatisfiable => {
            let text = format!("the file has {bytes} bytes; ask for some of them");
            let mut refused = ApiError::new(Code::RangeNotSatisfiable, text).into_response();
            content_range(&mut refused, format!("bytes */{bytes}"));
            return Ok(refused);
        }
    };
    let content = app.service.content(&record).await?;
    let body = Body::from_stream(content.begin(range.clone()).await?);
    let mut response = answer_file(&record, body, range.end - range.start);
    *response.status_mut() = status;
    if status == StatusCode::PARTIAL_CONTENT {
        let last = range.end.saturating_sub(1);
        content_range(&mut response, format!("bytes {}-{last}/{bytes}", range.start));
    }
    Ok(([accepts], response).into_response())
}

fn content_range(response: &mut Response, range: String) {
    if let Ok(value) = HeaderValue::try_from(range) {
        response.headers_mut().insert(header::CONTENT_RANGE, value);
    }
}

pub(super) fn parse_id(text: &str) -> Result<Uuid, ApiError> {
    text.parse().map_err(|_| {
        let text: String = text.chars().take(60).collect();
        ApiError::new(Code::NotFound, format!("there is nothing at {text:?}: ids are UUIDs"))
    })
}

pub(super) fn parse_strength(text: &str) -> Result<Strength, String> {
    let strength: f64 = text.parse().map_err(|_| "must be a number from 0.01 to 0.25")?;
    Strength::new(strength).map_err(|error| error.to_string())
}

pub(super) fn parse_bits(text: &str) -> Result<BitCount, String> {
    let bits: u32 = text.parse().map_err(|_| "must be a whole number from 16 to 256")?;
    BitCount::new(bits).map_err(|error| error.to_string())
}

fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, ApiError> {
    let Some(value) = headers.get("idempotency-key") else { return Ok(None) };
    // The service decides which keys are valid; here the key only has to be a text.
    let text = value.to_str().map_err(|_| {
        ApiError::new(Code::InvalidParameter, "Idempotency-Key: must be visible ASCII characters")
    })?;
    Ok(Some(text.to_owned()))
}
