//! Verdicts, in the form in which they are answered and kept.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

use super::verify::Depth;

/// The answer to "whose mark is it".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The bound is below the match threshold.
    Match,
    /// A mark was read with a bound below the match threshold, but the file does not have the shape
    /// of the mark's host: the mark may have been copied to another object.
    BlindOnly,
    /// The bound is between the thresholds.
    Inconclusive,
    /// No mark was recognised. This is not a proof that there is none.
    NoMatch,
}

/// The centre and radial range in which a mark was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameName {
    /// From the suspect alone.
    Blind,
    /// From the suspect alone, after a search: its centre or its extremes have moved.
    Searched,
    /// The host's own: the suspect was neither moved nor scaled.
    InPlace,
    /// The host's own, into which the suspect was registered.
    Registered,
}

/// A detector of the cascade.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StageName {
    /// The suspect's own centre and extremes.
    Blind,
    /// The host's own frame, for marks that the request names.
    InPlace,
    /// Centre and bin layout, searched from the suspect alone near its own centre.
    LayoutSearchNear,
    /// The same search, as far as a cut of some percent moves the centre.
    LayoutSearch,
    /// The same search, farther, and with more bin layouts.
    LayoutSearchWide,
    /// The frame of a host on the short list, in place or after registration.
    HostFrame,
    /// Heights of the suspect's surface over a host on the short list: the relief of a mark.
    Relief,
    /// The suspect's vertices one by one against a host on the short list.
    MatchedFilter,
    /// The blind frame, for marks that the request does not ask about. Their records may say that
    /// they lie over a mark that it asks about.
    Overmarks,
}

impl StageName {
    /// All stages.
    pub const ALL: [Self; 9] = [
        Self::Blind,
        Self::InPlace,
        Self::LayoutSearchNear,
        Self::LayoutSearch,
        Self::LayoutSearchWide,
        Self::HostFrame,
        Self::Relief,
        Self::MatchedFilter,
        Self::Overmarks,
    ];

    /// Its name in answers.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Blind => "blind",
            Self::InPlace => "in_place",
            Self::LayoutSearchNear => "layout_search_near",
            Self::LayoutSearch => "layout_search",
            Self::LayoutSearchWide => "layout_search_wide",
            Self::HostFrame => "host_frame",
            Self::Relief => "relief",
            Self::MatchedFilter => "matched_filter",
            Self::Overmarks => "overmarks",
        }
    }
}

/// The thresholds of verdicts, as log10 of a bound.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thresholds {
    /// A bound below this is a `match`.
    pub(super) certain: f64,
    /// A bound below this is `inconclusive`.
    pub(super) inconclusive: f64,
}

/// A centre and a radial range, in the file's unit.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FrameFacts {
    /// The centre.
    pub centre: [f64; 3],
    /// The smallest vertex norm assumed.
    pub rho_min: f64,
    /// The largest vertex norm assumed.
    pub rho_max: f64,
}

/// What the bound of a match rests on.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Evidence {
    /// The detector that found it.
    pub stage: StageName,
    /// The frame that it assumed.
    pub frame: FrameFacts,
    /// Bins that were read; for a relief, cells.
    pub bits_read: usize,
    /// Bins with too few vertices to be read; for a relief, cells that the suspect lacks.
    pub erasures: usize,
    /// Weight of each bin, in the order of the bins: `min(|z|, median |z|)`, where z is the square
    /// root of the bin's vertex count times the deviation of its statistic from neutral. The weight
    /// of an erasure is 0. Empty for a relief, whose tens of thousands of cells follow from host
    /// and suspect.
    pub weights: Vec<f64>,
    /// The sum of the weights of the bins that agree, less the sum of those that do not.
    pub score: f64,
    /// log10 of the bound on the probability that a random codeword scores so high with these
    /// weights, for one hypothesis, before any are counted.
    pub log10_bound: f64,
    /// The factor on that probability for the hypotheses that were counted: the number of
    /// hypotheses of the stage over the stage's error share.
    pub counted: f64,
    /// The number of this try for its host and owner since their last record, from 1. The tries
    /// before it were refused.
    pub tries: u64,
    /// Marks of the same host and owner that are counted with this one, itself included: the
    /// revoked ones, or all if the request named the record by its id.
    pub siblings: u64,
    /// The number of this question about the record, from 1.
    pub questions: u64,
    /// The factor on the probability for tries, siblings and questions.
    pub charged: f64,
    /// `log10_bound + log10(counted * charged)`, at most 0.
    pub log10_fp: f64,
}

