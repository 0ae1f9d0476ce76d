//! The time of marking and reading, with tobj's load of the same bytes as the yardstick.
//!
//! ```text
//! cargo bench --bench marking
//! ```
//!
//! The file is `obj/paper/dragon.obj` of the test meshes (`$QUADMARK_MESHES`, else
//! `../shared/meshes`) if it exists, else a generated mesh of its size. The goals: `embed` at most
//! 4 times the yardstick, `extract` at most 1. Ratios of medians are printed at the end; nothing is
//! asserted.
#![expect(clippy::unwrap_used, reason = "a benchmark may stop")]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use criterion::Criterion;
use quadmark::formats::{Agreement, Format, Limits, agrees};
use quadmark::marking::{
    Amplitude, Layers, MarkRequest, MaxDistortion, extract_file, mark, mark_within,
};
use quadmark::sample::{Sample, to_obj};
use quadmark::watermark::{BitCount, EmbedParams, MarkKey, Message, Method, Modulation, Strength};

/// The dragon's bytes, or a mesh of about its size.
fn host() -> (String, Vec<u8>) {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes");
    let meshes = std::env::var_os("QUADMARK_MESHES").map_or_else(beside, PathBuf::from);
    match std::fs::read(meshes.join("obj/paper/dragon.obj")) {
        Ok(bytes) => ("dragon.obj".into(), bytes),
        Err(_) => ("a generated blob".into(), to_obj(&Sample::Blob.mesh(400_000).unwrap())),
    }
}

fn tobj_load(bytes: &[u8]) -> usize {
    let options = tobj::LoadOptions { triangulate: true, ..tobj::LoadOptions::default() };
    let mut reader = bytes;
    let (models, _) =
        tobj::load_obj_buf(&mut reader, &options, |_| Err(tobj::LoadError::OpenFileFailed))
            .unwrap();
    models.iter().map(|model| model.mesh.positions.len()).sum()
}

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(10)
        .measurement_time(Duration::from_secs(10))
        .configure_from_args();
    let (name, host) = host();
    println!("{name}, {} bytes, on {} threads", host.len(), rayon::current_num_threads());
    let key = MarkKey::from_bytes([7; 32]);
    let bits = BitCount::default();
    let message = Message::from_bytes(&[0xa5, 0x5a, 0xc3, 0x3c, 0x0f, 0xf0, 0x69, 0x96], bits);
    let message = message.unwrap();
    let request = |method| MarkRequest {
        key: &key,
        others: &[],
        message: &message,
        params: EmbedParams { method, ..EmbedParams::default() },
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        // As in the service by default: larger files are not opened by another reader.
        independent_check_max_bytes: 16 << 20,
    };
    let marked = mark(&host, &request(Method::QspMean)).unwrap();
    println!("{:?}", marked.report);
    let limits = Limits::default();
    let extract = |bytes: &[u8]| extract_file(bytes, &key, bits, Modulation::Mean, &limits);
    let independent = || agrees(Format::Obj, &host, &marked.bytes);
    assert_eq!(independent(), Agreement::Same);

    let mut medians = Vec::new();
    let mut measure = |name: &str, work: &dyn Fn()| {
        // Criterion does not give its figures away, so they are also taken here.
        let mut times = Vec::new();
        criterion.bench_function(name, |bencher| {
            bencher.iter_custom(|rounds| {
                let start = Instant::now();
                (0..rounds).for_each(|_| work());
                let time = start.elapsed();
                times.push(time.as_secs_f64() / rounds as f64);
                time
            });
        });
        times.sort_by(f64::total_cmp);
        if let Some(&median) = times.get(times.len() / 2) {
            medians.push((name.to_owned(), median));
        }
    };
    measure("tobj load", &|| {
        black_box(tobj_load(&host));
    });
    for method in Method::ALL {
        measure(&format!("embed {method}"), &|| drop(black_box(mark(&host, &request(method)))));
    }
    let both = || {
        let request = MarkRequest { layers: Layers::Both, ..request(Method::default()) };
        let (limit, most) = (MaxDistortion::USUAL, Strength::BESIDE_A_RELIEF);
        let params = EmbedParams { strength: most, ..request.params };
        mark_within(&host, &MarkRequest { params, ..request }, limit, most).unwrap()
    };
    measure("embed as the service", &|| drop(black_box(both())));
    measure("extract", &|| drop(black_box(extract(&marked.bytes))));
    measure("independent check", &|| drop(black_box(independent())));
    let yardstick = medians.first().map_or(f64::NAN, |(_, seconds)| *seconds);
    for (name, seconds) in &medians {
        println!("{name:20} {:8.1} ms {:6.2} x tobj", 1e3 * seconds, seconds / yardstick);
    }
}
