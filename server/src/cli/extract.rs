//! `isopeel extract`: makes one file.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::ArgGroup;
use isopeel_extraction::{ExtractionStatistics, WorkError};
use isopeel_kernels::SampleType;
use isopeel_view::quality::GuardName;
use isopeel_view::{ChosenPartsJson, EditError};
use isopeel_volumes::{Dataset, Frame, ReadError, UnknownStep, VolumeStep, open_dataset};
use tokio_util::sync::CancellationToken;

use crate::cli::device::DeviceArgs;
use crate::cli::output::{Output, OutputError, STDOUT};
use crate::cli::stdin::InputPath;
use crate::cli::surface::{SurfaceArgs, TransferFunctionError};
use crate::export::{FileContent, FileRequest, FileSurface, Format, MadeSurface, MakeError, OtherVolumes, why_empty};
use crate::pool;
use crate::service::DeviceWorker;

/// Arguments of `isopeel extract`.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("result").args(["output", "stats"]).required(true).multiple(true)))]
pub struct Args {
    /// Volume: a file, a folder whose files share one grid and become the fields of one dataset, or the address of a Zarr store (https://,
    /// http://, s3://) or of a volume of Neuroglancer (precomputed://https://…); -: stdin
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
    pub(super) device: DeviceArgs,

    /// File to write; its extension is the format: .glb (in metres, Y up), .ply, .stl, .vtp, .obj, .3mf, .surf.gii (GIFTI),
    /// .precomputed.zip (Neuroglancer) or .usdz; -: stdout, with --format
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,

    /// Print counts, times in milliseconds and sizes in bytes to stdout, as one JSON object
    #[arg(long)]
    stats: bool,
}

