//! Errors as answers: `application/problem+json` (RFC 9457).
//!
//! An [`ApiError`] becomes a response without a body and with a [`Problem`] attached. The body is
//! written in `envelope`, the only code that knows the request id and sees the errors of the
//! framework too.

use std::time::Duration;

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tracing::error;
use utoipa::ToSchema;

use super::accept::not_acceptable;
use super::code::Code;
#[allow(unused_imports)] // the schema names it
use super::schemas::CodeName;
use crate::formats::FormatError;
use crate::jobs::JobError;
use crate::service::ServiceError;
use crate::watermark::WatermarkError;

/// The content of an error answer.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Problem)]
pub(super) struct ProblemBody<'a> {
    /// Reference to the explanation of the code.
    #[serde(rename = "type")]
    #[schema(example = "/docs#missing_parameter")]
    pub(super) kind: String,
    /// The title of the code, the same for every occurrence.
    pub(super) title: &'a str,
    /// The HTTP status.
    #[schema(minimum = 400, maximum = 599, example = 400)]
    pub(super) status: u16,
    /// The error code, stable, for programs.
    #[schema(value_type = CodeName)]
    pub(super) code: &'a str,
    /// What happened, and what to do.
    pub(super) detail: &'a str,
    /// Id of the request in the service's log.
    pub(super) request_id: &'a str,
}

/// An error on its way to the client.
#[derive(Debug, Clone)]
pub(super) struct ApiError {
    problem: Problem,
    retry_after: Option<Duration>,
}

/// The part of an error that the envelope writes out.
#[derive(Debug, Clone)]
pub(super) struct Problem {
    pub(super) code: Code,
    pub(super) detail: String,
}

impl ApiError {
    pub(super) fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { problem: Problem { code, detail: detail.into() }, retry_after: None }
    }

    /// Its code.
    #[cfg(test)]
    pub(super) fn code(&self) -> Code {
        self.problem.code
    }

    /// Sets the time after which the same request may succeed.
    pub(super) fn retry_after(mut self, wait: Duration) -> Self {
        self.retry_after = Some(wait);
        self
    }

    /// A bug or a fault of the machine. The text goes to the log, not to the caller.
    pub(super) fn internal(text: &str) -> Self {
        error!(error = text, "internal error");
        Self::new(
            Code::Internal,
            "nothing was registered by this request; if it happens again, tell the operator the \
             request id: the log has the cause",
        )
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let mut response = self.problem.code.status().into_response();
        if let Some(wait) = self.retry_after {
            let seconds = HeaderValue::from(wait.as_secs().max(1));
            response.headers_mut().insert(header::RETRY_AFTER, seconds);
        }
        response.extensions_mut().insert(self.problem);
        response
    }
}

impl Problem {
    /// The problem of an error that the framework made, from its status alone.
    pub(super) fn of_status(status: StatusCode, method: &str, path: &str) -> Self {
        let (code, detail) = match status {
            StatusCode::NOT_FOUND => (
                Code::NotFound,
                format!("there is no {path:?} here; the operations are listed at /docs"),
            ),
            StatusCode::METHOD_NOT_ALLOWED => (
                Code::MethodNotAllowed,
                format!("{method} does not apply to {path:?}; the Allow header says what does"),
            ),
            StatusCode::NOT_ACCEPTABLE => (Code::NotAcceptable, "accept more".to_owned()),
            StatusCode::PAYLOAD_TOO_LARGE => (Code::TooLarge, "send less".to_owned()),
            StatusCode::REQUEST_TIMEOUT => (Code::UploadTimeout, "send faster".to_owned()),
            StatusCode::UNSUPPORTED_MEDIA_TYPE => {
                (Code::UnsupportedMediaType, "send another content type".to_owned())
            }
            status if status.is_client_error() => {
                (Code::MalformedRequest, "the request cannot be read; see /docs".to_owned())
            }
            _ => (Code::Internal, "the log has the cause under the request id".to_owned()),
        };
        Self { code, detail }
    }
}

