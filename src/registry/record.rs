//! Records and the small types around them.
//!
//! Must not know how they are stored.

use std::str::FromStr;

use base64::Engine as _;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use crate::formats::Format;
use crate::relief::{Amplitude, Layers};
use crate::watermark::{BitCount, Frame, Method, Strength};

/// One registered mark.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// UUID version 7, drawn when the request began. Records are registered in another order, which
    /// is the order of their rows.
    pub id: Uuid,
    /// Whose mark it is.
    pub owner_id: String,
    /// The recipient of this copy.
    pub recipient: Option<String>,
    /// The owner's free text.
    pub label: Option<String>,
    /// How it was embedded.
    pub method: Method,
    /// Version of the watermark scheme; later releases still read it.
    pub scheme: u16,
    /// The layers that its file has.
    pub layers: Layers,
    /// How far the relief moves the surface; none without a relief.
    pub amplitude: Option<Amplitude>,
    /// Embedding strength of the blind layer, as used.
    pub strength: Strength,
    /// Length of the message.
    pub bits: BitCount,
    /// Id of the master key; never the key itself.
    pub key_id: String,
    /// Random, an input of the mark key's derivation.
    pub salt: [u8; 32],
    /// The message, most significant bit first.
    pub message: Vec<u8>,
    /// The message that the caller gave, if any.
    pub payload: Option<Vec<u8>>,
    /// The host's frame, for detection in place (frame `in_place`).
    pub frame: Frame,
    /// SHA-256 of the host file.
    pub host_sha256: [u8; 32],
    /// Key of the host's geometry. Marks of one host are counted together by it, and a kept host is
    /// stored under it. Records from before hosts were stored once per geometry have none.
    pub host_geometry: Option<[u8; 32]>,
    /// SHA-256 of the marked file.
    pub marked_sha256: [u8; 32],
    /// Length of the marked file.
    pub marked_bytes: u64,
    /// Format of both files.
    pub format: Format,
    /// File name of the upload.
    pub file_name: Option<String>,
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Bins that carry a bit.
    pub usable_bins: u32,
    /// The distortion of the mesh by the mark. Records from before it was measured have none.
    pub quality: Option<Quality>,
    /// Marks that the host carried, best first; none if the host was not searched.
    pub existing_marks: Option<Vec<ExistingMark>>,
    /// The marked file is in the blob store.
    pub file_kept: bool,
    /// The host's geometry is in the blob store.
    pub host_kept: bool,
    /// When it was registered.
    pub created_at: Timestamp,
    /// When it was revoked. A revoked mark is kept and not searched for.
    pub revoked_at: Option<Timestamp>,
}

/// The inputs that a record's codeword is derived from.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkSource {
    /// The record.
    pub id: Uuid,
    /// Whose mark it is.
    pub owner_id: String,
    /// How it was embedded.
    pub method: Method,
    /// Length of the message.
    pub bits: BitCount,
    /// Id of the master key.
    pub key_id: String,
    /// Random, an input of the mark key's derivation.
    pub salt: [u8; 32],
    /// The message, most significant bit first.
    pub message: Vec<u8>,
}

impl Record {
    /// The inputs that its codeword is derived from.
    #[must_use]
    pub fn source(&self) -> MarkSource {
        MarkSource {
            id: self.id,
            owner_id: self.owner_id.clone(),
            method: self.method,
            bits: self.bits,
            key_id: self.key_id.clone(),
            salt: self.salt,
            message: self.message.clone(),
        }
    }
}

/// The stored sketch of a host's geometry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostSketch {
    /// Number of its row.
    pub row: i64,
    /// Key of the geometry.
    pub geometry: [u8; 32],
    /// The sketch.
    pub sketch: Vec<u8>,
}

/// The distortion of a mesh by its mark. Lengths are shares of the bounding box's diagonal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Root mean square distance between the surfaces, as Metro measures it.
    pub mrms: f64,
    /// Largest distance between the surfaces, as Metro measures it.
    pub hausdorff: f64,
    /// Largest displacement of a vertex.
    pub max_displacement: f64,
    /// Mean angle between the normals before and after.
    pub normal_deviation_degrees: f64,
    /// Triangles that turned by more than 90 degrees.
    pub flipped: u64,
    /// The method that chose the positions: another one than requested if that one did not settle.
    pub method_used: String,
    /// Number of coordinates that are written with more decimals than in the host, because the mark
    /// needs them. Records from before they were counted have none.
    #[serde(default)]
    pub more_decimals: Option<u64>,
}

