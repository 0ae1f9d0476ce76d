//! The stable error codes, which programs compare, each with its status and title.
//!
//! A code is never renamed and never changes its status within version 1.

use axum::http::StatusCode;

macro_rules! codes {
    ($($variant:ident = $status:ident, $name:literal, $title:literal;)*) => {
        /// A stable error code.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum Code { $($variant),* }

        impl Code {
            /// All codes, for the documentation.
            pub(super) const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name in answers.
            pub(super) fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// Its title: the same for every occurrence.
            pub(super) fn title(self) -> &'static str {
                match self { $(Self::$variant => $title),* }
            }

            /// Whether answers with this code may say when the same request may succeed
            /// (`Retry-After`).
            pub(super) fn may_say_when(self) -> bool {
                matches!(
                    self,
                    Self::Busy
                        | Self::DeadlineExceeded
                        | Self::ShuttingDown
                        | Self::IdempotencyInProgress
                        | Self::UploadsFull
                        | Self::TooManyConnections
                        | Self::InsufficientStorage
                )
            }

            /// Its status.
            pub(super) fn status(self) -> StatusCode {
                match self { $(Self::$variant => StatusCode::$status),* }
            }
        }
    };
}

codes! {
    MalformedRequest = BAD_REQUEST, "malformed_request", "The request cannot be read";
    MalformedMultipart = BAD_REQUEST, "malformed_multipart", "The form cannot be read";
    UploadIncomplete = BAD_REQUEST, "upload_incomplete", "The upload ended too early";
    MissingParameter = BAD_REQUEST, "missing_parameter", "A parameter is missing";
    UnknownParameter = BAD_REQUEST, "unknown_parameter", "There is no such parameter";
    DuplicateParameter = BAD_REQUEST, "duplicate_parameter", "A parameter is given twice";
    InvalidParameter = BAD_REQUEST, "invalid_parameter", "A parameter has an impossible value";
    CrossOrigin = FORBIDDEN, "cross_origin", "A page from elsewhere may not use this service";
    NotFound = NOT_FOUND, "not_found", "There is nothing here";
    UnknownWatermark = NOT_FOUND, "unknown_watermark", "There is no such watermark";
    UnknownVerification = NOT_FOUND, "unknown_verification", "There is no such verification";
    FileNotKept = NOT_FOUND, "file_not_kept", "The marked file was not kept";
    MethodNotAllowed = METHOD_NOT_ALLOWED, "method_not_allowed", "The method does not apply here";
    NotAcceptable = NOT_ACCEPTABLE, "not_acceptable", "The answer is nothing that Accept takes";
    UploadTimeout = REQUEST_TIMEOUT, "upload_timeout", "The upload took too long";
    IdempotencyConflict = CONFLICT, "idempotency_conflict", "The key stands for another request";
    IdempotencyInProgress = CONFLICT, "idempotency_in_progress", "The same request is being worked on";
    IdempotencyRevoked = CONFLICT, "idempotency_revoked", "The key stands for a revoked mark";
    CannotRemake = CONFLICT, "cannot_remake", "The marked file cannot be made again";
    AlreadyMarked = CONFLICT, "already_marked", "The file already carries a registered mark";
    PreconditionFailed = PRECONDITION_FAILED, "precondition_failed", "The file is another one";
    TooLarge = PAYLOAD_TOO_LARGE, "too_large", "The upload is too large";
    HostNotAllowed = MISDIRECTED_REQUEST, "host_not_allowed",
        "The service is not known under this name";
    UnsupportedMediaType = UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type",
        "The content type cannot be used";
    UnknownFormat = UNSUPPORTED_MEDIA_TYPE, "unknown_format", "The file is of no format that can be read";
    RangeNotSatisfiable = RANGE_NOT_SATISFIABLE, "range_not_satisfiable",
        "The file has no such bytes";
    EmptyFile = UNPROCESSABLE_ENTITY, "empty_file", "The file is empty";
    MalformedObj = UNPROCESSABLE_ENTITY, "malformed_obj", "The OBJ file cannot be read";
    MalformedGltf = UNPROCESSABLE_ENTITY, "malformed_gltf", "The glTF file cannot be read";
    UnsupportedExtension = UNPROCESSABLE_ENTITY, "unsupported_extension",
        "A glTF extension is not supported";
    ExternalBuffer = UNPROCESSABLE_ENTITY, "external_buffer", "A glTF buffer is in another file";
    NonFiniteVertex = UNPROCESSABLE_ENTITY, "non_finite_vertex", "A coordinate is not a finite number";
    CannotPatch = UNPROCESSABLE_ENTITY, "cannot_patch", "The file cannot be changed in place";
    NoTriangles = UNPROCESSABLE_ENTITY, "no_triangles", "The file has no triangles";
    NothingToCompare = UNPROCESSABLE_ENTITY, "nothing_to_compare",
        "There is no mark to compare the file with";
    InsufficientCapacity = UNPROCESSABLE_ENTITY, "insufficient_capacity",
        "The mesh cannot carry the mark";
    DistortionUnreachable = UNPROCESSABLE_ENTITY, "distortion_unreachable",
        "No mark stays within the distortion allowed";
    NoRadialExtent = UNPROCESSABLE_ENTITY, "no_radial_extent",
        "All vertices are at the same distance from the centre";
    Unprocessable = UNPROCESSABLE_ENTITY, "unprocessable", "The request cannot be done";
    Internal = INTERNAL_SERVER_ERROR, "internal", "Something went wrong on our side";
    FileLost = INTERNAL_SERVER_ERROR, "file_lost", "The marked file is missing or damaged";
    CheckFailed = INTERNAL_SERVER_ERROR, "check_failed", "The marked file failed its check";
    Busy = SERVICE_UNAVAILABLE, "busy", "The service is busy";
    UploadsFull = SERVICE_UNAVAILABLE, "uploads_full", "Too many uploads are on their way";
    TooManyConnections = SERVICE_UNAVAILABLE, "too_many_connections",
        "The service has too many connections";
    DeadlineExceeded = SERVICE_UNAVAILABLE, "deadline_exceeded", "The request took too long";
    ShuttingDown = SERVICE_UNAVAILABLE, "shutting_down", "The service is shutting down";
    InsufficientStorage = INSUFFICIENT_STORAGE, "insufficient_storage",
        "The disk of the service is full";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct_and_errors() {
        for (index, code) in Code::ALL.iter().enumerate() {
            assert!(code.status().as_u16() >= 400);
            let same = Code::ALL.iter().skip(index + 1).any(|other| other.name() == code.name());
            assert!(!same, "{}", code.name());
        }
    }
}
