//! The sketch of a shape: what is stored to find the shape again, whole or in part, among many.
//!
//! Parts: each vertex has a hash of the connectivity three rings around it, or of edge lengths
//! where connectivity says too little. The smallest hashes of a mesh are a fair sample of its
//! vertices (bottom-k sketches; Cohen and Kaplan 2007). A fragment with a share s of the mesh has
//! about the same share s of these vertices, and finds the record by them. Wholes: the
//! [`ShapeDescriptor`].

use super::descriptor::{BYTES, ShapeDescriptor};
use crate::mesh::stop::{Stop, go_on, sorted, unstopped};
use crate::registration::by_vertices::signatures::{
    Sense, Signature, connectivity_until, metric_until, mix,
};
use crate::registration::shape::Shape;

/// Rings that a hash covers: 37 vertices. Two rings distinguish the vertices of one mesh, but among
/// a hundred thousand meshes they are too common.
const RADIUS: usize = 3;

/// Hashes per sketch. A fragment of 5 % has 9.6 of them on average, less those within three rings
/// of its border. Among 100,000 records, such fragments of real meshes of 10,000 vertices and more
/// find their record. Fragments of smaller meshes have 100 to 300 vertices, of which the border
/// leaves a few: half of them find their record (`benches/shortlist.rs`).
pub const HASHES: usize = 192;

/// Most hashes of either kind that are looked up for a suspect. A fragment needs at most
/// [`HASHES`]; the rest are for an object within a scene of a hundred times its size.
pub const PROBES: usize = 16_384;

/// How often a hash may occur within its mesh. A more frequent one says little about any vertex.
const MOST_ALIKE: usize = 2;

/// Least share of vertices with a rare connectivity hash. Below it, at least half of the sketch
/// consists of hashes of lengths.
const TELLING: f64 = 0.25;

const VERSION: u8 = 1;

/// The sketch of a record's mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sketch {
    hashes: Vec<u64>,
    outline: ShapeDescriptor,
}

/// What is looked up for a suspect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Probe {
    /// Hashes of its vertices, smallest first.
    pub hashes: Vec<u64>,
    /// Its descriptor.
    pub outline: ShapeDescriptor,
}

/// Why bytes are not a sketch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SketchError {
    /// A version that this release does not know.
    #[error("sketch of an unknown version {0}")]
    UnknownVersion(u8),
    /// Cut off, too long, or not in order.
    #[error("damaged sketch")]
    Damaged,
}

impl Sketch {
    /// Sketches a shape. Hashes of lengths find exact copies only, so on grids it matters whether
    /// the host or the marked mesh is sketched; hashes of connectivity are the same for both.
    #[must_use]
    pub fn new(shape: &Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(shape: &Shape, stop: Stop<'_>) -> Option<Self> {
        let telling = rare(connectivity_hashes(shape, stop)?, stop)?;
        let share = telling.len() as f64 / shape.positions.len() as f64;
        let mut hashes: Vec<u64> = if share >= TELLING {
            telling.into_iter().take(HASHES).collect()
        } else {
            let lengths = rare(metric_hashes(shape, stop)?, stop)?;
            let of_lengths = HASHES - telling.len().min(HASHES / 2);
            let lengths = lengths.into_iter().take(of_lengths);
            telling.into_iter().take(HASHES / 2).chain(lengths).collect()
        };
        hashes.sort_unstable();
        hashes.dedup();
        Some(Self { hashes, outline: ShapeDescriptor::new_until(shape, stop)? })
    }

    /// A sketch of given parts, the hashes in any order: for tests and simulations.
    #[must_use]
    pub fn from_parts(mut hashes: Vec<u64>, outline: ShapeDescriptor) -> Self {
        hashes.sort_unstable();
        hashes.dedup();
        hashes.truncate(HASHES);
        Self { hashes, outline }
    }

    /// Its hashes, ascending; at most [`HASHES`].
    #[must_use]
    pub fn hashes(&self) -> &[u64] {
        &self.hashes
    }

    /// Its descriptor.
    #[must_use]
    pub fn outline(&self) -> &ShapeDescriptor {
        &self.outline
    }

    /// As bytes: version, descriptor, hashes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(1 + BYTES + 8 * self.hashes.len());
        bytes.push(VERSION);
        bytes.extend(self.outline.0);
        for hash in &self.hashes {
            bytes.extend(hash.to_le_bytes());
        }
        bytes
    }

    /// Reads what [`Sketch::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`SketchError`] for anything else.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SketchError> {
        let (&version, rest) = bytes.split_first().ok_or(SketchError::Damaged)?;
        if version != VERSION {
            return Err(SketchError::UnknownVersion(version));
        }
        let (outline, rest) = rest.split_first_chunk::<BYTES>().ok_or(SketchError::Damaged)?;
        let (chunks, left) = rest.as_chunks::<8>();
        let hashes: Vec<u64> = chunks.iter().map(|&chunk| u64::from_le_bytes(chunk)).collect();
        let ordered = hashes.is_sorted_by(|a, b| a < b);
        if !left.is_empty() || hashes.len() > HASHES || !ordered {
            return Err(SketchError::Damaged);
        }
        Ok(Self { hashes, outline: ShapeDescriptor(*outline) })
    }
}

impl Probe {
    /// Collects everything to look up for a suspect.
    #[must_use]
    pub fn new(shape: &Shape) -> Self {
        unstopped(|stop| Self::new_until(shape, stop))
    }

