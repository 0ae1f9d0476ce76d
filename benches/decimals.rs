//! What marking does to the text of OBJ files: coordinates with more decimals than in the host.
//!
//! ```text
//! cargo bench --bench decimals -- --strength 0.1 FILE...
//! ```
//!
//! Prints one row per file that can be marked: coordinates that changed; those of them with more
//! decimals than their token has in the host, counted from both texts and not by the program; MRMS
//! as a share of the diagonal; rounds of the closed loop; smallest margin; bytes of the marked file
//! over those of the host. The sums are at the end. Refused files are counted.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop")]
#![allow(clippy::pedantic)]

use quadmark::formats::Limits;
use quadmark::marking::{Amplitude, Layers, MarkRequest, mark};
use quadmark::watermark::{EmbedParams, MarkKey, Message, Strength};

/// The coordinates of all `v` lines, by an independent reader. It does not read continued lines,
/// which no file here has.
fn coordinates(bytes: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(bytes);
    let mut found = Vec::new();
    for line in text.split(['\r', '\n']) {
        let mut words = line.split_ascii_whitespace();
        if words.next() == Some("v") {
            found.extend(words.take(3).map(str::to_owned));
        }
    }
    found
}

/// Number of digits after the decimal point, minus the exponent.
fn decimals(token: &str) -> i64 {
    let token = token.to_ascii_lowercase();
    let (mantissa, exponent) = token.split_once('e').unwrap_or((&token, "0"));
    let digits = mantissa.split_once('.').map_or(0, |(_, digits)| digits.len());
    (digits as i64 - exponent.parse::<i64>().unwrap()).max(0)
}

#[derive(Default)]
struct Sum {
    marked: usize,
    refused: usize,
    changed: usize,
    more: usize,
    mrms: f64,
    rounds: usize,
    growth: f64,
}

fn main() {
    let mut strength = 0.1;
    let mut files = Vec::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--bench" => {}
            "--strength" => strength = words.next().unwrap().parse().unwrap(),
            file => files.push(file.to_owned()),
        }
    }
    let message =
        Message::from_bytes(&[0x5a, 0x3c, 0x96, 0xe1, 0x0f, 0xa5, 0x69, 0xd2], Default::default());
    let request = MarkRequest {
        key: &MarkKey::from_bytes([7; 32]),
        others: &[],
        message: &message.unwrap(),
        params: EmbedParams {
            strength: Strength::new(strength).unwrap(),
            ..EmbedParams::default()
        },
        limits: Limits::default(),
        stop: &|| false,
        layers: Layers::Blind,
        amplitude: Amplitude::default(),
        independent_check_max_bytes: 0,
    };
    println!("file changed more% mrms rounds margin growth method");
    let mut sum = Sum::default();
    for file in files {
        let host = std::fs::read(&file).unwrap();
        let name = file.rsplit('/').next().unwrap();
        let marked = match mark(&host, &request) {
            Ok(marked) => marked,
            Err(error) => {
                sum.refused += 1;
                println!(
                    "{name} refused: {}",
                    error.to_string().chars().take(60).collect::<String>()
                );
                continue;
            }
        };
        let (before, after) = (coordinates(&host), coordinates(&marked.bytes));
        assert_eq!(before.len(), after.len());
        let changed = before.iter().zip(&after).filter(|(before, after)| before != after);
        let (mut all, mut more) = (0, 0);
        for (before, after) in changed {
            all += 1;
            more += usize::from(decimals(after) > decimals(before));
        }
        let growth = marked.bytes.len() as f64 / host.len() as f64;
        let report = &marked.report;
        println!(
            "{name} {all} {:.1} {:.3e} {} {:.4} {growth:.4} {}",
            100.0 * more as f64 / all.max(1) as f64,
            report.quality.mrms,
            report.rounds,
            report.smallest_margin,
            report.method_used,
        );
        sum.marked += 1;
        sum.changed += all;
        sum.more += more;
        sum.mrms += report.quality.mrms.ln();
        sum.rounds += report.rounds;
        sum.growth += growth.ln();
    }
    let marked = sum.marked.max(1) as f64;
    println!(
        "{} marked, {} refused; {:.2} % of {} changed coordinates have more decimals; geometric mean \
         of MRMS {:.4e}, mean rounds {:.2}, geometric mean of growth {:.4}",
        sum.marked,
        sum.refused,
        100.0 * sum.more as f64 / sum.changed.max(1) as f64,
        sum.changed,
        (sum.mrms / marked).exp(),
        sum.rounds as f64 / marked,
        (sum.growth / marked).exp(),
    );
}
