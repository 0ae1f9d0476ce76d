//! The lab: what a mark costs and what it survives, on anyone's mesh.
//!
//! Stands beside the service and sees only files, geometry and the method. The attacks are pure:
//! a mesh, parameters and a seed in, a mesh out.

pub mod attacks;
pub mod random;
