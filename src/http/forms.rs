//! The forms of uploads, for the document: they are read field by field.

use utoipa::ToSchema;
use uuid::Uuid;

#[allow(unused_imports)] // schemas name them
use super::schemas::{LayersName, MethodName, OnExistingName};
use crate::service::{Depth, OnExisting};

/// The form of `POST /v1/watermarks`. Fields in any order; or the file as body and the rest in
/// the query.
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
    /// To whom this copy goes: 1 to 256 characters.
    #[schema(min_length = 1, max_length = 256, example = "studio-7")]
    recipient: Option<String>,
    /// Free text: 1 to 256 characters.
    #[schema(min_length = 1, max_length = 256)]
    label: Option<String>,
    /// How to embed it; `exact-mean` by default. See the service's documentation for what each is good
    /// at.
    #[schema(value_type = Option<MethodName>)]
    method: Option<String>,
    /// Which layers it has. By default `both` where the host is kept, `blind` otherwise. With `both`, a
    /// mesh that cannot carry the blind layer gets the relief alone; the record says so.
    #[schema(value_type = Option<LayersName>)]
    layers: Option<String>,
    /// Of the blind layer: 0.01 to 0.25. By default 0.15 where it is the only layer; beside a relief at
    /// most 0.1, and so much that both together distort by at most 0.01 % of the diagonal.
    #[schema(minimum = 0.01, maximum = 0.25)]
    strength: Option<f64>,
    /// The most that the mark may distort the mesh: its `mrms`, a share of the diagonal, 0.000001
    /// to 0.1. The strongest mark within it is made, up to `strength` where that is given.
    #[schema(minimum = 0.000_001, maximum = 0.1, example = 0.0001)]
    max_distortion: Option<f64>,
    /// 16 to 256; 64 by default.
    #[schema(minimum = 16, maximum = 256)]
    bits: Option<u32>,
    /// The message in hexadecimal digits, at most `bits` bits; random by default.
    #[schema(pattern = "^([0-9A-Fa-f]{2})+$", max_length = 64, example = "0123456789abcdef")]
    payload: Option<String>,
    /// Keep the marked file, to fetch it again.
    keep_file: Option<bool>,
    /// Keep the host's geometry; detectors that compare with it need it.
    keep_host: Option<bool>,
    /// What to do when the file already carries a registered mark: `reject` (409), `warn` (by
    /// default: the header Quadmark-Existing-Marks names the marks found) or `allow` (says nothing).
    /// The record names them.
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
    /// How much is tried before the answer is `no_match`: `fast`, `standard` (by default) or
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
    /// The method that would be used.
    #[schema(value_type = Option<MethodName>)]
    method: Option<String>,
    /// The strength that would be used.
    #[schema(minimum = 0.01, maximum = 0.25)]
    strength: Option<f64>,
    /// How many bits it should carry.
    #[schema(minimum = 16, maximum = 256)]
    bits: Option<u32>,
}
