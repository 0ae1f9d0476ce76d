//! An attack with its parameters, as a value. Grids list it, rows name it, and figures have its
//! amount on their axis.

use std::fmt;

use glam::DVec3;

use super::crop::{Of, crop};
use super::remesh::{Remeshing, remesh};
use super::scan::{Scanning, scan};
use super::{
    AttackError, Target, collude, cotangent, fragment, noise, pipeline, quantise, re_mark, reorder,
    round_trip, similarity, simplify, smooth, spikes, subdivide, voxel,
};
use crate::attacks::random::Random;
use crate::mesh::Mesh;
use crate::mesh::surface::Surface;
use crate::relief::{Amplitude, Field, Signs};
use crate::watermark::{Codeword, EmbedParams, MarkKey};

/// What an attack may need beside the marked mesh.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The mesh before it was marked. Other copies are made from it.
    pub host: &'a Mesh,
    /// How the mesh was marked. Other marks are made with the same parameters.
    pub params: &'a EmbedParams,
    /// Amplitude of its relief; `None` without a relief.
    pub amplitude: Option<Amplitude>,
}

/// An attack and how strong it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Attack {
    /// Nothing at all.
    None,
    /// [`noise::unit_vectors`] by this share of the largest norm.
    Noise(f64),
    /// [`noise::uniform_coordinates`] with this share of the mean norm.
    UniformNoise(f64),
    /// [`smooth::laplacian`].
    Smooth {
        /// Share of the way to the neighbours' mean.
        lambda: f64,
        /// Number of iterations.
        iterations: u32,
    },
    /// [`smooth::taubin`] with [`smooth::TAUBIN`], this often.
    Taubin(u32),
    /// [`cotangent::cotangent`].
    Cotangent {
        /// Share of the way to the neighbours' weighted mean.
        lambda: f64,
        /// Number of iterations.
        iterations: u32,
    },
    /// [`quantise::quantise`] to this many bits.
    Quantise(u32),
    /// [`simplify::simplify`], this share of the triangles removed.
    Simplify(f64),
    /// [`remesh()`] to this share of the vertices.
    Remesh(f64),
    /// [`voxel::voxel`] with cells of this share of the diagonal.
    Voxel(f64),
    /// [`scan()`] of 100,000 points with noise of this share of the diagonal.
    Scan(f64),
    /// [`subdivide::midpoint`].
    Midpoint,
    /// [`subdivide::butterfly`].
    Butterfly,
    /// [`subdivide::loop_scheme`].
    Loop,
    /// [`subdivide::sqrt3`].
    Sqrt3,
    /// [`crop`] of this share.
    Crop(f64, Of),
    /// [`fragment::fragment`] of this share of the triangles.
    Fragment(f64),
    /// [`similarity::similarity`].
    Similarity,
    /// [`reorder::reorder`].
    Reorder,
    /// [`spikes::stray_vertices`], this many.
    StrayVertices(u32),
    /// [`spikes::spikes`].
    Spikes {
        /// Number of spikes.
        count: u32,
        /// Height, as a share of the vertex norm.
        height: f64,
    },
    /// [`collude::average`] of this many copies, the marked one among them.
    Collude(u32),
    /// [`re_mark::re_mark`].
    ReMark,
    /// [`round_trip::glb_and_obj`].
    RoundTrip,
    /// [`pipeline::pipeline`] of this number.
    Pipeline(u32),
}

