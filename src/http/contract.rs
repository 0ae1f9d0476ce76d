//! The parts of the `OpenAPI` document beyond the wire types: the errors of every operation by
//! status, with their codes; the raw-body form of uploads with its query; the headers of answers;
//! and the links from what was made to where it can be fetched again.
//!
//! Tests check these tables: every code must belong to an operation, and the API tests check that
//! the answers that they receive are documented.

use std::collections::BTreeMap;

use utoipa::openapi::header::Header;
use utoipa::openapi::link::Link;
use utoipa::openapi::path::{Operation, ParameterBuilder, ParameterIn, PathItem};
use utoipa::openapi::schema::{Object, ObjectBuilder, SchemaType, Type};
use utoipa::openapi::{Content, OpenApi, Ref, RefOr, Required, Response, ResponseBuilder, Schema};

use super::code::Code;
use super::schemas::bytes;
use crate::formats::Format;

use Code::{
    AlreadyMarked, Busy, CannotPatch, CannotRemake, CheckFailed, CrossOrigin, DeadlineExceeded,
    DistortionUnreachable, DuplicateParameter, EmptyFile, ExternalBuffer, FileLost, FileNotKept,
    HostNotAllowed, IdempotencyConflict, IdempotencyInProgress, IdempotencyRevoked,
    InsufficientCapacity, InsufficientStorage, Internal, InvalidParameter, MalformedGltf,
    MalformedMultipart, MalformedObj, MalformedRequest, MissingParameter, NoRadialExtent,
    NoTriangles, NonFiniteVertex, NotAcceptable, NotFound, NothingToCompare, PreconditionFailed,
    RangeNotSatisfiable, ShuttingDown, TooLarge, TooManyConnections, UnknownFormat,
    UnknownParameter, UnknownVerification, UnknownWatermark, Unprocessable, UnsupportedExtension,
    UnsupportedMediaType, UploadIncomplete, UploadTimeout, UploadsFull,
};

/// Codes of every operation.
const COMMON_CODES: &[Code] = &[MalformedRequest, Internal];

/// Codes of every upload.
const UPLOAD: &[Code] = &[
    MalformedMultipart,
    UploadIncomplete,
    MissingParameter,
    UnknownParameter,
    DuplicateParameter,
    InvalidParameter,
    UploadTimeout,
    TooLarge,
    UnsupportedMediaType,
    UnknownFormat,
    EmptyFile,
    MalformedObj,
    MalformedGltf,
    UnsupportedExtension,
    ExternalBuffer,
    NonFiniteVertex,
    NoTriangles,
    NoRadialExtent,
    Unprocessable,
    Busy,
    UploadsFull,
    InsufficientStorage,
    DeadlineExceeded,
    ShuttingDown,
];

/// Codes of every operation except the probes, which answer any client.
const NON_PROBE_CODES: &[Code] = &[HostNotAllowed, CrossOrigin, TooManyConnections];

const EMBED: &[Code] = &[
    NotAcceptable,
    IdempotencyConflict,
    IdempotencyInProgress,
    IdempotencyRevoked,
    CannotRemake,
    AlreadyMarked,
    CannotPatch,
    InsufficientCapacity,
    DistortionUnreachable,
    CheckFailed,
    FileLost,
];

/// The codes of an operation, by its id.
fn codes(operation: &str) -> Vec<&'static [Code]> {
    match operation {
        "embed" => vec![COMMON_CODES, NON_PROBE_CODES, UPLOAD, EMBED],
        "verify" => {
            vec![COMMON_CODES, NON_PROBE_CODES, UPLOAD, &[UnknownWatermark, NothingToCompare]]
        }
        "inspect" => vec![COMMON_CODES, NON_PROBE_CODES, UPLOAD],
        "list_watermarks" => vec![COMMON_CODES, NON_PROBE_CODES, &[InvalidParameter]],
        "get_watermark" | "revoke_watermark" => {
            vec![COMMON_CODES, NON_PROBE_CODES, &[NotFound, UnknownWatermark]]
        }
        "get_marked_file" => vec![
            COMMON_CODES,
            NON_PROBE_CODES,
            &[NotFound, UnknownWatermark, FileNotKept, FileLost],
            &[PreconditionFailed, RangeNotSatisfiable],
        ],
        "get_verification" => vec![COMMON_CODES, NON_PROBE_CODES, &[NotFound, UnknownVerification]],
        "readyz" => vec![COMMON_CODES, &[ShuttingDown, InsufficientStorage]],
        "livez" => vec![COMMON_CODES],
        _ => vec![COMMON_CODES, NON_PROBE_CODES],
    }
}

