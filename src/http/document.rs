//! The `OpenAPI` document, from the code's own types.

use utoipa::OpenApi;

use super::contract::complete;
use super::error::ProblemBody;
use super::{forms, inspections, operations, schemas, verifications, watermarks, wire};
use crate::service::Verification;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "quadmark",
        description = "Marks 3D meshes with their owner's invisible, blind, robust watermark and \
                       proves from a suspect file whose mark it carries. Files are OBJ, GLB or \
                       glTF; nothing but vertex positions changes. Errors are \
                       application/problem+json with a stable code; the codes are listed at /docs.",
    ),
    paths(
        watermarks::embed,
        watermarks::page,
        watermarks::record,
        watermarks::revoke,
        watermarks::file,
        verifications::verify,
        verifications::verification,
        inspections::inspect,
        operations::livez,
        operations::readyz,
        operations::metrics,
        operations::openapi,
        operations::docs,
    ),
    components(schemas(
        ProblemBody<'_>,
        Verification,
        schemas::MethodName,
        schemas::FormatName,
        schemas::OnExistingName,
        schemas::LayersName,
        schemas::OrderName,
        schemas::CodeName,
        wire::WatermarkBody,
        wire::QualityBody,
        wire::ExistingMarkBody,
        wire::WatermarkPageBody,
        wire::InspectionBody,
        wire::HealthBody,
        forms::EmbedForm,
        forms::VerifyForm,
        forms::InspectForm,
    )),
    tags(
        (name = "watermarks", description = "Mark meshes; see, list and revoke marks"),
        (name = "verifications", description = "Whose mark does a file carry?"),
        (name = "inspections", description = "How well can a file carry a mark?"),
        (name = "operations", description = "Health, metrics, documentation"),
    )
)]
struct Document;

pub(super) fn document() -> utoipa::openapi::OpenApi {
    let mut document = Document::openapi();
    complete(&mut document);
    document
}

/// The `OpenAPI` document as YAML: what `/openapi.yaml` answers, and what the repository holds.
#[must_use]
pub fn openapi_yaml() -> String {
    document()
        .to_yaml()
        .unwrap_or_else(|error| format!("# the document cannot be written: {error}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_document_is_current() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
        let now = openapi_yaml();
        assert!(!now.starts_with('#'), "{now}");
        if std::env::var_os("QUADMARK_UPDATE_GOLDEN").is_some() {
            std::fs::write(path, &now).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            committed == now,
            "openapi.yaml differs from the code: run QUADMARK_UPDATE_GOLDEN=1 cargo test openapi"
        );
    }
}
