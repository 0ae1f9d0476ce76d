//! One row of `results.csv`: one attack on one marked copy.

use std::collections::BTreeSet;
use std::io::Write;

use serde::{Deserialize, Serialize};

/// A row. The same seed gives the same row, so it has no time of day and no duration. Distances are
/// shares of the host's bounding-box diagonal. What was not measured is empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the [`Experiment`](super::grid::Experiment).
    pub experiment: String,
    /// The host's name.
    pub mesh: String,
    /// Vertices of the host.
    pub vertices: usize,
    /// Triangles of the host.
    pub triangles: usize,
    /// Bounding-box diagonal of the host, in its unit.
    pub diagonal: f64,
    /// The requested method.
    pub method: String,
    /// The requested strength; with a budget, the largest allowed strength.
    pub strength: f64,
    /// Bits of the mark.
    pub bits: usize,
    /// Whether the closed loop was used.
    pub closed_loop: bool,
    /// Largest allowed MRMS of the mark.
    pub budget: Option<f64>,
    /// Number of the trial.
    pub trial: usize,
    /// Seed of the run. Rows of earlier versions have neither this nor `place`.
    pub seed: Option<u64>,
    /// Position of the host among the files of the run, from 0.
    pub place: Option<usize>,
    /// The method that chose the positions.
    pub method_used: Option<String>,
    /// The strength that was used.
    pub strength_used: Option<f64>,
    /// MRMS of the mark.
    pub mark_mrms: Option<f64>,
    /// Hausdorff distance of the mark.
    pub mark_hausdorff: Option<f64>,
    /// Mean angle by which the mark turned normals, in degrees.
    pub mark_normal_deviation: Option<f64>,
    /// Number of triangles that the mark turned by more than 90 degrees.
    pub mark_flipped: Option<usize>,
    /// How visible the mark is, by [`msdm2`](super::perceived::msdm2); measured in the first trial.
    pub mark_perceived: Option<f64>,
    /// The attack.
    pub attack: String,
    /// Its family.
    pub family: String,
    /// Its amount: percent or a count.
    pub amount: Option<f64>,
    /// Bits read right, blindly.
    pub bits_right: Option<usize>,
    /// Bits read wrong.
    pub bits_wrong: Option<usize>,
    /// Bits not read.
    pub bits_erased: Option<usize>,
    /// Bits right over bits embedded.
    pub detection_ratio: Option<f64>,
    /// Decimal logarithm of the false-positive bound, blind, one record.
    pub log10_bound: Option<f64>,
    /// The same in the host's frame.
    pub log10_bound_in_place: Option<f64>,
    /// The same of the relief, read against the host, with all pose hypotheses counted. Empty if
    /// the mark has no relief, or if the surface is nowhere near the host. Rows of earlier versions
    /// do not have it.
    pub log10_bound_relief: Option<f64>,
    /// MRMS of the attacked mesh from the host; measured in the first trial of the first mark.
    pub attacked_mrms: Option<f64>,
    /// Hausdorff distance of the attacked mesh from the host, likewise.
    pub attacked_hausdorff: Option<f64>,
    /// Why there is no result.
    pub error: Option<String>,
}

/// All rows as CSV with a header line.
///
/// # Errors
/// None in practice: writing to memory does not fail.
pub fn to_csv(rows: &[Row]) -> Result<Vec<u8>, csv::Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row)?;
    }
    writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))
}

/// Writes rows trial by trial as they are made, so that a killed run leaves its finished trials.
pub struct Journal<W: Write> {
    file: W,
    /// Whether there is a header line.
    begun: bool,
}

impl<W: Write> Journal<W> {
    /// A journal that begins in `file`, or one that continues after other rows.
    pub fn new(file: W, goes_on: bool) -> Self {
        Self { file, begun: goes_on }
    }

    /// Adds rows, all in one write.
    ///
    /// # Errors
    /// When the file cannot be written. Its last line may then be incomplete, and no rows must be
    /// added any more.
    pub fn add(&mut self, rows: &[Row]) -> Result<(), csv::Error> {
        let mut lines = csv::WriterBuilder::new().has_headers(!self.begun).from_writer(Vec::new());
        for row in rows {
            lines.serialize(row)?;
        }
        let lines = lines.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
        self.file.write_all(&lines)?;
        self.begun = true;
        Ok(self.file.flush()?)
    }
}

/// The rows of an earlier run, or of its journal. A last line that was cut off is left out.
///
/// # Errors
/// When the bytes are no CSV, or have other columns.
pub fn from_csv(csv: &[u8]) -> Result<Vec<Row>, csv::Error> {
    let mut reader = csv::Reader::from_reader(csv);
    let headers = reader.headers()?;
    if !csv.is_empty() && !headers.iter().any(|name| name == "log10_bound_in_place") {
        let text = "these are not the columns of a results.csv of this command";
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, text).into());
    }
    let cut_off = csv.last() != Some(&b'\n');
    let mut records = reader.deserialize().peekable();
    let mut rows = Vec::new();
    while let Some(record) = records.next() {
        match record {
            Ok(row) => rows.push(row),
            Err(_) if cut_off && records.peek().is_none() => {}
            Err(error) => return Err(error),
        }
    }
    Ok(rows)
}

/// Rows of several runs of one seed, each result once.
#[must_use]
pub fn merged(mut rows: Vec<Row>) -> Vec<Row> {
    let mut seen = BTreeSet::new();
    rows.retain(|row| seen.insert(format!("{} {} {}", row.mark(), row.attack, row.trial)));
    rows
}

impl Row {
    /// The name of the row's mark: host and setting.
    #[must_use]
    pub fn mark(&self) -> String {
        let Self { experiment, mesh, method, strength, bits, closed_loop, .. } = self;
        let budget = self.budget.unwrap_or_default();
        format!("{experiment}|{mesh}|{method}|{strength}|{bits}|{closed_loop}|{budget}")
    }
}