/// Why the command has failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// The volume cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The volume has no such step.
    #[error(transparent)]
    Step(#[from] UnknownStep),
    /// A value is invalid.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// Work on the device failed.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The surface cannot be converted to a file.
    #[error(transparent)]
    Make(#[from] MakeError),
    /// The file of the transfer function cannot be read.
    #[error(transparent)]
    TransferFunction(#[from] TransferFunctionError),
    /// The surface has no triangles, and `--allow-empty` is not given.
    #[error("{0}; nothing was written, --allow-empty writes a file without triangles")]
    Empty(String),
    /// The output file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The output is stdout, and no format is given.
    #[error("-o - does not say the format: expected --format, {}", Format::EXPECTED)]
    NoFormat,
    /// Both the file and the statistics would go to stdout.
    #[error("--stats beside -o -: both are for stdout, expected one of them")]
    StatisticsBesideFile,
    /// Stdout is closed, a thread could not be started, or a signal handler could not be installed.
    #[error("the process could not go on")]
    System(#[from] io::Error),
    /// The user has pressed Ctrl-C.
    #[error("interrupted, nothing was written")]
    Interrupted,
}

/// Extracts the surfaces of the arguments, and writes the file. Leaves no new file after an error.
///
/// # Errors
/// [`ExtractError`].
pub fn run(args: &Args) -> Result<(), ExtractError> {
    let format = args.format()?;
    let input = InputPath::new(&args.path)?;
    let (dataset, others) = args.volumes(&input)?;
    let request = args.surface.request(format, args.step)?;
    let volume = VolumeStep::new(dataset, args.step)?;
    let surfaces = request.surfaces(&volume, &others)?;
    // Created before the extraction, so that a folder that is not writable is reported at once.
    let output = args.output.as_deref().map(Output::create).transpose()?;
    let work = Work {
        volume,
        request,
        surfaces,
        output,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let token = CancellationToken::new();
        let interrupt = token.clone();
        let mut work = Box::pin(extract(args, work, token));
        tokio::select! {
            outcome = &mut work => return outcome,
            signal = tokio::signal::ctrl_c() => signal?,
        }
        interrupt.cancel();
        match work.await {
            // The command has finished before the signal arrived.
            Ok(()) => Ok(()),
            Err(_) => Err(ExtractError::Interrupted),
        }
    })
}

/// The checked request of the command, and its output.
struct Work {
    volume: VolumeStep,
    request: FileRequest,
    surfaces: Vec<FileSurface>,
    output: Option<Output>,
}

async fn extract(args: &Args, work: Work, token: CancellationToken) -> Result<(), ExtractError> {
    let Work {
        volume,
        request,
        surfaces,
        output,
    } = work;
    let progress = Progress::new();
    progress.show("opening the device");
    let fields = surfaces.iter().flat_map(|surface| &surface.volume.dataset().fields);
    let mut types: Vec<SampleType> = fields.map(|field| field.sample_type).collect();
    types.dedup();
    let preparing = progress.clone();
    let options = args.device.options(types, move |text| preparing.show(text));
    let worker = DeviceWorker::start_with(options)?;
    let device = tokio::select! {
        device = worker.ready() => device?,
        () = token.cancelled() => return Err(ExtractError::Interrupted),
    };
    progress.show(&format!("extracting on {}", device.name.trim()));
    let (mut surfaces_made, mut statistics_only) = (Vec::new(), Vec::new());
    for surface in surfaces {
        let work = request.options.export_work(&surface.view);
        let extracted = worker.extract_with(&surface.volume, &surface.view, work, &token);
        let extraction = extracted.await?;
        let statistics = extraction.statistics(&surface.volume, &device.name);
        if let (None, None, Some(iso)) = (
            surface.request.edit.iso,
            &surface.request.options.label,
            extraction.view.iso,
        ) {
            eprintln!(
                "isopeel: isovalue {}, as the field opens with: isopeel info says why",
                iso.get()
            );
        }
        for line in messages(args, &statistics) {
            eprintln!("isopeel: {line}");
        }
        if let Some(why) = why_empty(&worker, &surface.volume, &extraction.view, &statistics).await? {
            if output.is_some() && !args.surface.allow_empty {
                print_statistics(args, statistics)?;
                return Err(ExtractError::Empty(why));
            }
            eprintln!("isopeel: {why}");
        }
        if output.is_some() {
            surfaces_made.push(MadeSurface::of(&worker, extraction, surface, &device.name, &token).await?);
        } else {
            statistics_only.push(statistics);
        }
    }
    let mut statistics = ExtractionStatistics::of_several(statistics_only);
    if let Some(output) = output {
        let file = FileContent::new(&volume, &request, surfaces_made);
        statistics = file.statistics.clone();
        progress.show(&format!(
            "writing {} triangles to {}",
            statistics.triangles,
            output.path.display()
        ));
        let written = pool::run_export(move || output.write(&file, &token));
        written.await.map_err(MakeError::from)??;
    }
    for notice in &statistics.notices {
        eprintln!("isopeel: {notice}");
    }
    print_statistics(args, statistics)?;
    progress.show("done");
    Ok(())
}

fn print_statistics(args: &Args, statistics: ExtractionStatistics) -> io::Result<()> {
    if !args.stats {
        return Ok(());
    }
    let mut line = serde_json::to_string(&statistics)?;
    line.push('\n');
    super::print(line.as_bytes())
}

/// Returns messages for users about removed parts, and about guards that gave way.
fn messages(args: &Args, statistics: &ExtractionStatistics) -> Vec<String> {
    let mut lines = removed(args.surface.min_part, args.surface.parts().as_ref(), statistics);
    lines.extend(statistics.gave_way.iter().map(|guard| gave_way(*guard, statistics)));
    lines
}

impl Args {
    /// Returns the format of `--format`, or of the extension of the output file.
    fn format(&self) -> Result<Format, ExtractError> {
        let is_stdout = self.output.as_deref() == Some(Path::new(STDOUT));
        if is_stdout && self.stats {
            return Err(ExtractError::StatisticsBesideFile);
        }
        match (self.surface.format, &self.output) {
            (Some(format), _) => Ok(format),
            (None, Some(_)) if is_stdout => Err(ExtractError::NoFormat),
            (None, Some(path)) => Ok(Format::from_path(path).map_err(MakeError::Export)?),
            // Without an output any format will do that can hold several surfaces.
            (None, None) => Ok(Format::Glb),
        }
    }

    /// Opens the volume, and the other volumes that surfaces name by their paths.
    fn volumes(&self, input: &InputPath) -> Result<(Arc<Dataset>, OtherVolumes), ExtractError> {
        let open = |path: &Path, revision| {
            let mut dataset = open_dataset(path)?;
            dataset.set_frame(self.frame);
            // Distinguishes volumes with the same id in the caches of the device.
            dataset.revision = revision;
            Ok::<_, ReadError>(Arc::new(dataset))
        };
        let mut others = OtherVolumes::new();
        for path in self.surface.other_volumes() {
            let revision = 1 + others.len() as u32;
            if !others.contains_key(path) {
                others.insert(path.to_owned(), open(Path::new(path), revision)?);
            }
        }
        let own = open(input.path(), 0).map_err(|error| input.name_in(error))?;
        Ok((own, others))
    }
}

/// Returns messages about parts that were removed, if the user has requested that, and about positions that are on no part.
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

/// Returns the message about a guard that gave way to the budget.
fn gave_way(guard: GuardName, statistics: &ExtractionStatistics) -> String {
    match guard {
        GuardName::MaxError => format!(
            "the guard on the error gave way to the budget: parts were merged up to an error of {}",
            statistics.tolerance.unwrap_or_default()
        ),
        GuardName::Topology => match statistics.vanished_parts {
            Some(1) => "the guard on the topology gave way to the budget: one small part vanished".into(),
            Some(parts) => format!("the guard on the topology gave way to the budget: {parts} small parts vanished"),
            None => "the guard on the topology gave way to the budget: small parts may have vanished".into(),
        },
    }
}

/// Progress on stderr, if that is a terminal.
#[derive(Clone)]
struct Progress {
    is_shown: bool,
    start: Instant,
}

impl Progress {
    fn new() -> Self {
        Self {
            is_shown: io::stderr().is_terminal(),
            start: Instant::now(),
        }
    }

    fn show(&self, text: &str) {
        if self.is_shown {
            eprintln!("{:8.3} s  {text}", self.start.elapsed().as_secs_f64());
        }
    }
}

#[cfg(test)]
mod tests;
