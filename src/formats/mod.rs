//! Files: from bytes to the carrier mesh, and from new positions to patched bytes.
//!
//! The promise (invariant I1): a written file equals its host byte for byte outside the coordinates
//! that moved. No format is ever re-serialised; [`Asset::write`] copies the host's bytes and
//! replaces coordinates in place.
//!
//! Must not know about watermarks, HTTP or the registry. Opens no path and no URL that a file
//! names. The libraries `gltf` and `tobj` are used nowhere else.

mod gltf;
mod independent;
mod obj;
mod sniff;

use glam::DVec3;

use crate::mesh::stop::Stop;
use crate::mesh::{Mesh, MeshError};

pub use independent::{Agreement, agrees, agrees_until};
pub use sniff::sniff;

/// A file format that can be read and patched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// glTF 2.0, JSON with embedded buffers.
    Gltf,
    /// glTF 2.0, binary container.
    Glb,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Obj, Self::Gltf, Self::Glb];

    /// The registered media type.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Obj => "model/obj",
            Self::Gltf => "model/gltf+json",
            Self::Glb => "model/gltf-binary",
        }
    }

    /// The usual file name extension, without the dot. Also the format's name in JSON answers.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Obj => "obj",
            Self::Gltf => "gltf",
            Self::Glb => "glb",
        }
    }
}

/// What a parser may spend on one file. Checked before anything is allocated.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Most vertices of one file, all POSITION accessors or `v` lines together.
    pub max_vertices: usize,
    /// Most triangles of one file, after polygons are split and strips unrolled.
    pub max_triangles: usize,
    /// Most bytes of one file.
    pub max_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_vertices: 50_000_000, max_triangles: 100_000_000, max_bytes: 1 << 30 }
    }
}

/// Why a file cannot be read or patched. One variant per cause; the text tells the user what
/// to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FormatError {
    /// Zero bytes.
    #[error("the file is empty; upload an OBJ, GLB or glTF file")]
    Empty,
    /// Not a format that can be read. `looks_like` names what it seems to be.
    #[error("{looks_like}; quadmark reads Wavefront OBJ, GLB and glTF 2.0: convert the file first")]
    UnknownFormat {
        /// A clause: "this looks like a PLY file", "this is not a mesh file that quadmark knows".
        looks_like: String,
    },
    /// Over one of the [`Limits`].
    #[error("the file has {count} {what}, the limit is {limit}")]
    TooLarge {
        /// "bytes", "vertices", "triangles".
        what: &'static str,
        /// What was found, or what the file declares.
        count: u64,
        /// The limit.
        limit: u64,
    },
    /// An OBJ line that cannot be read.
    #[error("line {line}: {reason}")]
    MalformedObj {
        /// One-based line number.
        line: u64,
        /// What is wrong and what is expected.
        reason: String,
    },
    /// A glTF structure that cannot be read.
    #[error("{path}: {reason}")]
    MalformedGltf {
        /// JSON path such as `accessors[3].count`, or a part of the container such as `GLB header`.
        path: String,
        /// What is wrong and what is expected.
        reason: String,
    },
    /// A glTF extension that the geometry depends on and that is not supported.
    #[error("{extension} is not supported yet: {advice}")]
    UnsupportedExtension {
        /// For example `KHR_draco_mesh_compression`.
        extension: String,
        /// What to do instead.
        advice: String,
    },
    /// A glTF buffer that lives in another file.
    #[error(
        "buffers[{buffer}] is the separate file {uri:?}: pack the asset as GLB or embed its buffers as data URIs"
    )]
    ExternalBuffer {
        /// Index of the buffer.
        buffer: usize,
        /// Its URI, shortened to at most 100 characters.
        uri: String,
    },
    /// A vertex position that is NaN or infinite.
    #[error("{place}: a coordinate is not a finite number; repair the mesh first")]
    NonFiniteVertex {
        /// `line 12` or `accessors[0], element 7`.
        place: String,
    },
    /// A legal file whose layout cannot be patched without touching something else.
    #[error("{path}: {reason}")]
    CannotPatch {
        /// JSON path or line.
        path: String,
        /// Why, and what to do.
        reason: String,
    },
    /// The caller stopped the job.
    #[error("reading was given up")]
    Cancelled,
    /// No triangles at all.
    #[error("the file has no triangles, so there is no surface to mark or read")]
    NoTriangles,
    /// The written file does not read back as requested. Never expected: the check that reports it
    /// keeps a bug from becoming a damaged asset.
    #[error("the written file does not read back: {reason}")]
    ReadBack {
        /// What differs.
        reason: String,
    },
}

impl From<MeshError> for FormatError {
    fn from(error: MeshError) -> Self {
        match error {
            MeshError::NoTriangles => Self::NoTriangles,
            MeshError::NonFiniteVertex { vertex } => {
                Self::NonFiniteVertex { place: format!("vertex {vertex}") }
            }
            other => Self::ReadBack { reason: other.to_string() },
        }
    }
}

fn go_on(stop: Stop<'_>) -> Result<(), FormatError> {
    if stop() { Err(FormatError::Cancelled) } else { Ok(()) }
}

/// A parsed file: its geometry, and where in the bytes each coordinate stands.
///
/// Holds no copy of the bytes; the caller hands them in again to [`Asset::write`].
#[derive(Debug)]
pub struct Asset {
    format: Format,
    mesh: Mesh,
    layout: Layout,
}

