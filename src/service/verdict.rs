//! Verdicts, as they are answered and kept.

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
    /// A mark was read with a bound below the match threshold, but the file does not have the shape of
    /// its host: the mark may have been copied on to another object.
    BlindOnly,
    /// The bound is between the thresholds.
    Inconclusive,
    /// No mark was recognised; not a proof that there is none.
    NoMatch,
}

/// The centre and radial range in which a mark was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameName {
    /// From the suspect alone.
    Blind,
    /// From the suspect alone, searched: its centre or its extremes have moved.
    Searched,
    /// The host's own: the suspect was neither moved nor scaled.
    InPlace,
    /// The host's own, into which the suspect was brought back.
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
    /// Centre and layout searched from the suspect alone, near its own centre.
    LayoutSearchNear,
    /// The same, as far as a cut of some percent moves the centre.
    LayoutSearch,
    /// The same, farther, and with more bin layouts.
    LayoutSearchWide,
    /// The frame of a host on the short list, in place or after registration.
    HostFrame,
    /// Heights of the suspect's surface over a host on the short list: the relief of a mark.
    Relief,
    /// Vertex by vertex against a host on the short list.
    MatchedFilter,
    /// The blind frame, for marks that are not asked about, but whose records may name one that is
    /// and that they were laid over.
    Overmarks,
}

impl StageName {
    /// All of them.
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

/// Where verdicts change, as log10 of a bound.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thresholds {
    /// `match` is below this.
    pub(super) certain: f64,
    /// `inconclusive` is below this.
    pub(super) inconclusive: f64,
}

/// A centre and a radial range, in the file's unit.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FrameFacts {
    /// The centre.
    pub centre: [f64; 3],
    /// The smallest vertex norm that is assumed.
    pub rho_min: f64,
    /// The largest vertex norm that is assumed.
    pub rho_max: f64,
}

/// What the bound of a match rests on.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Evidence {
    /// The detector that found it.
    pub stage: StageName,
    /// The frame that it assumed.
    pub frame: FrameFacts,
    /// Bins that were read; of a relief, cells.
    pub bits_read: usize,
    /// Bins with too few vertices to be read; of a relief, cells that the suspect does not have.
    pub erasures: usize,
    /// Weight of each bin, in the order of the bins: `min(|z|, median |z|)`, where z is the root of
    /// the bin's vertex count times its statistic's deviation from neutral; 0 for an erasure. Empty for a
    /// relief, whose tens of thousands of cells follow from host and suspect.
    pub weights: Vec<f64>,
    /// The weights of the bins that agree less those that do not.
    pub score: f64,
    /// log10 of the bound on the probability that a random codeword scores so high with these
    /// weights: one hypothesis, nothing counted.
    pub log10_bound: f64,
    /// What that probability is multiplied by: the hypotheses of the stage over its share.
    pub counted: f64,
    /// Which try this record was for its host and owner since their last one: those before it were
    /// refused.
    pub tries: u64,
    /// Marks of its host and owner that are counted with it, itself included: the revoked ones, and all
    /// where the record was named by its id.
    pub siblings: u64,
    /// Which question about the record this is, from 1.
    pub questions: u64,
    /// What the probability is multiplied by for tries, siblings and questions.
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
    /// The part of the error probability that it may spend, fixed beforehand. The shares of all
    /// stages add up to at most 1.
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
    /// To whom the copy went.
    pub recipient: Option<String>,
    /// The owner's text.
    pub label: Option<String>,
    /// When it was registered.
    #[schema(value_type = String, format = DateTime)]
    pub registered_at: Timestamp,
    /// log10 of the bound on the probability that a file without this mark scores so high, all
    /// hypotheses counted.
    pub log10_fp: f64,
    /// Bits that agree with the mark.
    pub bits_agreeing: usize,
    /// Bits that could be read.
    pub bits_read: usize,
    /// The mark that lies over this one, where this one itself was not read: `evidence` says how that
    /// one was read, its record says that its host carried this one, and the bound is the sum of
    /// both.
    #[schema(value_type = Option<String>, format = "uuid")]
    pub overmarked_by: Option<Uuid>,
    /// In which frame it was read.
    pub frame: FrameName,
    /// Which share of the file's surface lies on the host's (within 1.2 % of the diagonal, after
    /// registration; 1 where the file's vertices are the host's in their order, by at most 5 % of the
    /// diagonal in the median), of the best match where it was read without the host. Below 0.5 the verdict is
    /// `blind_only`. Null where no shape was compared: the host was not kept, the depth is `fast`, or
    /// the mark was read against the host, which is only possible on its shape.
    #[schema(minimum = 0, maximum = 1)]
    pub on_host: Option<f64>,
    /// What its bound rests on; only of a match. (Of a record that the file may not carry, the weights
    /// would tell where its bins lie.)
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
    /// `match` is below this.
    pub threshold_log10: f64,
    /// `inconclusive` is below this.
    pub inconclusive_threshold_log10: f64,
    /// How much was to be tried.
    pub depth: Depth,
    /// Which question about a record this is, from 1, the most of any that the request or the answer
    /// names; 0 where neither names one. Each further question is charged to the record's bound. The
    /// same file asked about in the same way is the same question.
    pub questions: u64,
    /// How many hypotheses were scored; the bounds count them all, each in its stage. (Of bin layouts, the
    /// mean over all classes.)
    pub hypotheses: u64,
    /// The stages that ran, in order; the more expensive ones run only while the verdict is open.
    pub stages: Vec<StageRun>,
    /// Best first; only those below the inconclusive threshold.
    pub matches: Vec<Match>,
    /// The suspect.
    pub file: FileFacts,
    /// What was looked at to find it: for whoever measures the service, not part of the answer.
    #[serde(skip)]
    #[schema(ignore)]
    pub looked_at: LookedAt,
}

/// The hosts of a short list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LookedAt {
    /// How many.
    pub hosts: usize,
    /// Their vertices and triangles together.
    pub elements: u64,
}
