//! Marks as the benchmarks of several marks on one mesh make and read them.

use quadmark::formats::{Asset, Limits};
use quadmark::marking::{MarkError, MarkRequest, Marked, mark};
use quadmark::mesh::Mesh;
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{
    BitCount, Codeword, EmbedParams, Frame, HostFilter, MarkKey, Message, Method, Sighting,
    SoftBits, Suspect,
};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::Rng;

/// `match` is below this.
pub const THRESHOLD: f64 = -9.0;
/// What a bound is multiplied by, as log10: 100,000 records, in a stage with an eighth of the error
/// probability.
pub const COUNTED: f64 = 5.0 + 0.903_09;

/// A marked file, and what is needed to recognise it.
#[allow(dead_code)] // not every benchmark reads everything
pub struct Copy {
    pub bytes: Vec<u8>,
    pub mesh: Mesh,
    pub host_frame: Frame,
    pub codeword: Codeword,
    pub params: EmbedParams,
}

/// So many bits, a multiple of eight.
pub fn bits(word: &str) -> BitCount {
    BitCount::new(word.parse().unwrap()).unwrap()
}

/// How to mark by this method with so many bits.
pub fn params(method: Method, bits: BitCount) -> EmbedParams {
    EmbedParams { method, bits, ..EmbedParams::default() }
}

/// The file marked with a new key and message.
pub fn marked(
    host: &[u8],
    params: EmbedParams,
    random: &mut ChaCha20Rng,
) -> Result<Copy, MarkError> {
    let mut key = [0; 32];
    let mut message = vec![0; params.bits.get() / 8];
    random.fill_bytes(&mut key);
    random.fill_bytes(&mut message);
    let key = MarkKey::from_bytes(key);
    let message = Message::from_bytes(&message, params.bits).unwrap();
    let request = MarkRequest {
        key: &key,
        message: &message,
        params,
        limits: Limits::default(),
        stop: &|| false,
        independent_check_max_bytes: 0,
    };
    let Marked { bytes, host_frame, .. } = mark(host, &request)?;
    let mesh = parsed(&bytes);
    Ok(Copy { bytes, mesh, host_frame, codeword: Codeword::new(&key, &message), params })
}

pub fn parsed(file: &[u8]) -> Mesh {
    Asset::read(file, &Limits::default()).unwrap().into_mesh()
}

/// Files by name; without any, one of each generated mesh.
pub fn hosts(files: Vec<String>) -> Vec<(String, Vec<u8>)> {
    if files.is_empty() {
        let of = |sample: Sample| (sample.to_string(), to_obj(&sample.mesh(40_000).unwrap()));
        return Sample::ALL.into_iter().map(of).collect();
    }
    let read = |name: String| {
        let bytes = std::fs::read(&name).unwrap();
        (name, bytes)
    };
    files.into_iter().map(read).collect()
}

/// log10 of the bound that a copy's mark is found by, all counted.
pub fn bound(soft: &SoftBits, copy: &Copy) -> f64 {
    soft.log10_bound(soft.score(&copy.codeword).t) + COUNTED
}

/// A copy's mark in a suspect: in the blind frame, in the host's own, by the matched filter with all
/// carriers of the host.
pub fn bounds(suspect: &Mesh, copy: &Copy, host: &Mesh) -> [f64; 3] {
    let read = Suspect::new(suspect).unwrap();
    let (class, bits) = (copy.codeword.lattice_class(), copy.params.bits);
    let modulation = copy.params.method.modulation();
    let blind = read.read(class, bits, modulation);
    let known = read.read_in(&copy.host_frame, class, bits, modulation);
    let filter = HostFilter::new(host, class, &copy.params).unwrap();
    let at = |vertex: u32| suspect.positions()[vertex as usize];
    let carriers = (0..).zip(&filter.surface().first_vertex);
    let sightings: Vec<Sighting> =
        carriers.map(|(carrier, &vertex)| Sighting { carrier, at: at(vertex) }).collect();
    let (matched, _) = filter.read(&sightings);
    [blind, known, matched].map(|soft| bound(&soft, copy))
}