    /// Like [`Self::new`]; `None` once `stop` returns `true`.
    #[must_use]
    pub fn new_until(shape: &Shape, stop: Stop<'_>) -> Option<Self> {
        let some = |hashes: Vec<u64>| {
            let mut hashes = sorted(hashes, stop, Ord::cmp)?;
            hashes.dedup();
            hashes.truncate(PROBES);
            Some(hashes)
        };
        let mut hashes = some(connectivity_hashes(shape, stop)?)?;
        hashes.extend(some(metric_hashes(shape, stop)?)?);
        hashes.sort_unstable();
        Some(Self { hashes, outline: ShapeDescriptor::new_until(shape, stop)? })
    }
}

fn connectivity_hashes(shape: &Shape, stop: Stop<'_>) -> Option<Vec<u64>> {
    either(1, stop, |sense| connectivity_until(&shape.rings, sense, RADIUS, stop))
}

fn metric_hashes(shape: &Shape, stop: Stop<'_>) -> Option<Vec<u64>> {
    either(2, stop, |sense| metric_until(&shape.rings, &shape.positions, sense, stop))
}

/// The hashes of all vertices that have one, the same for a mirror image.
fn either(
    kind: u64,
    stop: Stop<'_>,
    codes: impl Fn(Sense) -> Option<Vec<Signature>>,
) -> Option<Vec<u64>> {
    let (along, against) = (codes(Sense::Along)?, codes(Sense::Against)?);
    go_on(stop)?;
    let both = along.into_iter().zip(against).map(|(a, b)| a.hash.min(b.hash));
    Some(both.filter(|&hash| hash != 0).map(|hash| mix(hash, kind)).collect())
}

/// The hashes that few vertices share, ascending, each once.
fn rare(hashes: Vec<u64>, stop: Stop<'_>) -> Option<Vec<u64>> {
    let hashes = sorted(hashes, stop, Ord::cmp)?;
    let groups = hashes.chunk_by(|a, b| a == b).filter(|same| same.len() <= MOST_ALIKE);
    Some(groups.filter_map(|same| same.first().copied()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::stop::never;
    use crate::mesh::surface::Surface;
    use crate::sample::Sample;

    fn sketch() -> Sketch {
        Sketch::new(&Shape::new(Surface::new(&Sample::Blob.mesh(2000).unwrap())).unwrap())
    }

    #[test]
    fn bytes_come_back_and_damaged_ones_are_refused() {
        let sketch = sketch();
        assert_eq!(sketch.hashes().len(), HASHES);
        let bytes = sketch.to_bytes();
        assert_eq!(Sketch::from_bytes(&bytes), Ok(sketch));
        for length in (0..bytes.len()).filter(|n| n % 8 != (1 + BYTES) % 8 || *n < 1 + BYTES) {
            assert_eq!(Sketch::from_bytes(&bytes[..length]), Err(SketchError::Damaged));
        }
        let longer = [bytes.as_slice(), &[255; 8]].concat();
        assert_eq!(Sketch::from_bytes(&longer), Err(SketchError::Damaged));
        let mut unordered = bytes.clone();
        unordered[1 + BYTES..][..8].fill(255);
        assert_eq!(Sketch::from_bytes(&unordered), Err(SketchError::Damaged));
        let mut newer = bytes;
        newer[0] = 2;
        assert_eq!(Sketch::from_bytes(&newer), Err(SketchError::UnknownVersion(2)));
    }

    /// A torus of quads, each cut along one diagonal or the other, with whole coordinates.
    fn torus() -> Shape {
        const N: u32 = 12;
        let at = |i: u32, j: u32| (i % N) * N + j % N;
        let place = |k: u32| [k * k % 7, 3 * (k / N) + k % 5, k % N].map(f64::from);
        let quads = (0..N * N).map(|k| (k, k / N, k % N));
        let triangles = quads.flat_map(|(k, i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            let turned = mix(u64::from(k), 1) & 1 == 1;
            if turned { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] }
        });
        let positions = (0..N * N).map(|k| place(k).into()).collect();
        let mesh = crate::mesh::Mesh::new(positions, triangles.collect()).unwrap();
        Shape::new(Surface::new(&mesh)).unwrap()
    }

    /// Sketches are stored: these values may only change together with [`VERSION`].
    #[test]
    fn hashes_mean_the_same_in_every_release() {
        let sum = |hashes: Vec<u64>| (hashes.len(), hashes.into_iter().fold(0, mix));
        let shape = torus();
        let hashes = [connectivity_hashes(&shape, &never), metric_hashes(&shape, &never)];
        let parts = hashes.map(|h| sum(rare(h.unwrap(), &never).unwrap()));
        assert_eq!(parts, [(137, 13_088_741_176_312_909_374), (112, 10_143_715_808_597_722_768)]);
        let outline = sum(ShapeDescriptor::new(&shape).0.map(u64::from).to_vec());
        assert_eq!(outline, (BYTES, 4_379_294_214_155_037_365));
    }

    #[test]
    fn a_fragment_keeps_its_share_of_the_hashes() {
        let whole = sketch();
        let mut part = Surface::new(&Sample::Blob.mesh(2000).unwrap());
        part.triangles.truncate(part.triangles.len() / 2);
        let probe = Probe::new(&Shape::new(part).unwrap());
        let kept = whole.hashes().iter().filter(|h| probe.hashes.binary_search(h).is_ok()).count();
        assert!(kept > HASHES / 4 && kept < HASHES * 3 / 5, "{kept} of {HASHES}");
    }
}
