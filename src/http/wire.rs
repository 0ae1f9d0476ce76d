//! Wire types: the forms of requests and answers. They are separate from the types of the registry,
//! so that a change of one does not change the other by accident.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

#[allow(unused_imports)] // schemas name them
use super::schemas::{FormatName, LayersName, MethodName, OrderName};
use crate::forecast::Expected;
use crate::registry::{Cursor, ExistingMark, Page, Quality, Record};
use crate::relief::Amplitude;
use crate::service::Inspected;

/// A registered mark.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Watermark)]
pub(super) struct WatermarkBody {
    /// Its id.
    #[schema(value_type = String, format = "uuid")]
    id: Uuid,
    /// Whose mark it is.
    #[schema(example = "acme")]
    owner_id: String,
    /// The recipient of this copy.
    #[schema(example = "studio-7")]
    recipient: Option<String>,
    /// The owner's free text.
    label: Option<String>,
    /// How it was embedded.
    #[schema(value_type = MethodName)]
    method: String,
    /// Version of the watermark scheme.
    scheme: u16,
    /// Strength of the blind layer; with `max_distortion`, the strength that was found.
    #[schema(minimum = 0.01, maximum = 0.25)]
    strength: f64,
    /// Number of bits.
    #[schema(minimum = 16, maximum = 256)]
    bits: usize,
    /// The message in hexadecimal digits.
    #[schema(pattern = "^([0-9a-f]{2})+$")]
    message: String,
    /// The message that the caller gave, in hexadecimal digits.
    #[schema(pattern = "^([0-9a-f]{2})+$")]
    payload: Option<String>,
    /// Id of the master key; it reveals nothing about the key.
    #[schema(example = "7f2971a5")]
    key_id: String,
    /// Format of the marked file.
    #[schema(value_type = FormatName)]
    format: String,
    /// File name of the upload.
    file_name: Option<String>,
    /// SHA-256 of the host file.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    host_sha256: String,
    /// SHA-256 of the marked file.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    marked_sha256: String,
    /// Bytes of the marked file.
    marked_bytes: u64,
    /// Vertices in the file.
    vertices: u64,
    /// Triangles in the file.
    triangles: u64,
    /// The layers that its file has. It is `relief` if the mesh could not carry the blind layer, or
    /// if the request asked for the relief alone; such a mark is read against the kept host only.
    #[schema(value_type = LayersName)]
    layers: &'static str,
    /// How far the relief moves the surface: the root mean square distance, as a share of the
    /// bounding box's diagonal; null without a relief.
    #[schema(minimum = 0)]
    amplitude: Option<f64>,
    /// Bins of the blind layer that carry a bit.
    usable_bins: u32,
    /// The distortion of the mesh by the mark; null in records from before it was measured.
    quality: Option<QualityBody>,
    /// Registered marks that the host already carried, best first; null in records from before
    /// hosts were searched for marks.
    existing_marks: Option<Vec<ExistingMarkBody>>,
    /// Where the marked file can be fetched again; null when it was not kept.
    #[schema(format = "uri-reference")]
    file_url: Option<String>,
    /// Whether the host's geometry was kept.
    host_kept: bool,
    /// When it was registered.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When it was revoked.
    #[schema(value_type = Option<String>, format = DateTime)]
    revoked_at: Option<Timestamp>,
}

/// The distortion of a mesh by its mark. Lengths are shares of the bounding box's diagonal.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Quality)]
pub(super) struct QualityBody {
    /// Root mean square distance between the surfaces (Metro, the larger of both directions).
    #[schema(minimum = 0)]
    mrms: f64,
    /// Largest distance between the surfaces.
    #[schema(minimum = 0)]
    hausdorff: f64,
    /// Largest displacement of a vertex, along the surface or off it.
    #[schema(minimum = 0)]
    max_displacement: f64,
    /// Mean angle between the triangles' normals before and after, weighted by area.
    #[schema(minimum = 0)]
    normal_deviation_degrees: f64,
    /// Triangles that turned by more than 90 degrees.
    flipped: u64,
    /// The method that chose the positions: the requested one, or the paper's (`qsp-`) if an
    /// `exact-` one did not settle.
    #[schema(value_type = MethodName)]
    method_used: String,
    /// Number of coordinates of an OBJ that are written with more decimals than in the host,
    /// because the mark needs them. The others have as many as in the host, or fewer. Null in
    /// records from before they were counted.
    more_decimals: Option<u64>,
}

