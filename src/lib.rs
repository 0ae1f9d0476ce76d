//! quadmark marks 3D meshes with their owner's invisible, blind, robust watermark and later
//! proves from a suspect file whose mark it carries.
//!
//! Modules in reading order; imports run downward only (`tests/architecture.rs` holds the line):
//!
//! - [`mesh`]: positions and triangles, welding, centre, quadrics, distortion. Pure.
//! - [`watermark`]: keys to codewords, bins, modulation, placement, the closed loop, extraction
//!   and detection. Pure, deterministic to the bit on any number of threads.
//! - [`formats`]: bytes to carrier mesh, new positions to patched bytes.
//! - [`marking`]: the two together, bytes to checked bytes.
//! - [`sample`]: meshes made from nothing, for documentation and tests.
//! - [`config`], [`keys`], [`registry`], [`blobs`], [`jobs`]: settings, master keys, records,
//!   files, the worker pool.
//! - [`service`]: the use cases; [`http`]: the same over HTTP.

pub mod blobs;
pub mod config;
pub mod formats;
pub mod http;
pub mod jobs;
pub mod keys;
pub mod marking;
pub mod mesh;
pub mod registry;
pub mod sample;
pub mod service;
pub mod watermark;
