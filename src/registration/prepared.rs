//! Hosts and suspects made ready for registration, and the alignment that comes of it.

use std::sync::OnceLock;

use super::shape::Shape;
use super::similarity::Similarity;
use crate::mesh::stop::{Stop, go_on, once, unstopped};
use crate::registration::by_surface::icp::IcpTarget;
use crate::registration::by_surface::partial::{HostSpinImages, SuspectSpinImages};
use crate::registration::by_surface::samples::{Point, scatter_until};
use crate::registration::by_surface::surfels::Surfels;
use crate::registration::by_surface::symmetry::symmetries;
use crate::registration::by_vertices::vertices::{Findable, Landmarks};

/// Points by which a surface is aligned before it is known to fit.
const ALIGNED: usize = 3000;

/// Points that describe a surface, so that parts are recognised.
const DESCRIBED: usize = 6000;

/// How much work a registration may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effort {
    /// By shared vertices and by the surface: whole suspects, and parts as far as the budget
    /// allows.
    Whole,
    /// Also mirrored whole suspects, with ten times the budget: takes seconds.
    Thorough,
}

/// What an alignment rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// The suspect's own coordinates: they are still the host's.
    InPlace,
    /// Vertices that suspect and host share.
    Vertices,
    /// The surface alone.
    Surface,
}

/// A suspect in its host's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// From the suspect file's coordinates to the host file's.
    pub similarity: Similarity,
    /// What the alignment rests on.
    pub basis: Basis,
    /// Share of the suspect that lies on the host, from 0 to 1: the paired share of its carrier
    /// vertices, or a share of its area.
    pub overlap: f64,
    /// Root mean square distance over that share, relative to the host's diagonal.
    pub rms: f64,
    /// Pairs of a carrier vertex of the suspect and one of the host that are the same vertex,
    /// ascending by the suspect's. Where the basis is the surface, they are only nearest to each
    /// other. Then the list is empty if fewer than half of the vertices of the smaller mesh are
    /// paired.
    pub pairs: Vec<[u32; 2]>,
}

/// A host made ready for registration. Keep it while several suspects are compared with it.
pub struct PreparedHost {
    pub(super) shape: Shape,
    pub(super) landmarks: Landmarks,
    pub(super) points: Vec<Point>,
    /// This field and those below are built when first needed. An alignment by vertices needs none
    /// of them, and a suspect that fits nowhere needs no `target`.
    surfels: OnceLock<Surfels>,
    target: OnceLock<Option<IcpTarget>>,
    places: OnceLock<HostSpinImages>,
    symmetries: OnceLock<Vec<Similarity>>,
}

/// A suspect made ready for registration.
pub struct PreparedSuspect {
    pub(super) shape: Shape,
    pub(super) landmarks: Findable,
    pub(super) points: Vec<Point>,
    places: OnceLock<SuspectSpinImages>,
}

impl PreparedHost {
    /// Makes a shape ready.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(shape: Shape, stop: Stop<'_>) -> Option<Self> {
        let landmarks = Landmarks::new(&shape, stop)?;
        let points = scatter_until(&shape, ALIGNED, stop)?;
        let (surfels, target, places) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        let symmetries = OnceLock::new();
        Some(Self { shape, landmarks, points, surfels, target, places, symmetries })
    }

    /// The prepared shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// `None` once `stop` returns `true`.
    pub(super) fn surfels(&self, stop: Stop<'_>) -> Option<&Surfels> {
        once(&self.surfels, || Surfels::new(&self.shape, stop))
    }

    /// `None` once `stop` returns `true`.
    pub(super) fn places(&self, stop: Stop<'_>) -> Option<&HostSpinImages> {
        once(&self.places, || {
            HostSpinImages::new(&scatter_until(&self.shape, DESCRIBED, stop)?, stop)
        })
    }

    /// The rotations other than the identity that map the host onto itself, in the coordinates of
    /// its file; `None` once `stop` returns `true`.
    pub fn symmetries(&self, stop: Stop<'_>) -> Option<&[Similarity]> {
        let make = || {
            let found = symmetries(self, stop)?;
            let unit = &self.shape.unit;
            Some(found.iter().map(|s| unit.then(s).then(&unit.inverse())).collect())
        };
        once(&self.symmetries, make).map(Vec::as_slice)
    }

    /// `None` where the surface cannot be searched, and once `stop` returns `true`.
    pub(super) fn target(&self, stop: Stop<'_>) -> Option<&IcpTarget> {
        let make = || {
            let target = IcpTarget::new(&self.shape, stop);
            go_on(stop).map(|()| target)
        };
        once(&self.target, make)?.as_ref()
    }
}

impl PreparedSuspect {
    /// Makes a shape ready.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(shape: Shape, stop: Stop<'_>) -> Option<Self> {
        let points = scatter_until(&shape, ALIGNED, stop)?;
        let places = OnceLock::new();
        Some(Self { shape, landmarks: Findable::default(), points, places })
    }

    /// The prepared shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// `None` once `stop` returns `true`.
    pub(super) fn places(&self, stop: Stop<'_>) -> Option<&SuspectSpinImages> {
        once(&self.places, || {
            SuspectSpinImages::new(&scatter_until(&self.shape, DESCRIBED, stop)?, stop)
        })
    }

    /// About `count` of the suspect's points, spread over the whole surface.
    pub(super) fn some(&self, count: usize) -> Vec<Point> {
        self.points.iter().step_by((self.points.len() / count).max(1)).copied().collect()
    }
}