/// A registered mark that a host already carried.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ExistingMark)]
pub(super) struct ExistingMarkBody {
    /// Its record.
    #[schema(value_type = String, format = "uuid")]
    watermark_id: Uuid,
    /// Whose mark it is.
    owner_id: String,
    /// log10 of the bound on the probability that a file without this mark scores so high.
    #[schema(maximum = 0)]
    log10_fp: f64,
}

impl From<ExistingMark> for ExistingMarkBody {
    fn from(mark: ExistingMark) -> Self {
        let ExistingMark { watermark_id, owner_id, log10_fp } = mark;
        Self { watermark_id, owner_id, log10_fp }
    }
}

impl From<Quality> for QualityBody {
    fn from(quality: Quality) -> Self {
        Self {
            mrms: quality.mrms,
            hausdorff: quality.hausdorff,
            max_displacement: quality.max_displacement,
            normal_deviation_degrees: quality.normal_deviation_degrees,
            flipped: quality.flipped,
            method_used: quality.method_used,
            more_decimals: quality.more_decimals,
        }
    }
}

impl From<Record> for WatermarkBody {
    fn from(record: Record) -> Self {
        let existing = record.existing_marks;
        let file_url = record.file_kept.then(|| format!("/v1/watermarks/{}/file", record.id));
        Self {
            id: record.id,
            owner_id: record.owner_id,
            recipient: record.recipient,
            label: record.label,
            method: record.method.to_string(),
            scheme: record.scheme,
            strength: record.strength.get(),
            bits: record.bits.get(),
            message: hex::encode(&record.message),
            payload: record.payload.map(hex::encode),
            key_id: record.key_id,
            format: record.format.extension().to_owned(),
            file_name: record.file_name,
            host_sha256: hex::encode(record.host_sha256),
            marked_sha256: hex::encode(record.marked_sha256),
            marked_bytes: record.marked_bytes,
            vertices: record.vertices,
            triangles: record.triangles,
            layers: record.layers.name(),
            amplitude: record.amplitude.map(Amplitude::get),
            usable_bins: record.usable_bins,
            quality: record.quality.map(QualityBody::from),
            existing_marks: existing
                .map(|all| all.into_iter().map(ExistingMarkBody::from).collect()),
            file_url,
            host_kept: record.host_kept,
            created_at: record.created_at,
            revoked_at: record.revoked_at,
        }
    }
}

/// A page of registered marks, in the order of their registration.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WatermarkPage)]
pub(super) struct WatermarkPageBody {
    /// The marks.
    watermarks: Vec<WatermarkBody>,
    /// Send it as `cursor` to get the next page; null on the last page.
    next_cursor: Option<String>,
    /// With `order=oldest`: send it as `cursor`, now or later, to get what was registered after
    /// this page. A client that follows these cursors sees every mark once and misses none. Null
    /// while there is no mark.
    resume_cursor: Option<String>,
}

impl From<Page> for WatermarkPageBody {
    fn from(page: Page) -> Self {
        Self {
            watermarks: page.records.into_iter().map(WatermarkBody::from).collect(),
            next_cursor: page.next.map(Cursor::to_text),
            resume_cursor: page.resume.map(Cursor::to_text),
        }
    }
}

