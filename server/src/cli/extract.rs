//! `isopeel extract`

mod output;

use std::fs::File;
use std::io::{self, IsTerminal, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::ArgGroup;
use isopeel_kernels::MAX_LEVEL;
use tokio_util::sync::CancellationToken;

use crate::cli::device::DeviceArgs;
use crate::export::{FileOptions, FileRequest, Format, MakeError, why_empty};
use crate::extraction::{DeviceWorker, ExtractionStatistics, Extractor, WorkError};
use crate::view::quality::{Distance, GuardName, MaxError, MesherName, TopologyName, TriangleBudget};
use crate::view::{
    ChosenPartsJson, Edit, EditError, InterestJson, Outward, TransferFunctionJson, View, parse_position,
};
use crate::volumes::{Frame, ReadError, UnknownStep, VolumeStep, open_dataset};
use crate::wire::encode::encoded_bytes;
use output::Output;

/// Maximum bytes of a transfer function's file; 64 points take some 4 KiB.
const MAX_TRANSFER_FUNCTION_BYTES: u64 = 1 << 20;

/// Arguments of `isopeel extract`.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("result").args(["output", "stats"]).required(true).multiple(true)))]
pub struct Args {
    /// Volume: a file, a folder whose files share one grid and become the fields of one dataset, or the address of a Zarr store (https://,
    /// http://, s3://) or of a volume of Neuroglancer (precomputed://https://…)
    #[arg(value_name = "PATH")]
    path: PathBuf,

    /// Isovalue, in the field's units [default: the one that the field opens with in a viewer, which isopeel info explains]
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    iso: Option<f32>,

    /// Labels of a segmentation whose surface is extracted, instead of one at an isovalue: by numbers or names, `7`, `3,Hippocampus`. They are of
    /// --field, else of the first field with names of labels
    #[arg(long, value_name = "LABELS", conflicts_with = "iso", allow_hyphen_values = true)]
    label: Option<String>,

    /// Field whose isosurface is extracted, or an expression over fields, as `log(rho)` [default: the main one]
    #[arg(long, value_name = "NAME")]
    field: Option<String>,

    /// Where the surface may be: at samples where a field has certain values, `labels==3`, also with !=, <, <=, >, >=; behind == and != also
    /// ranges and lists, `labels==1,4..7` [default: everywhere]
    #[arg(long, value_name = "FIELD==V")]
    mask: Option<String>,

    /// Feature that matters beside smoothness: the name of a field; `gradient-magnitude`, `mean-curvature`, `gaussian-curvature` or
    /// `local-variance` of the field that is extracted; or `vector-magnitude(X,Y,Z)`, `divergence(X,Y,Z)`, `vorticity-magnitude(X,Y,Z)`,
    /// `q-criterion(X,Y,Z)`, `lambda2(X,Y,Z)` or `helicity(X,Y,Z)` of three fields or expressions; or an expression over fields, as
    /// `magnitude(u,v,w)`; or `distance(CONDITION)`, how far it is to where a mask or an expression holds, as `distance(labels==3)`
    /// [default: none]
    #[arg(long, value_name = "NAME")]
    feature: Option<String>,

    /// Feature values that become 0 and 1, in the feature's units [default: the feature's least and greatest value]
    #[arg(long, num_args = 2, value_names = ["LO", "HI"], allow_negative_numbers = true, requires = "feature")]
    feature_range: Option<Vec<f32>>,

    /// Weight of the feature against smoothness, 0 to 1 [default: 0.3 with --feature, else 0]
    #[arg(long, value_name = "A", allow_negative_numbers = true)]
    alpha: Option<f32>,

    /// Importance up to which the surface is decimated, 0 to 1; below 0 gives the full surface. Given, it means exactly
    /// that cut of the paper: the guards --max-error and --topology are off unless they are given too [default: 0.02,
    /// guards on]
    #[arg(long, value_name = "B", allow_negative_numbers = true, conflicts_with_all = ["error", "triangles", "bytes"])]
    beta: Option<f32>,

    /// Error up to which parts are merged, instead of --beta, in world units or as multiples of the smallest spacing
    /// (0.1vx). It counts over a weight, which is 1 where importance is 0 and falls as importance grows
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    error: Option<Distance>,

    /// Maximum triangles, a number or a share of the full surface (25%), instead of --beta: the smallest error that keeps
    /// it is found (`tolerance` in --stats). With --error the greater of both decides
    #[arg(long, value_name = "N", allow_hyphen_values = true, conflicts_with = "bytes")]
    triangles: Option<TriangleBudget>,

    /// Maximum bytes that the surface may take on the wire of `isopeel serve`, as --triangles; files are larger
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    bytes: Option<u64>,

    /// Parts of the surface with a smaller area, in world units, are removed first; with --error, --triangles or --bytes. Budgets
    /// and guards then are about what is left [default: none are removed]
    #[arg(long, value_name = "AREA", allow_negative_numbers = true)]
    min_part: Option<f64>,

    /// Part of the surface that is removed: the one next to this position, in world coordinates. As --min-part. May be given up to
    /// 64 times
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_position)]
    hide_part: Vec<[f64; 3]>,

    /// Part of the surface that is kept while all others are removed, as --hide-part. May be given up to 64 times
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_position, conflicts_with = "hide_part")]
    keep_part: Vec<[f64; 3]>,

    /// Guard: farthest that a decimated part may be from the surface it stands for, in world units or as multiples of the
    /// smallest spacing (0.25vx), or `none`. `auto` is 0.25vx beside --beta's default, and gives way to an error or a
    /// budget; a guard that is set does not [default: auto; with --beta: none]
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    max_error: Option<MaxError>,

    /// Guard: whether decimation may change the topology [default: auto; with --beta: free]
    #[arg(long, value_name = "TOPOLOGY")]
    topology: Option<TopologyName>,

    /// Which mesher turns the cut into triangles
    #[arg(long, value_name = "MESHER", default_value = "dual")]
    mesher: MesherName,

    /// Close surfaces that leave the volume on its faces; the dual mesher alone can
    #[arg(long)]
    cap: bool,

    /// Transfer function, JSON as `{"points":[{"x":0,"importance":0,"color":"#3465a4"}, …]}`, x and importance 0 to 1; a
    /// GLB gets its colours [default: importance is the blended feature itself]
    #[arg(long, value_name = "FILE.json")]
    transfer_function: Option<PathBuf>,

    /// Region of interest, in world coordinates: `sphere:X,Y,Z:R=I` (centre, radius) or `box:X,Y,Z:X,Y,Z=I` (minimum, maximum).
    /// Inside, importance is at least I, 0 to 1. May be given up to 64 times
    #[arg(long, value_name = "REGION=I")]
    interest: Vec<InterestJson>,

    /// Coarsest level, 0 to 5: cubes of up to 2^L cells per axis
    #[arg(long, value_name = "L", default_value_t = MAX_LEVEL.get(), value_parser = clap::value_parser!(u8).range(..=i64::from(MAX_LEVEL.get())))]
    max_level: u8,

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

    /// Which side of the surface is its outside: that of high values, that of low values, or of a closed surface the side away from the volume
    /// that it encloses, else the side of low values
    #[arg(long, value_name = "SIDE", default_value = "auto")]
    outward: Outward,

    /// Unit of positions in a PLY or VTP, and of those of a volume that declares none: m, mm, cm, um, nm, km or angstrom. A GLB is always in
    /// metres, an STL in millimetres [default: the volume's]
    #[arg(long, value_name = "UNIT")]
    unit: Option<String>,

    /// Fields whose values become attributes of the vertices, in their own units: `temperature,pressure`. An STL holds none
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    field_values: Vec<String>,

    /// Write a surface without triangles too. Without it, no file is written and the exit code is 3
    #[arg(long, requires = "output")]
    allow_empty: bool,

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
    #[error("transfer function {}", path.display())]
    TransferFunction {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// The surface has no triangles, and `--allow-empty` is not given.
    #[error("{0}; nothing was written, --allow-empty writes a file without triangles")]
    Empty(String),
    /// The output's file cannot be written.
    #[error("output {}", path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
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
    let request = args.request(format.unwrap_or(Format::Stl))?;
    let view = request.view(&dataset)?;
    let volume = VolumeStep::new(dataset, args.step)?;
    // A folder that cannot be written is found before the extraction.
    let output = args
        .output
        .as_deref()
        .map(|path| Output::create(path, request))
        .transpose()?;
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
    output: Option<Output>,
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
    if let (None, None, Some(iso)) = (args.iso, &args.label, extraction.view.iso) {
        eprintln!(
            "isopeel: isovalue {}, as the field opens with: isopeel info says why",
            iso.get()
        );
    }
    let empty = why_empty(&extractor, &volume, &extraction.view, &statistics).await?;
    let is_refused = empty.is_some() && output.is_some() && !args.allow_empty;
    if let Some(output) = output.filter(|_| !is_refused) {
        progress.say(&format!(
            "writing {} triangles to {}",
            statistics.triangles,
            output.path.display()
        ));
        // This thread waits for Ctrl-C.
        let volume = volume.clone();
        let written = tokio::task::spawn_blocking(move || output.write(extraction, &volume, &device.name, &token));
        statistics = written.await.map_err(io::Error::from)??;
    }
    if let (Some(why), false) = (&empty, is_refused) {
        eprintln!("isopeel: {why}");
    }
    for line in removed(args.min_part, args.parts().as_ref(), &statistics) {
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

impl Args {
    /// The request of the arguments.
    fn request(&self, format: Format) -> Result<FileRequest, ExtractError> {
        let transfer_function = self.transfer_function.as_deref().map(read_transfer_function);
        let edit = Edit {
            iso: self.iso,
            field: self.field.clone(),
            mask: self.mask.clone().map(Some),
            feature: self.feature.clone(),
            feature_range: self.feature_range.as_deref().and_then(|range| range.try_into().ok()),
            alpha: self.alpha,
            beta: self.beta,
            error: self.error,
            triangles: self.triangles,
            bytes: self.bytes,
            min_part: self.min_part,
            parts: self.parts().map(Some),
            max_error: self.max_error,
            topology: self.topology,
            mesher: Some(self.mesher),
            cap: Some(self.cap),
            max_level: Some(self.max_level),
            transfer_function: transfer_function.transpose()?,
            interest: Some(self.interest.clone()),
        };
        let options = FileOptions {
            format,
            allow_empty: self.allow_empty,
            outward: self.outward,
            unit: self.unit.clone(),
            field_values: self.field_values.clone(),
            label: self.label.clone(),
        };
        Ok(FileRequest {
            step: self.step,
            options,
            edit,
        })
    }

    /// The parts that are hidden or kept.
    fn parts(&self) -> Option<ChosenPartsJson> {
        let given = |positions: &Vec<_>| (!positions.is_empty()).then(|| positions.clone());
        let hide = given(&self.hide_part).map(ChosenPartsJson::Hide);
        hide.or_else(|| given(&self.keep_part).map(ChosenPartsJson::Keep))
    }
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

fn read_transfer_function(path: &Path) -> Result<TransferFunctionJson, ExtractError> {
    let read = || {
        let mut text = String::new();
        File::open(path)?
            .take(MAX_TRANSFER_FUNCTION_BYTES)
            .read_to_string(&mut text)?;
        Ok(serde_json::from_str(&text)?)
    };
    read().map_err(|source| ExtractError::TransferFunction {
        path: path.to_owned(),
        source,
    })
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