/// A mark that a host carried before it was marked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExistingMark {
    /// Its record.
    pub watermark_id: Uuid,
    /// Whose mark it is.
    pub owner_id: String,
    /// log10 of the false-positive bound with which it was found.
    pub log10_fp: f64,
}

/// The counts beside a record that its bound is charged for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Refused tries for its host and owner between their record before it and this one.
    pub refused_before: u64,
    /// Other records of the same host and owner, revoked or not.
    pub siblings: u64,
    /// The revoked ones among its siblings.
    pub revoked_siblings: u64,
    /// Number of questions that were asked about it.
    pub asked: u64,
}

/// Which records a page shows.
#[derive(Debug, Clone, Default)]
pub struct Filter {
    /// Only this owner's.
    pub owner_id: Option<String>,
    /// Only copies for this recipient.
    pub recipient: Option<String>,
}

/// The order of the records on a page. It is the order of registration, which neither ids nor times
/// give reliably: an id is drawn before the marking, and a clock may jump.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// The last registered first.
    #[default]
    Newest,
    /// The first registered first. A reader that follows the cursors sees every record once,
    /// because no record is ever registered before one that was already read.
    Oldest,
}

impl Order {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Newest, Self::Oldest];

    /// Its name in requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Newest => "newest",
            Self::Oldest => "oldest",
        }
    }
}

impl FromStr for Order {
    type Err = &'static str;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|order| order.name() == name);
        named.ok_or("must be newest or oldest")
    }
}

/// The end of a page: the last record on it. Opaque to callers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cursor(pub(super) Uuid);

impl Cursor {
    /// The text of the cursor, which callers send back.
    #[must_use]
    pub fn to_text(self) -> String {
        BASE64_URL_SAFE_NO_PAD.encode(self.0.as_bytes())
    }

    /// Reads what [`Cursor::to_text`] wrote; `None` for anything else.
    #[must_use]
    pub fn from_text(text: &str) -> Option<Self> {
        let bytes = BASE64_URL_SAFE_NO_PAD.decode(text).ok()?;
        Uuid::from_slice(&bytes).ok().map(Self)
    }
}

/// A page of records.
#[derive(Debug)]
pub struct Page {
    /// The records, in the requested order.
    pub records: Vec<Record>,
    /// Where the next page begins; `None` on the last one.
    pub next: Option<Cursor>,
    /// With [`Order::Oldest`], the cursor for the records that are registered later; `None` while
    /// there is no record.
    pub resume: Option<Cursor>,
}

/// Number of records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Those that are not revoked.
    pub live: u64,
    /// Those that are.
    pub revoked: u64,
}

/// The use of an idempotency key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdempotencyEntry {
    /// The owner of the key. Two owners may choose the same key.
    pub owner_id: String,
    /// The caller's key.
    pub key: String,
    /// SHA-256 over the parameters of the request and its file's hash.
    pub fingerprint: [u8; 32],
    /// The record that the request made.
    pub watermark_id: Uuid,
}

/// A verdict as it was answered.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredVerification {
    /// UUID version 7.
    pub id: Uuid,
    /// When it was answered.
    pub created_at: Timestamp,
    /// The answer.
    pub answer: serde_json::Value,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_read_back() {
        for order in Order::ALL {
            assert_eq!(order.name().parse(), Ok(order));
        }
        assert!("random".parse::<Order>().is_err());
    }

    #[test]
    fn cursors_survive_and_nonsense_does_not() {
        let cursor = Cursor(Uuid::now_v7());
        assert_eq!(Cursor::from_text(&cursor.to_text()), Some(cursor));
        for text in ["", "abc", "!!!!", &"A".repeat(500), "AAAAAAAAAAAAAAAAAAAAAA=="] {
            assert_eq!(Cursor::from_text(text), None, "{text}");
        }
    }
}
