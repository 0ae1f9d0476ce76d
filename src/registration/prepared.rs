//! Hosts and suspects made ready for each other, and what comes of it.

use std::sync::OnceLock;

use super::shape::Shape;
use super::similarity::Similarity;
use crate::mesh::stop::{Stop, go_on, once, unstopped};
use crate::registration::by_surface::icp::IcpTarget;
use crate::registration::by_surface::partial::{HostPlaces, SuspectPlaces};
use crate::registration::by_surface::samples::{Point, scatter_until};
use crate::registration::by_surface::surfels::Discs;
use crate::registration::by_surface::symmetry::symmetries;
use crate::registration::by_vertices::vertices::{Findable, Landmarks};

/// Points that a surface is aligned by before it is known to fit.
const ALIGNED: usize = 3000;

/// Points by which parts are recognised.
const DESCRIBED: usize = 6000;

/// How hard to try.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effort {
    /// Shared vertices, and what was tessellated anew: wholes, and parts as far as the budget goes.
    Whole,
    /// Also mirrored wholes, and ten times the budget: seconds.
    Thorough,
}

/// What an alignment rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// The file's own coordinates, which were kept.
    InPlace,
    /// Vertices that suspect and host share.
    Vertices,
    /// The surface.
    Surface,
}

/// A suspect in its host's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// From the suspect file's coordinates to the host file's.
    pub similarity: Similarity,
    /// What it rests on.
    pub basis: Basis,
    /// Share of the suspect that lies on the host: of its carriers that are paired, or of its area.
    pub overlap: f64,
    /// Root mean square distance over that share, relative to the host's diagonal.
    pub rms: f64,
    /// Carriers of the suspect and of the host that are one vertex, ascending by the first. Where
    /// the basis is the surface they are nearest to each other and no more; none where most of the
    /// one that has fewer have no such partner.
    pub pairs: Vec<[u32; 2]>,
}

/// A host made ready; worth keeping while several suspects are compared with it.
pub struct PreparedHost {
    pub(super) shape: Shape,
    pub(super) landmarks: Landmarks,
    pub(super) points: Vec<Point>,
    /// Built when first asked for: vertex correspondences do without, and what fits nowhere without the latter.
    discs: OnceLock<Discs>,
    target: OnceLock<Option<IcpTarget>>,
    places: OnceLock<HostPlaces>,
    symmetries: OnceLock<Vec<Similarity>>,
}

/// A suspect made ready.
pub struct PreparedSuspect {
    pub(super) shape: Shape,
    pub(super) landmarks: Findable,
    pub(super) points: Vec<Point>,
    places: OnceLock<SuspectPlaces>,
}

impl PreparedHost {
    /// Takes a shape over.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// The same; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(shape: Shape, stop: Stop<'_>) -> Option<Self> {
        let landmarks = Landmarks::new(&shape, stop)?;
        let points = scatter_until(&shape, ALIGNED, stop)?;
        let (discs, target, places) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        let symmetries = OnceLock::new();
        Some(Self { shape, landmarks, points, discs, target, places, symmetries })
    }

    /// Its shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// `None` once `stop` answers `true`.
    pub(super) fn discs(&self, stop: Stop<'_>) -> Option<&Discs> {
        once(&self.discs, || Discs::new(&self.shape, stop))
    }

    /// `None` once `stop` answers `true`.
    pub(super) fn places(&self, stop: Stop<'_>) -> Option<&HostPlaces> {
        once(&self.places, || HostPlaces::new(&scatter_until(&self.shape, DESCRIBED, stop)?, stop))
    }

    /// The turns that bring it onto itself, but for the identity, in its own coordinates; `None` once
    /// `stop` answers `true`.
    pub fn symmetries(&self, stop: Stop<'_>) -> Option<&[Similarity]> {
        let make = || {
            let found = symmetries(self, stop)?;
            let unit = &self.shape.unit;
            Some(found.iter().map(|s| unit.then(s).then(&unit.inverse())).collect())
        };
        once(&self.symmetries, make).map(Vec::as_slice)
    }

    /// Also `None` once `stop` answers `true`.
    pub(super) fn target(&self, stop: Stop<'_>) -> Option<&IcpTarget> {
        let make = || {
            let target = IcpTarget::new(&self.shape, stop);
            go_on(stop).map(|()| target)
        };
        once(&self.target, make)?.as_ref()
    }
}

impl PreparedSuspect {
    /// Takes a shape over.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// The same; `None` once `stop` answers `true`.
    #[must_use]
    pub fn new_until(shape: Shape, stop: Stop<'_>) -> Option<Self> {
        let points = scatter_until(&shape, ALIGNED, stop)?;
        let places = OnceLock::new();
        Some(Self { shape, landmarks: Findable::default(), points, places })
    }

    /// Its shape.
    #[must_use]
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// `None` once `stop` answers `true`.
    pub(super) fn places(&self, stop: Stop<'_>) -> Option<&SuspectPlaces> {
        once(&self.places, || {
            SuspectPlaces::new(&scatter_until(&self.shape, DESCRIBED, stop)?, stop)
        })
    }

    /// About so many of its points, spread over all of it.
    pub(super) fn some(&self, count: usize) -> Vec<Point> {
        self.points.iter().step_by((self.points.len() / count).max(1)).copied().collect()
    }
}
