//! A surface made ready for registration, as host or as suspect.

use glam::{DQuat, DVec3};

use super::similarity::Similarity;
use crate::mesh::stop::{STEP, Stop, changed, go_on, never, sorted};
use crate::mesh::surface::{Surface, doubled_area};
use crate::registration::by_vertices::one_rings::Rings;
use crate::registration::by_vertices::signatures::{
    Sense, Signature, connectivity_until, metric_until,
};

/// Rings that a connectivity signature covers. With one more, a fragment loses the signatures of
/// more of its vertices, those near its border. With one less, too few signatures occur once.
const RADIUS: usize = 2;

/// What a signature is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Valences.
    Connectivity,
    /// Edge lengths.
    Metric,
}

/// A vertex whose signature occurs once in its mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Landmark {
    /// The signature.
    pub code: Signature,
    /// The vertex.
    pub vertex: u32,
}

/// A surface in unit coordinates: its bounding box is centred at the origin, and its diagonal is 1.
#[derive(Debug, Clone)]
pub struct Shape {
    /// Carrier vertices, in unit coordinates.
    pub positions: Vec<DVec3>,
    /// Triangles, as indices into `positions`.
    pub triangles: Vec<[u32; 3]>,
    /// Per carrier vertex, the first vertex of the file that stands for it.
    pub first_vertex: Vec<u32>,
    /// Per carrier vertex, the unit normal: the area-weighted mean over its triangles, or zero
    /// where these cancel out.
    pub normals: Vec<DVec3>,
    /// The one-rings of the carrier vertices.
    pub rings: Rings,
    /// From the file's coordinates to unit coordinates.
    pub unit: Similarity,
}

impl Shape {
    /// Brings a surface to unit coordinates. `None` if it has no triangle with area, more than a
    /// third of 2^32 triangles, or coordinates so large or so small that they cannot be brought to
    /// unit size.
    #[must_use]
    pub fn new(surface: Surface) -> Option<Self> {
        Self::new_until(surface, &never)
    }

    /// Like [`Self::new`]; also `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(surface: Surface, stop: Stop<'_>) -> Option<Self> {
        u32::try_from(surface.triangles.len().checked_mul(3)?).ok()?;
        let Surface { mut positions, triangles, first_vertex, .. } = surface;
        let (mut low, mut high) = (*positions.first()?, *positions.first()?);
        for &p in &positions {
            (low, high) = (low.min(p), high.max(p));
        }
        let scale = (high - low).length().recip();
        let middle = low + 0.5 * (high - low);
        let unit = Similarity { scale, rotation: DQuat::IDENTITY, translation: -middle * scale };
        if !unit.is_valid() || triangles.is_empty() {
            return None;
        }
        changed(&mut positions, stop, |_, p| *p = (*p - middle) * scale)?;
        let rings = Rings::new_until(positions.len(), &triangles, stop)?;
        let normals = normals(&positions, &triangles, stop)?;
        Some(Self { positions, triangles, first_vertex, normals, rings, unit })
    }

    /// The signatures of all carrier vertices; `None` once `stop` returns `true`.
    fn codes(&self, kind: Kind, sense: Sense, stop: Stop<'_>) -> Option<Vec<Signature>> {
        match kind {
            Kind::Connectivity => connectivity_until(&self.rings, sense, RADIUS, stop),
            Kind::Metric => metric_until(&self.rings, &self.positions, sense, stop),
        }
    }

    /// The vertices whose signatures occur once, by ascending hash; `None` once `stop` returns
    /// `true`.
    #[must_use]
    pub fn landmarks(&self, kind: Kind, sense: Sense, stop: Stop<'_>) -> Option<Vec<Landmark>> {
        let all: Vec<Landmark> = (0..)
            .zip(self.codes(kind, sense, stop)?)
            .filter(|(_, code)| code.hash != 0)
            .map(|(vertex, code)| Landmark { code, vertex })
            .collect();
        let key = |l: &Landmark| (l.code.hash, l.vertex);
        let all = sorted(all, stop, |a, b| key(a).cmp(&key(b)))?;
        let alone = all.chunk_by(|a, b| a.code.hash == b.code.hash).filter(|same| same.len() == 1);
        Some(alone.flatten().copied().collect())
    }
}

fn normals(positions: &[DVec3], triangles: &[[u32; 3]], stop: Stop<'_>) -> Option<Vec<DVec3>> {
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for step in triangles.chunks(STEP) {
        go_on(stop)?;
        for t in step {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            let area = doubled_area(a, b, c);
            for &v in t {
                normals[v as usize] += area;
            }
        }
    }
    changed(&mut normals, stop, |_, normal| *normal = normal.normalize_or_zero())?;
    Some(normals)
}