#[derive(Debug)]
enum Layout {
    Obj(obj::Layout),
    Gltf(gltf::Layout),
}

impl Asset {
    /// Sniffs and parses a file.
    ///
    /// # Errors
    /// [`FormatError`], naming the line or the JSON path.
    pub fn read(bytes: &[u8], limits: &Limits) -> Result<Self, FormatError> {
        Self::read_until(bytes, limits, &|| false)
    }

    /// Like [`Self::read`], calling `stop` about once per megabyte.
    ///
    /// # Errors
    /// Also [`FormatError::Cancelled`], once `stop` returns `true`.
    pub fn read_until(bytes: &[u8], limits: &Limits, stop: Stop<'_>) -> Result<Self, FormatError> {
        if bytes.len() > limits.max_bytes {
            return Err(FormatError::TooLarge {
                what: "bytes",
                count: bytes.len() as u64,
                limit: limits.max_bytes as u64,
            });
        }
        let format = sniff(bytes)?;
        let (mesh, layout) = match format {
            Format::Obj => {
                let (mesh, layout) = obj::read(bytes, limits, stop)?;
                (mesh, Layout::Obj(layout))
            }
            Format::Gltf | Format::Glb => {
                let (mesh, layout) = gltf::read(bytes, format, limits, stop)?;
                (mesh, Layout::Gltf(layout))
            }
        };
        Ok(Self { format, mesh, layout })
    }

    /// The sniffed format.
    #[must_use]
    pub fn format(&self) -> Format {
        self.format
    }

    /// The geometry: every vertex of the file in file order, world space.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Drops everything but the geometry.
    #[must_use]
    pub fn into_mesh(self) -> Mesh {
        self.mesh
    }

    /// Vertices that the file cannot move (for example elements of a glTF accessor that has no
    /// bytes of its own). Ascending; usually empty.
    #[must_use]
    pub fn pinned(&self) -> &[u32] {
        match &self.layout {
            Layout::Obj(_) => &[],
            Layout::Gltf(layout) => layout.pinned(),
        }
    }

    /// This asset, written with steps of at most `step` (in the file's unit) where its numbers are
    /// text. Coordinates that have finer steps in the host keep them. 0 means the finest steps that
    /// are of any use.
    #[must_use]
    pub fn with_step(&self, step: f64) -> Stepped<'_> {
        Stepped { asset: self, step }
    }

    /// Whether steps of `step` are coarser than the finest that are of any use.
    #[must_use]
    pub fn is_coarse(&self, step: f64) -> bool {
        match &self.layout {
            Layout::Obj(layout) => layout.is_coarse(step),
            Layout::Gltf(_) => false,
        }
    }

    /// [`Stepped::round`] with the finest steps.
    pub fn round(&self, positions: &mut [DVec3]) {
        self.with_step(0.0).round(positions);
    }

    /// [`Stepped::write`] with the finest steps.
    ///
    /// # Errors
    /// As [`Stepped::write`].
    pub fn write(&self, host: &[u8], positions: &[DVec3]) -> Result<Vec<u8>, FormatError> {
        Ok(self.with_step(0.0).write(host, positions)?.bytes)
    }
}

/// A written file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Number of coordinates with more decimals than in the host, where its steps would be too
    /// coarse.
    pub more_decimals: u64,
}

/// An asset and the steps that its moved coordinates are written with.
#[derive(Debug, Clone, Copy)]
pub struct Stepped<'a> {
    asset: &'a Asset,
    step: f64,
}

impl Stepped<'_> {
    /// Replaces every position by what it would read back as after [`Stepped::write`]: rounded to
    /// the file's number format. Positions bit-equal to the host's stay as they are.
    ///
    /// `positions` has one entry per vertex of [`Asset::mesh`].
    pub fn round(&self, positions: &mut [DVec3]) {
        self.round_until(positions, &|| false);
    }

    /// Like [`Self::round`]; meaningless once `stop` returns `true`.
    pub fn round_until(&self, positions: &mut [DVec3], stop: Stop<'_>) {
        let Asset { mesh, layout, .. } = self.asset;
        match layout {
            Layout::Obj(layout) => layout.with_step(self.step).round(mesh, positions, stop),
            Layout::Gltf(layout) => layout.round(mesh, positions, stop),
        }
    }

    /// The host's bytes with the coordinates of moved vertices replaced; a vertex whose position
    /// is bit-equal to the host's keeps its bytes. `host` is what [`Asset::read`] was given.
    ///
    /// # Errors
    /// [`FormatError::ReadBack`] when `host` or `positions` do not belong to this asset, or a
    /// position cannot be represented in the file.
    pub fn write(&self, host: &[u8], positions: &[DVec3]) -> Result<Written, FormatError> {
        self.write_until(host, positions, &|| false)
    }

    /// Like [`Self::write`], as long as `stop` returns `false`.
    ///
    /// # Errors
    /// Also [`FormatError::Cancelled`].
    pub fn write_until(
        &self,
        host: &[u8],
        positions: &[DVec3],
        stop: Stop<'_>,
    ) -> Result<Written, FormatError> {
        let Asset { mesh, layout, .. } = self.asset;
        match layout {
            Layout::Obj(layout) => layout.with_step(self.step).write(host, mesh, positions, stop),
            Layout::Gltf(layout) => {
                Ok(Written { bytes: layout.write(host, mesh, positions, stop)?, more_decimals: 0 })
            }
        }
    }
}
