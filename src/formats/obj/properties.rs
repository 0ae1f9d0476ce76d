//! Properties of reading and patching, on generated OBJ texts. No exporter writes such a text, but
//! some exporter writes each of its parts.

use glam::DVec3;
use proptest::prelude::*;
use proptest::sample::{Index, select};

use super::super::{Asset, FormatError, Limits};
use super::{read, read_in_chunks};
use crate::mesh::Mesh;

/// A line that is not a vertex or a face, separators between words not included.
const OTHER_LINES: &[&str] = &[
    "",
    "# comment v 1 2 3",
    "# path C:\\",
    "vt 0.5 0.5",
    "vn 0 0 1",
    "vp 0.1",
    "o thing",
    "g a b\\c",
    "usemtl red",
    "mtllib ../../etc/passwd",
    "l 1 1",
    "p 1",
    "curv 0 1 1 1",
    "unknown \u{e9} words",
    "f 1 1",
];

fn number() -> impl Strategy<Value = String> {
    prop_oneof![
        "[+-]?[0-9]{1,3}\\.[0-9]{1,7}",
        "-?[0-9]{1,4}",
        "-?\\.[0-9]{1,3}",
        "-?[0-9]{1,2}\\.",
        "-?[0-9]\\.[0-9]{1,9}e[+-]?[0-9]",
        "-?[0-9]e-[0-9]{1,2}",
        "-?[0-9]{1,5}\\.[0-9]{12,17}",
        "[0-9]\\.[0-9]{1,3}0{1,5}",
        select(&["-0.0", "-0", "0", "0.000000"][..]).prop_map(str::to_owned),
    ]
}

fn blank() -> impl Strategy<Value = &'static str> {
    select(&[" ", " ", " ", "  ", "\t", " \t ", " \\\n", "\\\r\n", "\\\r "][..])
}

fn end() -> impl Strategy<Value = &'static str> {
    select(&["\n", "\n", "\r\n", "\r", "\n\n", " \n", " # end\n", "#\\\n", "\t\r\n"][..])
}

/// The words of a line, to be joined by any white space.
fn words() -> impl Strategy<Value = Vec<String>> {
    let vertex = (prop::collection::vec(number(), 3), 0..5_usize).prop_map(|(numbers, extra)| {
        let mut words = vec!["v".to_owned()];
        words.extend(numbers);
        words.extend(["0.5", "1", "0.25", "junk"].iter().take(extra).map(|&word| word.to_owned()));
        words
    });
    let corner = select(&["1", "2/1", "3//1", "-1", "-2/1/1", "+2", "3/-1"][..]);
    let face = prop::collection::vec(corner, 3..6).prop_map(|corners| {
        std::iter::once("f").chain(corners).map(str::to_owned).collect::<Vec<_>>()
    });
    let other = select(OTHER_LINES).prop_map(|line| vec![line.to_owned()]);
    prop_oneof![4 => vertex, 3 => face, 2 => other]
}

fn line() -> impl Strategy<Value = String> {
    (words(), prop::collection::vec(blank(), 9), end()).prop_map(|(words, blanks, end)| {
        let mut line = String::new();
        for (index, word) in words.iter().enumerate() {
            if index > 0 {
                line += blanks[index % blanks.len()];
            }
            line += word;
        }
        line + end
    })
}

/// A valid text with at least three vertices and a triangle.
fn text() -> impl Strategy<Value = String> {
    (any::<bool>(), prop::collection::vec(line(), 0..40), any::<bool>()).prop_map(
        |(mark, lines, last_end)| {
            let mark = if mark { "\u{feff}" } else { "" };
            let first = "v 0 0 0\nv 1 0.5 0\nv 0 1 -2.125\nf 1 2 3\n";
            let mut text = format!("{mark}{first}{}", lines.concat());
            if !last_end {
                text.truncate(text.trim_end_matches(['\r', '\n', ' ', '\t', '\\']).len());
            }
            text
        },
    )
}

/// Moves of some vertices: which one, and to where on each axis (or not).
fn moves() -> impl Strategy<Value = Vec<(Index, [Option<f64>; 3])>> {
    let target = prop_oneof![
        2 => Just(None),
        6 => (-2.0..2.0_f64).prop_map(Some),
        1 => (-1e-9..1e-9_f64).prop_map(Some),
        1 => any::<f64>().prop_filter_map("finite", |x| x.is_finite().then_some(Some(x))),
    ];
    prop::collection::vec((any::<Index>(), prop::array::uniform3(target)), 0..12)
}

fn moved(asset: &Asset, moves: &[(Index, [Option<f64>; 3])]) -> Vec<DVec3> {
    let mut positions = asset.mesh().positions().to_vec();
    for (vertex, targets) in moves {
        let position = vertex.get(&positions);
        let [x, y, z] = targets;
        let new =
            DVec3::new(x.unwrap_or(position.x), y.unwrap_or(position.y), z.unwrap_or(position.z));
        let vertex = vertex.index(positions.len());
        positions[vertex] = new;
    }
    positions
}

