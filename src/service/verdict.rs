//! Verdicts, as they are answered and kept.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// The answer to "whose mark is it".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The bound is below the match threshold.
    Match,
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
    /// The host's own: the suspect was neither moved nor scaled.
    InPlace,
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
    /// In which frame it was read.
    pub frame: FrameName,
}

/// What the suspect is.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FileFacts {
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
    /// `obj`, `gltf` or `glb`.
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
    /// How many hypotheses were scored; the bounds count them all.
    pub hypotheses: u64,
    /// Best first; only those below the inconclusive threshold.
    pub matches: Vec<Match>,
    /// The suspect.
    pub file: FileFacts,
}
