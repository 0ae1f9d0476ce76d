//! `quadmark verify`: a file against the marks of a data directory, without a server.

use std::path::PathBuf;
use std::process::ExitCode;

use quadmark::config::{Config, ConfigArgs};
use quadmark::service::{Depth, Service, ServiceError, Text, Verdict, Verification, VerifyRequest};

use super::{Failure, Outcome, files};

/// The suspect, and the marks that it is compared with.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The suspect: OBJ, GLB or glTF; `-` is standard input.
    input: PathBuf,
    /// Compare with this owner's marks only.
    #[arg(long, value_name = "OWNER")]
    owner_id: Option<String>,
    /// Compare with this mark only.
    #[arg(long, value_name = "ID")]
    watermark_id: Option<uuid::Uuid>,
    /// How much is tried: fast, standard or exhaustive.
    #[arg(long, value_name = "DEPTH", default_value_t)]
    depth: Depth,
    /// Print the verdict as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

/// Prints the verdict. The exit code is 0 for a match and 1 for any other verdict.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut args = arguments.config.clone();
    // No address is used here, so no address is refused.
    args.settings.insecure_listen = Some(true);
    let config = Config::load(args)?;
    let bytes = files::read(&arguments.input)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let verification = runtime.block_on(verify(config, &bytes, arguments))?;
    if arguments.json {
        files::print_json(&verification)?;
    } else {
        print(&verification);
    }
    Ok(ExitCode::from(u8::from(verification.verdict != Verdict::Match)))
}

async fn verify(
    config: Config,
    bytes: &[u8],
    arguments: &Arguments,
) -> Result<Verification, Failure> {
    let service = Service::open_to_verify(config).await?;
    let admission = service.admit_upload(None)?;
    let spooled = service.spool(admission)?.write(bytes).await?.end(None).await?;
    let owner_id = arguments.owner_id.as_deref().map(|text| Text::parse("owner_id", text));
    let owner_id = owner_id.transpose()?;
    let watermark_id = arguments.watermark_id;
    let request = VerifyRequest { file: spooled, owner_id, watermark_id, depth: arguments.depth };
    let verified: Result<Verification, ServiceError> = service.verify(request).await;
    service.close().await;
    Ok(verified?)
}

fn print(verification: &Verification) {
    let verdict = match verification.verdict {
        Verdict::Match => "match",
        Verdict::BlindOnly => "blind only: a mark was read, but the shape is not its host's",
        Verdict::Inconclusive => "inconclusive",
        Verdict::NoMatch => "no match",
    };
    println!("{verdict} ({} hypotheses)", verification.hypotheses);
    for run in &verification.stages {
        println!("  tried {}: {} hypotheses", run.stage.name(), run.hypotheses);
    }
    for found in &verification.matches {
        let recipient = found.recipient.as_deref().unwrap_or("-");
        println!(
            "{}  owner {}  recipient {recipient}  log10_fp {:.1}  {} of {} bits  by {}",
            found.watermark_id,
            found.owner_id,
            found.log10_fp,
            found.bits_agreeing,
            found.bits_read,
            found.evidence.as_ref().map_or("-", |evidence| evidence.stage.name())
        );
    }
}
