//! Uploads: a form with one `file` and its fields in any order, or the raw file as body with the
//! fields in the query.
//!
//! `curl -F file=@x -F owner_id=acme` sends the file first, so nothing is decided before the end of
//! the form. The file goes to a nameless temporary file chunk by chunk; it is never whole in memory
//! here.

use std::sync::Arc;

use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Query, Request};
use axum::http::{HeaderMap, header};
use futures::StreamExt;

use super::App;
use super::code::Code;
use super::error::ApiError;
use super::fields::Fields;
use super::intake::{Intake, Meter};
use crate::service::{Admission, ServiceError, Spooled};

/// Most bytes of one text field; the longest valid value has 256 characters.
const LONGEST_FIELD: usize = 16 << 10;
/// Most parts of one form.
const MOST_PARTS: usize = 32;
/// Most bytes of a file name that are kept.
const LONGEST_NAME: usize = 255;

/// Reads an upload whose fields are among `known`.
pub(super) async fn receive(
    app: &App,
    request: Request,
    known: &'static [&'static str],
) -> Result<(Spooled, Fields), ApiError> {
    // A busy service refuses before the bytes are sent.
    app.service.pool().check().map_err(ServiceError::from)?;
    let limit = app.service.config().max_body_bytes;
    let declared = request.headers().get(header::CONTENT_LENGTH);
    let declared =
        declared.and_then(|value| value.to_str().ok()).and_then(|text| text.parse().ok());
    if declared.is_some_and(|length: u64| length > limit) {
        return Err(too_large(limit));
    }
    // So does a service with too many uploads, or without room for this one.
    let admission = app.service.admit_upload(declared)?;
    let time = app.service.config().upload_timeout;
    let received = receive_body(app, request, known, limit, admission);
    tokio::time::timeout(time, received).await.map_err(|_| {
        let seconds = time.as_secs();
        ApiError::new(
            Code::UploadTimeout,
            format!("the upload did not end within {seconds} seconds; use a faster connection"),
        )
    })?
}

async fn receive_body(
    app: &App,
    request: Request,
    known: &'static [&'static str],
    limit: u64,
    admission: Admission,
) -> Result<(Spooled, Fields), ApiError> {
    let Ok(Query(query)) = Query::<Vec<(String, String)>>::try_from_uri(request.uri()) else {
        return Err(ApiError::new(Code::MalformedRequest, "the query cannot be read"));
    };
    let mut fields = Fields::new(known, query)?;
    let kind = ContentKind::of(request.headers())?;
    let (parts, body) = request.into_parts();
    let (intake, meter) = Intake::new(body, limit, app.service.config().idle_timeout);
    let file = match kind {
        ContentKind::Raw => {
            let file = spool_raw(app, admission, intake, &meter).await;
            file.map_err(|error| explain(error, &meter, limit))?
        }
        ContentKind::Form => {
            let body = axum::body::Body::from_stream(intake);
            let form = Multipart::from_request(Request::from_parts(parts, body), &()).await;
            let form = form.map_err(|rejection| {
                ApiError::new(Code::MalformedMultipart, rejection.body_text())
            })?;
            let file = read_form(app, admission, form, &mut fields, &meter).await;
            file.map_err(|error| explain(error, &meter, limit))?
        }
    };
    Ok((file, fields))
}

enum ContentKind {
    Form,
    Raw,
}

impl ContentKind {
    fn of(headers: &HeaderMap) -> Result<Self, ApiError> {
        let Some(value) = headers.get(header::CONTENT_TYPE) else { return Ok(Self::Raw) };
        let text = value.to_str().unwrap_or_default().to_ascii_lowercase();
        let kind = text.split(';').next().unwrap_or_default().trim();
        match kind {
            "multipart/form-data" => Ok(Self::Form),
            "application/octet-stream" | "text/plain" => Ok(Self::Raw),
            kind if kind.starts_with("model/") => Ok(Self::Raw),
            kind => Err(ApiError::new(
                Code::UnsupportedMediaType,
                format!(
                    "the content type {:?} cannot be used; send multipart/form-data with the field \
                     file (curl -F file=@mesh.obj), or the file itself as \
                     application/octet-stream (curl -H 'Content-Type: application/octet-stream' \
                     --data-binary @mesh.obj)",
                    kind.chars().take(100).collect::<String>()
                ),
            )),
        }
    }
}

/// A failure while the body was read, before its cause is known.
enum Failure {
    Form(MultipartError),
    Body(std::io::Error),
    Said(ApiError),
}