impl Attack {
    /// Applies the attack to `marked`. The same seed gives the same mesh.
    ///
    /// # Errors
    /// [`AttackError`].
    pub fn apply(
        &self,
        marked: &Target<'_>,
        context: &Context<'_>,
        seed: u64,
    ) -> Result<Mesh, AttackError> {
        match *self {
            Self::None => Ok(marked.mesh().clone()),
            Self::Noise(share) => noise::unit_vectors(marked, share, seed),
            Self::UniformNoise(amplitude) => noise::uniform_coordinates(marked, amplitude, seed),
            Self::Smooth { lambda, iterations } => {
                smooth::laplacian(marked, lambda, iterations as usize)
            }
            Self::Taubin(iterations) => smooth::taubin(marked, smooth::TAUBIN, iterations as usize),
            Self::Cotangent { lambda, iterations } => {
                cotangent::cotangent(marked, lambda, iterations as usize)
            }
            Self::Quantise(bits) => quantise::quantise(marked.mesh(), bits),
            Self::Simplify(share) => simplify::simplify(marked, share),
            Self::Remesh(share) => remesh(marked, &Remeshing::to_share(share)),
            Self::Voxel(share) => voxel::voxel(marked, share, seed),
            Self::Scan(noise) => scan(marked, &Scanning::with_noise(noise), seed),
            Self::Midpoint => subdivide::midpoint(marked),
            Self::Butterfly => subdivide::butterfly(marked),
            Self::Loop => subdivide::loop_scheme(marked),
            Self::Sqrt3 => subdivide::sqrt3(marked),
            Self::Crop(share, of) => crop(marked, share, of, seed),
            Self::Fragment(share) => fragment::fragment(marked, share, seed),
            Self::Similarity => similarity::similarity(marked, seed),
            Self::Reorder => reorder::reorder(marked.mesh(), seed),
            Self::StrayVertices(count) => spikes::stray_vertices(marked, count as usize, seed),
            Self::Spikes { count, height } => spikes::spikes(marked, count as usize, height, seed),
            Self::Collude(copies) => averaged(marked.mesh(), context, copies, seed),
            Self::ReMark => re_mark::re_mark(marked.mesh(), context.params, seed),
            Self::RoundTrip => round_trip::glb_and_obj(marked.mesh()),
            Self::Pipeline(number) => pipeline::pipeline(marked, context, number, seed),
        }
    }

    /// The family's name, as it stands in rows.
    #[must_use]
    pub fn family(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Noise(_) => "noise",
            Self::UniformNoise(_) => "uniform-noise",
            Self::Smooth { .. } => "smoothing",
            Self::Taubin(_) => "taubin-smoothing",
            Self::Cotangent { .. } => "cotangent-smoothing",
            Self::Quantise(_) => "quantisation",
            Self::Simplify(_) => "simplification",
            Self::Remesh(_) => "remeshing",
            Self::Voxel(_) => "voxel",
            Self::Scan(_) => "scan",
            Self::Midpoint => "midpoint",
            Self::Butterfly => "butterfly",
            Self::Loop => "loop",
            Self::Sqrt3 => "sqrt3",
            Self::Crop(_, Of::Vertices) => "cropping",
            Self::Crop(_, Of::Area) => "area-cropping",
            Self::Fragment(_) => "fragment",
            Self::Similarity => "similarity",
            Self::Reorder => "reordering",
            Self::StrayVertices(_) => "stray-vertices",
            Self::Spikes { .. } => "spikes",
            Self::Collude(_) => "collusion",
            Self::ReMark => "re-marking",
            Self::RoundTrip => "round-trip",
            Self::Pipeline(_) => "pipeline",
        }
    }

    /// The amount of the attack: percent for shares, else a count. `None` for attacks without an
    /// amount.
    #[must_use]
    pub fn amount(&self) -> Option<f64> {
        match *self {
            Self::Noise(share)
            | Self::UniformNoise(share)
            | Self::Simplify(share)
            | Self::Remesh(share)
            | Self::Voxel(share)
            | Self::Scan(share)
            | Self::Fragment(share)
            | Self::Crop(share, _) => Some(percent(share)),
            Self::Smooth { iterations: count, .. }
            | Self::Taubin(count)
            | Self::Cotangent { iterations: count, .. }
            | Self::Quantise(count)
            | Self::StrayVertices(count)
            | Self::Spikes { count, .. }
            | Self::Collude(count) => Some(f64::from(count)),
            _ => None,
        }
    }
}

/// A share in percent, rounded to six decimals, so that binary rounding does not show.
fn percent(share: f64) -> f64 {
    (share * 1e8).round() / 1e6
}

