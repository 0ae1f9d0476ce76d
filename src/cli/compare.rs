//! `quadmark compare`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use quadmark::formats::Asset;
use quadmark::lab::perceived::msdm2;
use quadmark::mesh::distortion::{SAMPLES_PER_KIND, distortion};
use quadmark::mesh::surface::Surface;
use serde_json::json;

use super::{Failure, Outcome, files, limits};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The first file, whose bounding-box diagonal makes distances relative; - is standard input.
    first: PathBuf,
    /// The second file.
    second: PathBuf,
    /// Samples on edges, and in triangles, beside all vertices. With 0 the distance is measured at
    /// the vertices alone.
    #[arg(long, default_value_t = SAMPLES_PER_KIND)]
    samples: usize,
    /// Also measure how visible the difference is (MSDM2), from 0 for not at all towards 1.
    #[arg(long)]
    perceived: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let surface = |path: &Path| -> Result<Surface, Failure> {
        Ok(Surface::new(Asset::read(&files::read(path)?, &limits())?.mesh()))
    };
    let (first, second) = (surface(&arguments.first)?, surface(&arguments.second)?);
    let no_surface = || Failure("one of the files has no triangle with an area".into());
    let measured = distortion(&first, &second, arguments.samples).ok_or_else(no_surface)?;
    let relative = |length: f64| length / measured.diagonal;
    let perceived = if arguments.perceived { msdm2(&first, &second) } else { None };
    if arguments.json {
        files::print_json(&json!({
            "mrms": measured.mrms,
            "hausdorff": measured.hausdorff,
            "diagonal": measured.diagonal,
            "mrms_relative": relative(measured.mrms),
            "hausdorff_relative": relative(measured.hausdorff),
            "perceived": perceived,
        }))?;
    } else {
        println!(
            "mrms {:.4e} ({:.5} % of the diagonal), hausdorff {:.4e} ({:.5} %)",
            measured.mrms,
            100.0 * relative(measured.mrms),
            measured.hausdorff,
            100.0 * relative(measured.hausdorff)
        );
        if let Some(perceived) = perceived {
            println!("perceived {perceived:.4} (MSDM2)");
        }
    }
    Ok(ExitCode::SUCCESS)
}