/// A stage that ran.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct StageRun {
    /// Its name.
    pub stage: StageName,
    /// Hypotheses that it scored: marks times frames and bin layouts.
    pub hypotheses: u64,
    /// The stage's part of the error probability, fixed beforehand. The shares of all stages add up
    /// to at most 1.
    pub error_share: f64,
}

/// A mark that the suspect may carry.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Match {
    /// The record.
    #[schema(value_type = String, format = "uuid")]
    pub watermark_id: Uuid,
    /// Whose mark it is.
    pub owner_id: String,
    /// The recipient of the copy.
    pub recipient: Option<String>,
    /// The owner's free text.
    pub label: Option<String>,
    /// When it was registered.
    #[schema(value_type = String, format = DateTime)]
    pub registered_at: Timestamp,
    /// log10 of the bound on the probability that a file without this mark scores so high, with all
    /// hypotheses counted.
    pub log10_fp: f64,
    /// Bits that agree with the mark's codeword.
    pub bits_agreeing: usize,
    /// Bits that could be read.
    pub bits_read: usize,
    /// The mark that lies over this one, if this one was not read itself. Then `evidence` says how
    /// the mark above was read, whose record says that its host carried this mark, and the bound is
    /// the sum of both bounds.
    #[schema(value_type = Option<String>, format = "uuid")]
    pub overmarked_by: Option<Uuid>,
    /// The frame in which it was read.
    pub frame: FrameName,
    /// The share of the file's surface that lies on the host's, for the best match if it was read
    /// without the host. A point lies on the host's surface within 1.2 % of the diagonal, after
    /// registration. The share is 1 if the file's vertices are the host's in their order, with a
    /// median distance of at most 5 % of the diagonal. Below 0.5 the verdict is `blind_only`. Null
    /// if no shapes were compared: the host was not kept, the depth is `fast`, or the mark was read
    /// against the host, which is possible on the host's shape only.
    #[schema(minimum = 0, maximum = 1)]
    pub on_host: Option<f64>,
    /// What its bound rests on, for matches only: the weights of a record that the file may not
    /// carry would show where its bins lie.
    pub evidence: Option<Evidence>,
}

/// What the suspect is.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FileFacts {
    /// SHA-256 of the file, hexadecimal.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    pub sha256: String,
    /// `obj`, `gltf` or `glb`.
    #[schema(example = "obj")]
    pub format: String,
    /// Vertices in the file.
    pub vertices: usize,
    /// Triangles in the file.
    pub triangles: usize,
}

/// A verdict, with what it rests on.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Verification {
    /// Its id.
    #[schema(value_type = String, format = "uuid")]
    pub id: Uuid,
    /// When it was answered.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// The verdict.
    pub verdict: Verdict,
    /// A bound below this is a `match`.
    pub threshold_log10: f64,
    /// A bound below this is `inconclusive`.
    pub inconclusive_threshold_log10: f64,
    /// How much the request allowed to be tried.
    pub depth: Depth,
    /// The number of this question about a record, from 1: the largest for any record that the
    /// request or the answer names; 0 if neither names one. Each further question is charged to the
    /// record's bound. The same file, asked about in the same way, is the same question.
    pub questions: u64,
    /// Number of hypotheses that were scored. The bounds count all of them, each in its stage. For
    /// bin layouts, it is the mean over all classes.
    pub hypotheses: u64,
    /// The stages that ran, in order. The more expensive ones run only while the verdict is open.
    pub stages: Vec<StageRun>,
    /// Best first. Only marks with a bound below the inconclusive threshold are listed.
    pub matches: Vec<Match>,
    /// The suspect.
    pub file: FileFacts,
    /// What was compared to find the verdict: a measure of the work, not part of the answer.
    #[serde(skip)]
    #[schema(ignore)]
    pub compared_hosts: ComparedHosts,
}

/// The hosts of a short list that were compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ComparedHosts {
    /// Number of hosts.
    pub hosts: usize,
    /// Their vertices and triangles together.
    pub elements: u64,
}
