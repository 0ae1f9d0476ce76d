//! `quadmark sample`.

use std::path::PathBuf;
use std::process::ExitCode;

use quadmark::sample::{Sample, to_glb, to_obj};

use super::{Failure, Outcome, files};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// gear, knot or blob.
    shape: Sample,
    /// The file to write: its name must end in .obj or .glb.
    #[arg(short, long)]
    output: PathBuf,
    /// About how many vertices.
    #[arg(long, default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(500..=10_000_000))]
    vertices: u32,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mesh = arguments.shape.mesh(arguments.vertices)?;
    let extension = arguments.output.extension().and_then(|extension| extension.to_str());
    let bytes = match extension.map(str::to_ascii_lowercase).as_deref() {
        Some("obj") => to_obj(&mesh),
        Some("glb") => to_glb(&mesh),
        _ => {
            let name = arguments.output.display();
            return Err(Failure(format!("{name}: the name must end in .obj or .glb")));
        }
    };
    files::write(&arguments.output, &bytes)?;
    let (vertices, triangles) = (mesh.positions().len(), mesh.triangles().len());
    eprintln!("wrote {} ({vertices} vertices, {triangles} triangles)", arguments.output.display());
    Ok(ExitCode::SUCCESS)
}
