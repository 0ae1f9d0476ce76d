//! quadmark marks 3D meshes with their owner's invisible, blind, robust watermark and later
//! proves from a suspect file whose mark it carries.
//!
//! The following example makes a mesh, marks it, adds noise to it, and reads the mark without the
//! original:
//!
//! ```
//! use quadmark::formats::{Asset, Limits};
//! use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
//! use quadmark::mesh::Mesh;
//! use quadmark::sample::{Sample, to_obj};
//! use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message, extract};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let host = to_obj(&Sample::Blob.mesh(20_000)?);
//! let key = MarkKey::from_bytes([42; 32]); // in practice: random, and kept
//! let bits = BitCount::new(64)?;
//! let message = Message::from_hex("0123456789abcdef", bits)?;
//! let params = EmbedParams { bits, ..EmbedParams::default() };
//! let marked = mark(
//!     &host,
//!     &MarkRequest {
//!         key: &key,
//!         others: &[],
//!         message: &message,
//!         params,
//!         limits: Limits::default(),
//!         stop: &|| false,
//!         layers: Layers::Blind,
//!         amplitude: Amplitude::default(),
//!         independent_check_max_bytes: 16 << 20,
//!     },
//! )?;
//!
//! // Noise of a ten-thousandth of the object's size, at every vertex.
//! let suspect = Asset::read(&marked.bytes, &Limits::default())?.into_mesh();
//! let noisy = suspect.positions().iter().enumerate().map(|(i, p)| {
//!     let i = i as f64;
//!     p + 1e-4 * glam::DVec3::new((i * 12.9).sin(), (i * 78.2).sin(), (i * 37.7).sin())
//! });
//! let noisy = Mesh::new(noisy.collect(), suspect.triangles().to_vec())?;
//!
//! // The reader has the key; it needs neither the host nor the message.
//! let found = extract(&noisy, &key, bits, params.method.modulation())?;
//! assert_eq!(found.message().map(|m| m.to_hex()).as_deref(), Some("0123456789abcdef"));
//! # Ok(())
//! # }
//! ```
//!
//! Modules in reading order. Imports run downward only, which `tests/architecture.rs` checks:
//!
//! - [`mesh`]: positions and triangles, welding, centre, quadrics, distortion. Pure.
//! - [`watermark`]: keys to codewords, bins, modulation, placement, the closed loop, extraction
//!   and detection. Pure, deterministic to the bit on any number of threads.
//! - [`relief`]: the layer of a mark that is a field along the surface's normals, read against the
//!   host. Pure.
//! - [`registration`]: brings a suspect into its host's coordinates, and says which hosts to try.
//!   Pure.
//! - [`recognition`]: reads a suspect as if it were one host or a part of it. Pure.
//! - [`formats`]: bytes to mesh, and new positions to patched bytes.
//! - [`marking`]: the layers and the formats together, from bytes to checked bytes.
//! - [`sample`]: generated meshes for documentation and tests.
//! - [`config`], [`keys`], [`registry`], [`blobs`], [`jobs`]: settings, master keys, records,
//!   files, the worker pool; [`durable`]: directories and files that survive a power cut.
//! - [`attacks`]: what may happen to a marked mesh; [`forecast`]: what a mark will survive.
//! - [`lab`]: what a mark costs and survives: experiments and reports.
//! - [`service`]: the use cases; [`http`]: the same over HTTP.

pub mod attacks;
pub mod blobs;
pub mod config;
pub mod durable;
pub mod forecast;
pub mod formats;
pub mod http;
pub mod jobs;
pub mod keys;
pub mod lab;
pub mod marking;
pub mod mesh;
pub mod recognition;
pub mod registration;
pub mod registry;
pub mod relief;
pub mod sample;
pub mod service;
pub mod watermark;