/// The links of an answer: the operation that follows, and where in the answer its id is.
fn links(operation: &str) -> &'static [(&'static str, &'static str)] {
    const MADE: &str = "$response.header.Quadmark-Watermark-Id";
    match operation {
        "embed" => {
            &[("get_watermark", MADE), ("get_marked_file", MADE), ("revoke_watermark", MADE)]
        }
        "verify" => &[("get_verification", "$response.body#/id")],
        _ => &[],
    }
}

/// The statuses with which an operation answers with a marked file, or a part of one.
fn marked_file(operation: &str) -> &'static [&'static str] {
    match operation {
        "embed" => &["201"],
        "get_marked_file" => &["200", "206"],
        _ => &[],
    }
}

/// Headers of an answer, besides those that all answers have.
fn headers(operation: &str, status: &str) -> &'static [(&'static str, &'static str)] {
    const FILE: (&str, &str) =
        ("Content-Disposition", "A file name for the marked file, where it is the answer");
    const TAG: (&str, &str) =
        ("ETag", "The SHA-256 of the marked file, in quotes, where it is the answer");
    match (operation, status) {
        ("embed", "201") => &[
            ("Quadmark-Watermark-Id", "Id of the record"),
            (
                "Quadmark-Existing-Marks",
                "Ids of the marks that the host already carried, separated by commas; absent where \
                 there are none",
            ),
            ("Location", "Path of the record"),
            ("Link", "The same, as rel=\"describedby\""),
            ("Idempotent-Replayed", "`true` where an earlier request with the same key made it"),
            FILE,
            TAG,
        ],
        ("get_marked_file", "200") => &[
            (
                "Quadmark-Existing-Marks",
                "Ids of the marks that the host already carried, separated by commas; absent where \
                 there are none",
            ),
            ("Accept-Ranges", "`bytes`"),
            FILE,
            TAG,
        ],
        ("get_marked_file", "206") => &[
            ("Content-Range", "Which bytes these are, and of how many"),
            ("Accept-Ranges", "`bytes`"),
            FILE,
            TAG,
        ],
        ("get_marked_file", "304") => &[TAG],
        ("get_marked_file", "416") => &[("Content-Range", "How many bytes there are")],
        _ => &[],
    }
}

/// Completes the document that was made from the wire types.
pub(super) fn complete(document: &mut OpenApi) {
    let forms = forms(document);
    for item in document.paths.paths.values_mut() {
        let PathItem { get, post, delete, head, .. } = item;
        for operation in [get, post, delete, head].into_iter().flatten() {
            complete_operation(operation, &forms);
        }
    }
}

fn complete_operation(operation: &mut Operation, forms: &BTreeMap<String, Object>) {
    let name = operation.operation_id.clone().unwrap_or_default();
    add_raw_body(operation, forms);
    for parameter in operation.parameters.iter_mut().flatten() {
        if let RefOr::T(parameter) = parameter
            && let Some(schema) = parameter.schema.as_mut()
        {
            without_null(schema);
        }
    }
    let responses = &mut operation.responses.responses;
    for status in marked_file(&name) {
        let Some(RefOr::T(answer)) = responses.get_mut(*status) else { continue };
        for format in Format::ALL {
            let file = Content::new(Some(bytes()));
            answer.content.insert(format.media_type().to_owned(), file.into());
        }
    }
    // YAML is a text that a client parses, so it gets no schema of a string.
    for (kind, content) in answers(responses) {
        if let ("application/yaml", RefOr::T(content)) = (kind.as_str(), content) {
            content.schema = None;
        }
    }
    responses.extend(errors(&name));
    for (status, response) in responses {
        let RefOr::T(response) = response else { continue };
        for (header, text) in headers(&name, status) {
            response.headers.insert((*header).to_owned(), described(text));
        }
        let all = described("Names the request in the service's log");
        response.headers.insert("X-Request-Id".to_owned(), all);
        if status.starts_with('2') {
            for (to, from) in links(&name) {
                let link = Link::builder().operation_id(*to).parameter("id", *from).build();
                response.links.insert((*to).to_owned(), link.into());
            }
        }
    }
}