/// The mean of the marked copy and of other copies of the same host under other keys.
fn averaged(
    marked: &Mesh,
    context: &Context<'_>,
    copies: u32,
    seed: u64,
) -> Result<Mesh, AttackError> {
    let mut random = Random::new(seed);
    let mut others = Vec::new();
    for _ in 1..copies {
        let (key, message) = re_mark::key_and_message(context.params, &mut random)?;
        let raised = context.amplitude.and_then(|amplitude| raised(context.host, &key, amplitude));
        let host = raised.as_ref().unwrap_or(context.host);
        let embedding = re_mark::mark(host, &Codeword::new(&key, &message), context.params)?;
        others.push(Mesh::new(embedding.positions, host.triangles().to_vec())?);
    }
    let all: Vec<&Mesh> = std::iter::once(marked).chain(&others).collect();
    collude::average(&all)
}

/// A host with the relief of a key; `None` if the host has no room for a relief.
fn raised(host: &Mesh, key: &MarkKey, amplitude: Amplitude) -> Option<Mesh> {
    let surface = Surface::new(host);
    let field = Field::new(&surface)?;
    let signs = Signs::new(key, field.signs());
    let carriers = field.marked(&surface, &signs, amplitude.get(), &[]);
    let at = |&carrier: &u32| carriers.get(usize::try_from(carrier).ok()?).copied();
    let positions: Option<Vec<DVec3>> = surface.carrier_of.iter().map(at).collect();
    Mesh::new(positions?, host.triangles().to_vec()).ok()
}

impl fmt::Display for Attack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::None => f.write_str("no attack"),
            Self::Noise(share) => write!(f, "noise {} %", percent(share)),
            Self::UniformNoise(share) => write!(f, "uniform noise {} %", percent(share)),
            Self::Smooth { lambda, iterations } => write!(f, "smoothing {lambda} x {iterations}"),
            Self::Taubin(iterations) => {
                let [lambda, mu] = smooth::TAUBIN;
                write!(f, "Taubin smoothing {lambda}, {mu} x {iterations}")
            }
            Self::Cotangent { lambda, iterations } => {
                write!(f, "cotangent smoothing {lambda} x {iterations}")
            }
            Self::Quantise(bits) => write!(f, "quantised to {bits} bits"),
            Self::Simplify(share) => write!(f, "simplified by {} %", percent(share)),
            Self::Remesh(share) => write!(f, "remeshed to {} %", percent(share)),
            Self::Voxel(share) => {
                write!(f, "extracted anew, cells of {} % of the diagonal", percent(share))
            }
            Self::Scan(noise) => {
                write!(f, "made anew from points with noise {} % of the diagonal", percent(noise))
            }
            Self::Midpoint => f.write_str("subdivided, midpoint"),
            Self::Butterfly => f.write_str("subdivided, butterfly"),
            Self::Loop => f.write_str("subdivided, Loop"),
            Self::Sqrt3 => f.write_str("subdivided, sqrt3"),
            Self::Crop(share, Of::Vertices) => write!(f, "cropped by {} %", percent(share)),
            Self::Crop(share, Of::Area) => write!(f, "cropped by {} % of the area", percent(share)),
            Self::Fragment(share) => write!(f, "fragment of {} %", percent(share)),
            Self::Similarity => f.write_str("moved, turned, scaled"),
            Self::Reorder => f.write_str("reordered"),
            Self::StrayVertices(count) => write!(f, "{count} stray vertices"),
            Self::Spikes { count: 1, height } => write!(f, "1 spike of {} %", percent(height)),
            Self::Spikes { count, height } => write!(f, "{count} spikes of {} %", percent(height)),
            Self::Collude(copies) => write!(f, "mean of {copies} copies"),
            Self::ReMark => f.write_str("marked again"),
            Self::RoundTrip => f.write_str("GLB and OBJ round trip"),
            Self::Pipeline(number) => {
                let [a, b, c] = pipeline::steps(number);
                write!(f, "pipeline {number}: {a}, {b}, {c}")
            }
        }
    }
}
