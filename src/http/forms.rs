//! The forms of uploads, for the `OpenAPI` document only: requests are read field by field.

use utoipa::ToSchema;
use uuid::Uuid;

#[allow(unused_imports)] // schemas name them
use super::schemas::{LayersName, MethodName, OnExistingName};
use crate::service::{Depth, OnExisting};

/// The form of `POST /v1/watermarks`, with its fields in any order. Alternatively the body is the
/// file, and the other fields are in the query.
#[derive(Debug, ToSchema)]
#[schema(as = EmbedForm)]
#[allow(dead_code)] // describes the form; it is read field by field
pub(super) struct EmbedForm {
    /// The host: OBJ, GLB or glTF.
    #[schema(value_type = String, format = Binary, content_media_type = "application/octet-stream")]
    file: Vec<u8>,
    /// Whose mark it is: 1 to 256 characters.
    #[schema(min_length = 1, max_length = 256, example = "acme")]
    owner_id: String,
    /// The recipient of this copy: 1 to 256 characters.
    #[schema(min_length = 1, max_length = 256, example = "studio-7")]
    recipient: Option<String>,
    /// Free text: 1 to 256 characters.
    #[schema(min_length = 1, max_length = 256)]
    label: Option<String>,
    /// The embedding method; the default is `exact-mean`. The service's documentation says what
    /// each method is good at.
    #[schema(value_type = Option<MethodName>)]
    method: Option<String>,
    /// The layers of the mark. The default is `both` if the host is kept, otherwise `blind`. With
    /// `both`, a mesh that cannot carry the blind layer gets the relief alone, and the record says
    /// so.
    #[schema(value_type = Option<LayersName>)]
    layers: Option<String>,
    /// Strength of the blind layer: 0.01 to 0.25. The default is 0.15 if it is the only layer.
    /// Beside a relief it is at most 0.1, and so low that both layers together distort by at most
    /// 0.01 % of the diagonal.
    #[schema(minimum = 0.01, maximum = 0.25)]
    strength: Option<f64>,
    /// The most that the mark may distort the mesh: its `mrms`, a share of the diagonal, 0.000001
    /// to 0.1. The strongest mark within this limit is made, with at most `strength` if that is
    /// given.
    #[schema(minimum = 0.000_001, maximum = 0.1, example = 0.0001)]
    max_distortion: Option<f64>,
    /// Number of bits: 16 to 256; the default is 64.
    #[schema(minimum = 16, maximum = 256)]
    bits: Option<u32>,
    /// The message in hexadecimal digits, at most `bits` bits; the default is random.
    #[schema(pattern = "^([0-9A-Fa-f]{2})+$", max_length = 64, example = "0123456789abcdef")]
    payload: Option<String>,
    /// Whether to keep the marked file, so that it can be fetched again.
    keep_file: Option<bool>,
    /// Whether to keep the host's geometry, which detectors that compare with it need.
    keep_host: Option<bool>,
    /// What to do if the file already carries a registered mark: `reject` (409), `warn` (the
    /// default: the header Quadmark-Existing-Marks names the found marks) or `allow` (the answer
    /// does not name them). The record names them in any case.
    #[schema(value_type = Option<OnExistingName>)]
    on_existing: Option<OnExisting>,
}

/// The form of `POST /v1/verifications`.
#[derive(Debug, ToSchema)]
#[schema(as = VerifyForm)]
#[allow(dead_code)]
pub(super) struct VerifyForm {
    /// The suspect: OBJ, GLB or glTF.
    #[schema(value_type = String, format = Binary, content_media_type = "application/octet-stream")]
    file: Vec<u8>,
    /// Compare with this owner's marks only.
    #[schema(min_length = 1, max_length = 256, example = "acme")]
    owner_id: Option<String>,
    /// Compare with this mark only.
    #[schema(value_type = Option<String>, format = "uuid")]
    watermark_id: Option<Uuid>,
    /// How much is tried before the answer is `no_match`: `fast`, `standard` (the default) or
    /// `exhaustive`.
    depth: Option<Depth>,
}

/// The form of `POST /v1/inspections`.
#[derive(Debug, ToSchema)]
#[schema(as = InspectForm)]
#[allow(dead_code)]
pub(super) struct InspectForm {
    /// The file: OBJ, GLB or glTF.
    #[schema(value_type = String, format = Binary, content_media_type = "application/octet-stream")]
    file: Vec<u8>,
    /// The method that a mark would use.
    #[schema(value_type = Option<MethodName>)]
    method: Option<String>,
    /// The strength that a mark would have.
    #[schema(minimum = 0.01, maximum = 0.25)]
    strength: Option<f64>,
    /// The number of bits that a mark would carry.
    #[schema(minimum = 16, maximum = 256)]
    bits: Option<u32>,
}