/// The page and the marks that are requested.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// Only this owner's.
    #[param(min_length = 1, max_length = 256, example = "acme")]
    pub(super) owner_id: Option<String>,
    /// Only copies for this recipient.
    #[param(min_length = 1, max_length = 256)]
    pub(super) recipient: Option<String>,
    /// `newest` (the default) or `oldest` first, by registration. Neither ids nor times give that
    /// order reliably: an id is drawn when its request begins, and a clock may jump.
    #[param(value_type = Option<OrderName>)]
    pub(super) order: Option<String>,
    /// `next_cursor` or `resume_cursor` of an earlier page.
    pub(super) cursor: Option<String>,
    /// Marks on the page: 1 to 200; the default is 50.
    #[param(minimum = 1, maximum = 200)]
    pub(super) limit: Option<u32>,
}

/// What a file is and how well it can carry a mark.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Inspection)]
pub(super) struct InspectionBody {
    /// SHA-256 of the file.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    sha256: String,
    /// Bytes of the file.
    bytes: u64,
    /// Format of the file.
    #[schema(value_type = FormatName)]
    format: &'static str,
    /// Vertices of the file.
    vertices: usize,
    /// Triangles of the file.
    triangles: usize,
    /// Distinct points that a triangle with area uses.
    carriers: usize,
    /// Bounding-box diagonal of the carriers, in the file's unit.
    diagonal: f64,
    /// Area-weighted centre.
    centre: [f64; 3],
    /// Smallest vertex norm.
    rho_min: f64,
    /// Largest vertex norm.
    rho_max: f64,
    /// Number of bits that the request asks about.
    bits: usize,
    /// Bins with enough vertices in the poorest of all layout classes.
    usable_bins: usize,
    /// Bins that a mark needs.
    needed_bins: usize,
    /// Vertices of the median bin, in the poorest class.
    median_count: usize,
    /// Vertices of the poorest bin of that class.
    least_count: usize,
    /// Whether a mark of this size can be tried. Only the embedding itself shows whether the bins
    /// can really be moved.
    markable: bool,
    /// Expected signal of a median bin over its sampling noise, `strength sqrt(n) / sigma`, with
    /// sigma of an even bin: the margin of the mark against noise.
    expected_margin: f64,
    /// Decimal logarithm of the best false-positive bound that a mark can reach, before hypotheses
    /// are counted.
    best_log10_fp: f64,
    /// The damage that a mark of this method, strength and size is expected to survive: the bound
    /// after each of a series of attacks. Empty if no mark can be tried.
    expected: Vec<ExpectedBody>,
}

/// The expected bound of a mark after an attack, by a model that was fitted to measurements.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Expected)]
pub(super) struct ExpectedBody {
    /// The attack and its strength.
    attack: &'static str,
    /// Decimal logarithm of the false-positive bound, for a reading without the host and one
    /// record.
    log10_fp: f64,
    /// Root mean square error of this logarithm on meshes that the model was not fitted to.
    error: f64,
}

impl From<Inspected> for InspectionBody {
    fn from(Inspected { sha256, bytes, inspection, expected }: Inspected) -> Self {
        let body =
            |Expected { attack, log10_fp, error, .. }| ExpectedBody { attack, log10_fp, error };
        Self {
            sha256: hex::encode(sha256),
            bytes,
            format: inspection.format,
            vertices: inspection.vertices,
            triangles: inspection.triangles,
            carriers: inspection.carriers,
            diagonal: inspection.diagonal,
            centre: inspection.centre,
            rho_min: inspection.rho_min,
            rho_max: inspection.rho_max,
            bits: inspection.bits,
            usable_bins: inspection.usable_bins,
            needed_bins: inspection.needed_bins,
            median_count: inspection.median_count,
            least_count: inspection.least_count,
            markable: inspection.markable,
            expected_margin: inspection.expected_margin,
            best_log10_fp: inspection.best_log10_fp,
            expected: expected.into_iter().map(body).collect(),
        }
    }
}

/// Whether the service is alive or ready.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Health)]
pub(super) struct HealthBody {
    /// `ok`.
    pub(super) status: &'static str,
    /// The service's version.
    pub(super) version: &'static str,
    /// Number of marks that are not recognised because their master keys are missing. Only
    /// `/readyz` gives it, and only if there are such marks and a setting allowed the start without
    /// their keys.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(super) unreadable_marks: Option<u64>,
}