/// All coordinates as bits, because `-0.0 == 0.0`.
fn bits(positions: &[DVec3]) -> Vec<[u64; 3]> {
    positions.iter().map(|position| position.to_array().map(f64::to_bits)).collect()
}

/// The text with the first three words of each `v` line blanked out, and those words. This reader
/// has nothing in common with the one under test: it finds continuations by string replacement.
fn taken_apart(text: &str) -> (String, Vec<String>) {
    let (mut out, mut coordinates) = (String::new(), Vec::new());
    let mut rest = text.trim_start_matches('\u{feff}');
    out += &text[..text.len() - rest.len()];
    while !rest.is_empty() {
        let mut comment = false;
        let mut previous = ' ';
        let mut end = rest.len();
        for (at, c) in rest.char_indices() {
            comment |= c == '#';
            let continued = previous == '\\' && !comment;
            let second = previous == '\r' && c == '\n';
            if matches!(c, '\r' | '\n') && !continued && !second {
                end = at + 1;
                break;
            }
            previous = if second { ' ' } else { c };
            if continued && c == '\r' && rest[at + 1..].starts_with('\n') {
                previous = '\\';
            }
        }
        let (line, behind) = rest.split_at(end);
        rest = behind;
        let blanked = line.replace("\\\r\n", "\\\r\r").replace('\\', " ");
        let mut words = blanked.split([' ', '\t', '\r', '\n']).filter(|word| !word.is_empty());
        if words.next() != Some("v") {
            out += line;
            continue;
        }
        let mut copied = 0;
        for word in words.take(3) {
            let word = word.split('#').next().unwrap();
            let at = word.as_ptr() as usize - blanked.as_ptr() as usize;
            out += &line[copied..at];
            out.push('?');
            coordinates.push(word.to_owned());
            copied = at + word.len();
        }
        out += &line[copied..];
    }
    (out, coordinates)
}