/// All bodies of answers, by media type.
fn answers(
    responses: &mut BTreeMap<String, RefOr<Response>>,
) -> impl Iterator<Item = (&String, &mut RefOr<Content>)> {
    responses.values_mut().flat_map(|response| {
        match response {
            RefOr::T(response) => Some(&mut response.content),
            RefOr::Ref(_) => None,
        }
        .into_iter()
        .flatten()
    })
}

fn described(text: &str) -> RefOr<Header> {
    let mut header = Header::default();
    header.description = Some(text.to_owned());
    header.into()
}

/// One answer per status, with the meaning of its codes.
fn errors(operation: &str) -> BTreeMap<String, RefOr<Response>> {
    let mut by_status: BTreeMap<u16, Vec<Code>> = BTreeMap::new();
    for &code in codes(operation).into_iter().flatten() {
        by_status.entry(code.status().as_u16()).or_default().push(code);
    }
    let response = |(status, codes): (u16, Vec<Code>)| {
        let means: Vec<String> =
            codes.iter().map(|code| format!("`{}`: {}.", code.name(), code.title())).collect();
        let problem = Content::new(Some(Ref::from_schema_name("Problem")));
        let mut response = ResponseBuilder::new()
            .description(means.join(" "))
            .content("application/problem+json", problem)
            .build();
        if codes.iter().any(|code| code.may_say_when()) {
            let seconds = ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(1));
            let mut header = Header::new(Schema::from(seconds.build()));
            header.description = Some("Seconds after which the same request may work".to_owned());
            response.headers.insert("Retry-After".to_owned(), header.into());
        }
        (status.to_string(), RefOr::T(response))
    };
    by_status.into_iter().map(response).collect()
}

/// The forms of uploads, by the name of their schema, without `null`: a field that is not used is
/// left out.
fn forms(document: &mut OpenApi) -> BTreeMap<String, Object> {
    let mut forms = BTreeMap::new();
    let schemas = document.components.iter_mut().flat_map(|parts| parts.schemas.iter_mut());
    for (name, schema) in schemas {
        if let (true, RefOr::T(Schema::Object(form))) = (name.ends_with("Form"), schema) {
            form.properties.values_mut().for_each(without_null);
            forms.insert(name.clone(), form.clone());
        }
    }
    forms
}

/// Adds the alternative form of an upload: the file alone as body, and the other fields in the
/// query.
fn add_raw_body(operation: &mut Operation, forms: &BTreeMap<String, Object>) {
    let Some(RefOr::T(body)) = operation.request_body.as_mut() else { return };
    let form = body.content.values().find_map(|content| {
        let RefOr::T(Content { schema: Some(RefOr::Ref(form)), .. }) = content else { return None };
        forms.get(form.ref_location.rsplit('/').next()?)
    });
    let Some(form) = form else { return };
    body.description = Some(
        "A form, or the file itself with the other fields in the query; then any model/* media type \
         will do, too. What the file is, its content says."
            .to_owned(),
    );
    body.content.insert("application/octet-stream".to_owned(), Content::new(Some(bytes())).into());
    let parameters = operation.parameters.get_or_insert_default();
    for (name, schema) in form.properties.iter().filter(|(name, _)| *name != "file") {
        let needed = form.required.contains(name);
        let also = if needed { " Needed there." } else { "" };
        let parameter = ParameterBuilder::new()
            .name(name)
            .parameter_in(ParameterIn::Query)
            .required(Required::False)
            .description(Some(format!(
                "The form field of this name, when the body is the file itself.{also}"
            )))
            .schema(Some(schema.clone()));
        parameters.push(RefOr::T(parameter.build()));
    }
}

/// Removes `null` from what a schema allows.
fn without_null(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::T(Schema::Object(object)) => {
            if let SchemaType::Array(types) = &object.schema_type
                && let [kind, Type::Null] | [Type::Null, kind] = types.as_slice()
            {
                object.schema_type = SchemaType::Type(kind.clone());
            }
        }
        RefOr::T(Schema::OneOf(either)) => {
            let is_null = |item: &RefOr<Schema>| {
                matches!(item, RefOr::T(Schema::Object(Object { schema_type, .. }))
                    if *schema_type == SchemaType::Type(Type::Null))
            };
            either.items.retain(|item| !is_null(item));
            if let [only] = either.items.as_slice() {
                *schema = only.clone();
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests;
