//! `isopeel extract`

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::ArgGroup;
use tokio_util::sync::CancellationToken;

use crate::cli::device::DeviceArgs;
use crate::cli::output::{Output, OutputError};
use crate::cli::surface::{SurfaceArgs, TransferFunctionError};
use crate::export::{FileRequest, Format, MadeFile, MakeError, why_empty};
use crate::extraction::{DeviceWorker, ExtractionStatistics, Extractor, WorkError};
use crate::view::quality::GuardName;
use crate::view::{ChosenPartsJson, EditError, View};
use crate::volumes::{Frame, ReadError, UnknownStep, VolumeStep, open_dataset};
use crate::wire::encode::encoded_bytes;

/// Arguments of `isopeel extract`.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("result").args(["output", "stats"]).required(true).multiple(true)))]
pub struct Args {
    /// Volume: a file, a folder whose files share one grid and become the fields of one dataset, or the address of a Zarr store (https://,
    /// http://, s3://) or of a volume of Neuroglancer (precomputed://https://…)
    #[arg(value_name = "PATH")]
    path: PathBuf,

    #[command(flatten)]
    surface: SurfaceArgs,

    /// Time step, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    step: u32,

    /// Frame of all positions: LPS (left, back and head of a patient are positive), RAS (right, front, head), or index, which counts
    /// samples. Volumes that do not say where a patient's sides are keep their own axes in the first two
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    frame: Frame,

    #[command(flatten)]
    device: DeviceArgs,

    /// File to write; its extension is the format: .glb (in metres, Y up), .ply, .stl or .vtp
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,

    /// Print counts, times in milliseconds and sizes in bytes to stdout, as one JSON object
    #[arg(long)]
    stats: bool,
}