/// Digits after the point, minus the exponent.
fn decimals(word: &str) -> usize {
    let (mantissa, exponent) = word.split_once(['e', 'E']).unwrap_or((word, "0"));
    let digits = mantissa.split_once('.').map_or(0, |(_, digits)| digits.len());
    let exponent: i64 = exponent.parse().unwrap();
    usize::try_from(i64::try_from(digits).unwrap() - exponent).unwrap_or(0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn moving_changes_only_coordinates_and_reads_back_as_rounded(text in text(), moves in moves()) {
        let asset = Asset::read(text.as_bytes(), &Limits::default()).unwrap();
        let host = asset.mesh().positions();
        let positions = moved(&asset, &moves);
        let mut rounded = positions.clone();
        asset.round(&mut rounded);

        let written = asset.write(text.as_bytes(), &positions).unwrap();
        let again = Asset::read(&written, &Limits::default()).unwrap();
        prop_assert_eq!(bits(again.mesh().positions()), bits(&rounded));
        prop_assert_eq!(again.mesh().triangles(), asset.mesh().triangles());
        // Rounding first changes nothing, and the written file keeps its text when nothing moves.
        prop_assert_eq!(&asset.write(text.as_bytes(), &rounded).unwrap(), &written);
        prop_assert_eq!(&again.write(&written, &rounded).unwrap(), &written);

        let written = String::from_utf8(written).unwrap();
        prop_assert_eq!(taken_apart(&written).0, taken_apart(&text).0);
        if bits(&rounded) == bits(host) {
            prop_assert_eq!(written, text);
        }
    }

    #[test]
    fn coordinates_keep_their_decimals_where_steps_allow(
        text in text(),
        moves in moves(),
        digits in 0..12_usize,
    ) {
        let asset = Asset::read(text.as_bytes(), &Limits::default()).unwrap();
        let step = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 0.0][digits];
        let stepped = asset.with_step(step);
        let mut rounded = moved(&asset, &moves);
        let written = stepped.write(text.as_bytes(), &rounded).unwrap();
        stepped.round(&mut rounded);
        let again = Asset::read(&written.bytes, &Limits::default()).unwrap();
        prop_assert_eq!(bits(again.mesh().positions()), bits(&rounded));

        let text_after = String::from_utf8(written.bytes).unwrap();
        let ((_, before), (_, after)) = (taken_apart(&text), taken_apart(&text_after));
        let mut more = 0;
        for (before, after) in before.iter().zip(&after).filter(|(before, after)| before != after) {
            let (host, marked) = (decimals(before), decimals(after));
            more += u64::from(marked > host);
            // As many decimals as in the host, or as the step needs; one more where 2^50 steps do
            // not reach.
            let beyond = usize::from(marked > 10 || after.len() > 15);
            // Steps are no finer than 1e-7 of the diagonal, which is below 1e7 here or irrelevant.
            prop_assert!(marked <= host.max(digits) + beyond || digits == 11, "{before} {after}");
            prop_assert!(!after.contains(['e', 'E']), "{before} {after}");
        }
        prop_assert_eq!(written.more_decimals, more);
    }

    /// Copies of one vertex stay together, however each is spelled.
    #[test]
    fn copies_stay_together(
        zeros in 0..6_usize,
        digits in -99_999..99_999_i32,
        to in -2.0..2.0_f64,
        step in 1e-9..1e-2_f64,
    ) {
        let x = f64::from(digits) / 1e5;
        let text = format!("v {x} 0 0\nv {x}{} 0 0\nv 1 0.1234567 0\nv 0 1 0\nf 1 3 4\nf 2 3 4\n",
            if x.fract() == 0.0 { String::new() } else { "0".repeat(zeros) });
        let asset = Asset::read(text.as_bytes(), &Limits::default()).unwrap();
        let mut positions = asset.mesh().positions().to_vec();
        prop_assert_eq!(positions[0], positions[1]);
        positions[0].x = to;
        positions[1].x = to;
        asset.with_step(step).round(&mut positions);
        prop_assert_eq!(bits(&positions[..1]), bits(&positions[1..2]));
    }

    #[test]
    fn cuts_do_not_matter(text in text(), chunk_bytes in 1..64_usize) {
        let limits = Limits::default();
        let (whole, _) = read(text.as_bytes(), &limits, &|| false).unwrap();
        let (cut, layout) = read_in_chunks(text.as_bytes(), &limits, chunk_bytes, &|| false).unwrap();
        prop_assert_eq!(bits(whole.positions()), bits(cut.positions()));
        prop_assert_eq!(whole.triangles(), cut.triangles());
        let mut positions = cut.positions().to_vec();
        let stepped = layout.with_step(0.0);
        stepped.round(&cut, &mut positions, &|| false);
        let written = stepped.write(text.as_bytes(), &cut, &positions, &|| false).unwrap();
        prop_assert_eq!(String::from_utf8(written.bytes).unwrap(), text);
    }

    #[test]
    fn mutations_of_a_text_give_the_same_answer_in_any_chunks(
        text in text(),
        edits in prop::collection::vec((any::<Index>(), any::<u8>()), 1..6),
        chunk_bytes in 1..64_usize,
    ) {
        let mut bytes = text.into_bytes();
        for (at, byte) in edits {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let limits = Limits { max_vertices: 20, max_triangles: 20, ..Limits::default() };
        let answer = |result: Result<(Mesh, _), FormatError>| result.map(|(mesh, _)| mesh);
        let whole = answer(read(&bytes, &limits, &|| false));
        prop_assert_eq!(whole, answer(read_in_chunks(&bytes, &limits, chunk_bytes, &|| false)));
        if let Ok(asset) = Asset::read(&bytes, &limits) {
            let positions = asset.mesh().positions();
            prop_assert_eq!(asset.write(&bytes, positions).unwrap(), bytes);
        }
    }

    #[test]
    fn every_prefix_is_read_or_refused(text in text(), cut in any::<Index>()) {
        let bytes = &text.as_bytes()[..cut.index(text.len() + 1)];
        let _ = Asset::read(bytes, &Limits::default());
    }

    #[test]
    fn random_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = Asset::read(&bytes, &Limits::default());
        let _ = read(&bytes, &Limits::default(), &|| false);
    }

    #[test]
    fn random_statements_are_read_or_refused(text in "[vf0-3./\\\\#\r\n \t+e-]{0,200}") {
        let _ = read(text.as_bytes(), &Limits::default(), &|| false);
        let _ = read_in_chunks(text.as_bytes(), &Limits::default(), 3, &|| false);
    }
}

#[test]
fn foreign_bytes_and_positions_are_refused() {
    let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let asset = Asset::read(text, &Limits::default()).unwrap();
    let moved = [DVec3::splat(0.5); 3];
    let refused = |bytes: &[u8], positions: &[DVec3]| {
        matches!(asset.write(bytes, positions), Err(FormatError::ReadBack { .. }))
    };
    assert!(!refused(text, &moved));
    assert!(refused(&text[1..], &moved));
    assert!(refused(b"v 0 0 0\nv 1 0 0\nv 9 1 0\nf 1 2 3\n", &moved));
    assert!(refused(b"v 0 0 0\nv 1 0 0\nv 0 1 #\nf 1 1 1\n", &moved));
    assert!(refused(text, &moved[1..]));
    assert!(refused(text, &[DVec3::NAN; 3]));
    assert!(refused(text, &[DVec3::INFINITY; 3]));
}