impl From<ApiError> for Failure {
    fn from(error: ApiError) -> Self {
        Self::Said(error)
    }
}

impl From<ServiceError> for Failure {
    fn from(error: ServiceError) -> Self {
        Self::Said(error.into())
    }
}

fn explain(failure: Failure, meter: &Meter, limit: u64) -> ApiError {
    if meter.over_limit() {
        return too_large(limit);
    }
    if meter.stalled() {
        return ApiError::new(
            Code::UploadTimeout,
            "the upload stood still and was given up; send it again, on a better connection",
        );
    }
    if meter.broken() {
        return ApiError::new(
            Code::UploadIncomplete,
            "the connection ended before the body did; send it again",
        );
    }
    match failure {
        Failure::Form(error) => ApiError::new(
            Code::MalformedMultipart,
            format!("the form cannot be read ({}); was it cut off?", error.body_text()),
        ),
        Failure::Body(error) => ApiError::new(Code::UploadIncomplete, error.to_string()),
        Failure::Said(error) => error,
    }
}

fn too_large(limit: u64) -> ApiError {
    ApiError::new(
        Code::TooLarge,
        format!(
            "the body has more than {limit} bytes; send a smaller file or raise max_body_bytes"
        ),
    )
}

async fn spool_raw(
    app: &App,
    admission: Admission,
    mut intake: Intake,
    meter: &Meter,
) -> Result<Spooled, Failure> {
    let mut spool = app.service.spool(admission)?;
    while let Some(chunk) = intake.next().await {
        let chunk = chunk.map_err(Failure::Body)?;
        meter.deliver(chunk.len());
        spool = spool.write(&chunk).await?;
    }
    Ok(spool.end(None).await?)
}

async fn read_form(
    app: &App,
    admission: Admission,
    mut form: Multipart,
    fields: &mut Fields,
    meter: &Arc<Meter>,
) -> Result<Spooled, Failure> {
    let mut admission = Some(admission);
    let mut file = None;
    let mut parts = 0;
    while let Some(part) = form.next_field().await.map_err(Failure::Form)? {
        parts += 1;
        if parts > MOST_PARTS {
            let text = format!("the form has more than {MOST_PARTS} parts; send each field once");
            return Err(ApiError::new(Code::MalformedMultipart, text).into());
        }
        let name = part.name().unwrap_or_default().to_owned();
        if name != "file" {
            let value = read_text(part, &name, meter).await?;
            fields.add(name, value)?;
            continue;
        }
        let Some(admission) = admission.take() else {
            let text = "file is given twice; send one file per request";
            return Err(ApiError::new(Code::DuplicateParameter, text).into());
        };
        file = Some(spool_part(app, admission, part, meter).await?);
    }
    file.ok_or_else(|| {
        let text = "there is no file; add it as the form field file (curl -F file=@mesh.obj)";
        ApiError::new(Code::MissingParameter, text).into()
    })
}

async fn spool_part(
    app: &App,
    admission: Admission,
    mut part: Field<'_>,
    meter: &Meter,
) -> Result<Spooled, Failure> {
    let name = part.file_name().map(|name| name.chars().take(LONGEST_NAME).collect());
    let mut spool = app.service.spool(admission)?;
    while let Some(chunk) = part.chunk().await.map_err(Failure::Form)? {
        meter.deliver(chunk.len());
        spool = spool.write(&chunk).await?;
    }
    Ok(spool.end(name).await?)
}

async fn read_text(mut part: Field<'_>, name: &str, meter: &Meter) -> Result<String, Failure> {
    let mut bytes = Vec::new();
    while let Some(chunk) = part.chunk().await.map_err(Failure::Form)? {
        meter.deliver(chunk.len());
        if bytes.len() + chunk.len() > LONGEST_FIELD {
            let name: String = name.chars().take(40).collect();
            let text = format!("the field {name:?} is too long; is it the file? Call it file");
            return Err(ApiError::new(Code::InvalidParameter, text).into());
        }
        bytes.extend_from_slice(&chunk);
    }
    String::from_utf8(bytes).map_err(|_| {
        let name: String = name.chars().take(40).collect();
        let text = format!("the field {name:?} is not UTF-8 text");
        ApiError::new(Code::InvalidParameter, text).into()
    })
}

/// The names of the fields of an upload, for error texts.
pub(super) fn listed(known: &[&str]) -> String {
    known.join(", ")
}
