//! The frame of every request: its id, its log line, its count, and the body of its errors.
//!
//! Every answer with an error status leaves as problem+json, whatever made it: a handler, an
//! extractor of the framework, the router's 404 and 405, or a panic.

use std::time::{Duration, Instant};

use axum::Json;
use axum::body::Body;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tracing::{Instrument, info, info_span, warn};
use uuid::Uuid;

use super::App;
use super::code::Code;
use super::connections::OverCap;
use super::error::{ApiError, Problem, ProblemBody};
use super::intake::DrainOnDrop;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
/// Most characters of an incoming request id; longer ones would let callers flood the log.
const LONGEST_ID: usize = 128;
/// Time after which a connection may be free again.
const COME_BACK: Duration = Duration::from_secs(5);

pub(super) async fn envelope(State(app): State<App>, request: Request, next: Next) -> Response {
    let start = Instant::now();
    let id = request_id(request.headers());
    let method = request.method().clone();
    let path: String = request.uri().path().chars().take(200).collect();
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or_else(|| "unknown".to_owned(), |matched| matched.as_str().to_owned());
    let span = info_span!("request", %id, %method, path);
    let request = lingering(request);
    let response = match admitted(&app, &request) {
        Ok(()) => next.run(request).instrument(span.clone()).await,
        Err(refusal) => {
            drop(request);
            refusal.into_response()
        }
    };
    let mut response = with_problem(response, &id, method.as_str(), &path);
    if let Ok(value) = HeaderValue::from_str(&id) {
        response.headers_mut().insert(REQUEST_ID, value);
    }
    let nosniff = HeaderValue::from_static("nosniff");
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, nosniff);
    let own_pages = HeaderValue::from_static("same-origin");
    response.headers_mut().insert(RESOURCE_POLICY, own_pages);
    let (status, took) = (response.status().as_u16(), start.elapsed());
    app.metrics.count(&route, method.as_str(), status, took);
    let _entered = span.entered();
    let milliseconds = u64::try_from(took.as_millis()).unwrap_or(u64::MAX);
    if status >= 500 {
        warn!(status, milliseconds, "answered");
    } else {
        info!(status, milliseconds, "answered");
    }
    response
}

/// Refuses requests that may not be served, whatever they ask for. Probes always pass: they address
/// the service by its address, and a full service must answer them.
fn admitted(app: &App, request: &Request) -> Result<(), ApiError> {
    if matches!(request.uri().path(), "/livez" | "/readyz") {
        return Ok(());
    }
    app.origins.check(request)?;
    if request.extensions().get::<OverCap>().is_some() {
        let text = "the service has as many connections as it takes; try again shortly";
        let refusal = ApiError::new(Code::TooManyConnections, text);
        return Err(refusal.retry_after(COME_BACK));
    }
    Ok(())
}

fn lingering(request: Request) -> Request {
    let (parts, body) = request.into_parts();
    let expects_continue = parts.headers.contains_key(header::EXPECT);
    let body = if axum::body::HttpBody::is_end_stream(&body) {
        body
    } else {
        Body::from_stream(DrainOnDrop::new(body, expects_continue))
    };
    Request::from_parts(parts, body)
}

/// The id that the caller gave if it is well-formed, otherwise a new one.
fn request_id(headers: &HeaderMap) -> String {
    let sane = |id: &&str| {
        (1..=LONGEST_ID).contains(&id.len())
            && id.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte))
    };
    let given = headers.get(REQUEST_ID).and_then(|value| value.to_str().ok()).filter(sane);
    given.map_or_else(|| Uuid::now_v7().to_string(), str::to_owned)
}

fn with_problem(mut response: Response, id: &str, method: &str, path: &str) -> Response {
    let status = response.status();
    if !status.is_client_error() && !status.is_server_error() {
        return response;
    }
    let problem = response
        .extensions_mut()
        .remove::<Problem>()
        .unwrap_or_else(|| Problem::of_status(status, method, path));
    let code = problem.code.name();
    let body = ProblemBody {
        kind: format!("/docs#{code}"),
        title: problem.code.title(),
        status: status.as_u16(),
        code,
        detail: &problem.detail,
        request_id: id,
    };
    info!(request_id = id, code, detail = problem.detail, "refused");
    let mut answer = (status, Json(body)).into_response();
    for name in [header::ALLOW, header::RETRY_AFTER, header::CONTENT_RANGE] {
        if let Some(value) = response.headers_mut().remove(&name) {
            answer.headers_mut().insert(name, value);
        }
    }
    let kind = HeaderValue::from_static("application/problem+json");
    answer.headers_mut().insert(header::CONTENT_TYPE, kind);
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_sane_request_ids_are_taken_over() {
        let long = "a".repeat(129);
        for (given, kept) in [
            ("job-7_a.b", true),
            ("", false),
            ("a b", false),
            (long.as_str(), false),
            ("<x>", false),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(REQUEST_ID, HeaderValue::from_str(given).unwrap());
            assert_eq!(request_id(&headers) == given, kept, "{given}");
        }
        assert!(request_id(&HeaderMap::new()).parse::<Uuid>().is_ok());
    }
}