/// Why there is no surface.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// The volume's file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The volume has no such step.
    #[error(transparent)]
    Step(#[from] UnknownStep),
    /// A value out of its range.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// Work on the device failed.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The file could not be made of the surface.
    #[error(transparent)]
    Make(#[from] MakeError),
    /// The transfer function's file cannot be read.
    #[error(transparent)]
    TransferFunction(#[from] TransferFunctionError),
    /// The surface has no triangles, and `--allow-empty` is not given.
    #[error("{0}; nothing was written, --allow-empty writes a file without triangles")]
    Empty(String),
    /// The output's file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Stdout is closed, or no thread or signal handler could be had.
    #[error("the process could not go on")]
    System(#[from] io::Error),
    /// Ctrl-C.
    #[error("interrupted, nothing was written")]
    Interrupted,
}

/// Extracts one surface. On an error no new file is left.
///
/// # Errors
/// [`ExtractError`].
pub fn run(args: &Args) -> Result<(), ExtractError> {
    let format = args.output.as_deref().map(Format::from_path).transpose();
    let format = format.map_err(MakeError::Export)?;
    let mut dataset = open_dataset(&args.path)?;
    dataset.set_frame(args.frame);
    let dataset = Arc::new(dataset);
    // A count has no format, and any will do.
    let request = args.surface.request(format.unwrap_or(Format::Stl), args.step)?;
    let view = request.view(&dataset)?;
    let volume = VolumeStep::new(dataset, args.step)?;
    // A folder that cannot be written is found before the extraction.
    let output = args
        .output
        .as_deref()
        .map(Output::create)
        .transpose()?
        .map(|output| (output, request));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let token = CancellationToken::new();
        let interrupt = token.clone();
        let mut work = Box::pin(extract(args, volume, view, output, token));
        tokio::select! {
            outcome = &mut work => return outcome,
            signal = tokio::signal::ctrl_c() => signal?,
        }
        interrupt.cancel();
        match work.await {
            // Finished before the signal arrived.
            Ok(()) => Ok(()),
            Err(_) => Err(ExtractError::Interrupted),
        }
    })
}

async fn extract(
    args: &Args,
    volume: VolumeStep,
    view: View,
    output: Option<(Output, FileRequest)>,
    token: CancellationToken,
) -> Result<(), ExtractError> {
    let progress = Progress::new();
    progress.say("opening the device");
    let types = volume.dataset().fields.iter().map(|field| field.sample_type).collect();
    let preparing = progress.clone();
    let options = args.device.options(types, move |text| preparing.say(text));
    let worker = DeviceWorker::start_with(options)?;
    let device = worker.ready().await?;
    progress.say(&format!("extracting on {}", device.name.trim()));
    let extractor = Extractor::new(worker, u64::MAX, encoded_bytes);
    let extraction = extractor.extract(&volume, &view, &token).await?;
    let mut statistics = extraction.statistics(&volume, &device.name);
    if let (None, None, Some(iso)) = (args.surface.iso, &args.surface.label, extraction.view.iso) {
        eprintln!(
            "isopeel: isovalue {}, as the field opens with: isopeel info says why",
            iso.get()
        );
    }
    let empty = why_empty(&extractor, &volume, &extraction.view, &statistics).await?;
    let is_refused = empty.is_some() && output.is_some() && !args.surface.allow_empty;
    if let Some((output, request)) = output.filter(|_| !is_refused) {
        progress.say(&format!(
            "writing {} triangles to {}",
            statistics.triangles,
            output.path.display()
        ));
        // This thread waits for Ctrl-C.
        let volume = volume.clone();
        let written = tokio::task::spawn_blocking(move || {
            let made = MadeFile::new(extraction, &volume, &request, &device.name, &|| token.is_cancelled())?;
            output.write(&made, &token)?;
            Ok::<_, ExtractError>(made.statistics)
        });
        statistics = written.await.map_err(io::Error::from)??;
    }
    if let (Some(why), false) = (&empty, is_refused) {
        eprintln!("isopeel: {why}");
    }
    for line in removed(args.surface.min_part, args.surface.parts().as_ref(), &statistics) {
        eprintln!("isopeel: {line}");
    }
    for guard in &statistics.gave_way {
        eprintln!("isopeel: {}", gave_way(*guard, &statistics));
    }
    for notice in &statistics.notices {
        eprintln!("isopeel: {notice}");
    }
    if args.stats {
        let mut line = serde_json::to_string(&statistics).map_err(io::Error::from)?;
        line.push('\n');
        super::print(line.as_bytes())?;
    }
    if let (Some(why), true) = (empty, is_refused) {
        return Err(ExtractError::Empty(why));
    }
    progress.say("done");
    Ok(())
}

/// How much was removed, where that was asked for, and which positions chose nothing.
fn removed(min_part: Option<f64>, chosen: Option<&ChosenPartsJson>, statistics: &ExtractionStatistics) -> Vec<String> {
    let (Some(parts), Some(triangles)) = (statistics.removed_parts, statistics.removed_triangles) else {
        return Vec::new();
    };
    let (noun, were) = if parts == 1 { ("part", "was") } else { ("parts", "were") };
    let which = match (min_part, chosen) {
        (Some(min_part), None) => format!(" with an area below {min_part}"),
        _ => String::new(),
    };
    let all = statistics.full_triangles + triangles;
    let mut lines = vec![format!(
        "{parts} {noun}{which} {were} removed, {triangles} of the full surface's {all} triangles"
    )];
    let unmatched = statistics.unmatched_positions.unwrap_or_default();
    if let (1.., Some(chosen)) = (unmatched, chosen) {
        let (option, count) = match chosen {
            ChosenPartsJson::Hide(positions) => ("--hide-part", positions.len()),
            ChosenPartsJson::Keep(positions) => ("--keep-part", positions.len()),
        };
        lines.push(format!(
            "{unmatched} of the {count} positions of {option} chose nothing: there is no surface in the two cells around"
        ));
    }
    lines
}

/// Which guard gave way to the budget, and by how much.
fn gave_way(guard: GuardName, statistics: &ExtractionStatistics) -> String {
    match guard {
        GuardName::MaxError => format!(
            "the guard on the error gave way to the budget: parts were merged up to an error of {}",
            statistics.tolerance.unwrap_or_default()
        ),
        GuardName::Topology => "the guard on the topology gave way to the budget: small parts may have vanished".into(),
    }
}

/// What is being done, on stderr if that is a terminal.
#[derive(Clone)]
struct Progress {
    shown: bool,
    start: Instant,
}

impl Progress {
    fn new() -> Self {
        Self {
            shown: io::stderr().is_terminal(),
            start: Instant::now(),
        }
    }

    fn say(&self, what: &str) {
        if self.shown {
            eprintln!("{:8.3} s  {what}", self.start.elapsed().as_secs_f64());
        }
    }
}

#[cfg(test)]
mod tests;