impl From<ServiceError> for ApiError {
    fn from(error: ServiceError) -> Self {
        if let ServiceError::FormatNotTaken(format) = &error {
            return not_acceptable(&format!("{}, as the upload is", format.media_type()));
        }
        let retry_after = error.retry_after();
        let code = match &error {
            ServiceError::InvalidParameter { .. } => Code::InvalidParameter,
            ServiceError::Format(error) => format_code(error),
            ServiceError::FormatNotTaken(_) => Code::NotAcceptable,
            ServiceError::Watermark(error) => watermark_code(error),
            ServiceError::TooSmall(_) => Code::InsufficientCapacity,
            ServiceError::DistortionUnreachable(_) => Code::DistortionUnreachable,
            ServiceError::UnknownWatermark(_) => Code::UnknownWatermark,
            ServiceError::UnknownVerification(_) => Code::UnknownVerification,
            ServiceError::FileNotKept(_) => Code::FileNotKept,
            ServiceError::FileLost { .. } => Code::FileLost,
            ServiceError::IdempotencyConflict => Code::IdempotencyConflict,
            ServiceError::IdempotencyInProgress => Code::IdempotencyInProgress,
            ServiceError::IdempotencyRevoked { .. } => Code::IdempotencyRevoked,
            ServiceError::NothingToCompare(_) => Code::NothingToCompare,
            ServiceError::CannotRemake(_) => Code::CannotRemake,
            ServiceError::AlreadyMarked(_) => Code::AlreadyMarked,
            ServiceError::UploadsFull(_) => Code::UploadsFull,
            ServiceError::StorageFull(_) => Code::InsufficientStorage,
            ServiceError::Job(JobError::Busy { .. }) => Code::Busy,
            ServiceError::Job(JobError::DeadlinePassed) => Code::DeadlineExceeded,
            // A client that hung up reads no answer.
            ServiceError::Job(JobError::ShuttingDown | JobError::HungUp) => Code::ShuttingDown,
            ServiceError::Job(JobError::TooMuchMemory { .. }) => Code::TooLarge,
            ServiceError::Check(_) => Code::CheckFailed,
            ServiceError::Internal(text) => return Self::internal(text),
            ServiceError::Job(JobError::Panicked) => return Self::internal("a job panicked"),
            ServiceError::Job(JobError::Again { .. }) => return Self::internal(&error.to_string()),
        };
        if code.status().is_server_error() {
            error!(%error, code = code.name(), "request failed");
        }
        let detail = match &error {
            // The details of the difference are of use to developers only.
            ServiceError::Check(_) => "the marked file did not read back as it should and was \
                                       thrown away; nothing was registered; please report the file"
                .to_owned(),
            error => error.to_string(),
        };
        Self { problem: Problem { code, detail }, retry_after }
    }
}

fn format_code(error: &FormatError) -> Code {
    match error {
        FormatError::Empty => Code::EmptyFile,
        FormatError::UnknownFormat { .. } => Code::UnknownFormat,
        FormatError::TooLarge { .. } => Code::TooLarge,
        FormatError::MalformedObj { .. } => Code::MalformedObj,
        FormatError::MalformedGltf { .. } => Code::MalformedGltf,
        FormatError::UnsupportedExtension { .. } => Code::UnsupportedExtension,
        FormatError::ExternalBuffer { .. } => Code::ExternalBuffer,
        FormatError::NonFiniteVertex { .. } => Code::NonFiniteVertex,
        FormatError::CannotPatch { .. } => Code::CannotPatch,
        FormatError::NoTriangles => Code::NoTriangles,
        FormatError::ReadBack { .. } => Code::CheckFailed,
        FormatError::Cancelled => Code::DeadlineExceeded,
    }
}

fn watermark_code(error: &WatermarkError) -> Code {
    match error {
        WatermarkError::InsufficientCapacity { .. } => Code::InsufficientCapacity,
        WatermarkError::NoRadialExtent { .. } => Code::NoRadialExtent,
        WatermarkError::Cancelled => Code::DeadlineExceeded,
        WatermarkError::StrengthOutOfRange(_)
        | WatermarkError::BitsOutOfRange(_)
        | WatermarkError::UnknownMethod(_)
        | WatermarkError::UnknownModulation(_)
        | WatermarkError::MessageTooLong { .. }
        | WatermarkError::MessageNotHex
        | WatermarkError::KeyNotHex => Code::InvalidParameter,
        #[allow(unreachable_patterns)] // the core may learn to refuse more
        _ => Code::Unprocessable,
    }
}
