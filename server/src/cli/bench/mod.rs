//! `isopeel bench`: times the stages on a device, and compares them with the bandwidth of the device.
//!
//! The volumes are generated on the device. Before a case is timed, its counts are compared with counts by the host ([`reference`]); a
//! wrong count ends the benchmark. Each line of the output is a JSON object. The first line describes the device.
//!
//! [`stream`] times the whole path from an edit of a viewer to its frames, and `stream::camera` that from a camera. [`cases`] times the
//! parts of this path on the device and in the encoder.

mod cases;
mod reference;
mod stream;
mod volumes;

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::ValueEnum;
use isopeel_codec::encode::EncodeError;
use isopeel_kernels::{CutParams, Topology};
use isopeel_view::quality::{ErrorLimit, MesherName};
use serde::Serialize;

use crate::cli::device::{DeviceArgs, NoDevice};
use volumes::{Recipe, TypeName, VolumeName};

/// Arguments of `isopeel bench`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Volumes to make on the device; head, hurricane and fluid have sizes of their own
    #[arg(long, value_name = "NAME", num_args = 1.., value_enum, default_values_t = [VolumeName::Sin])]
    volume: Vec<VolumeName>,

    /// Samples along each axis of the other volumes
    #[arg(long, value_name = "N", num_args = 1.., default_values_t = [256], value_parser = clap::value_parser!(u32).range(2..=65536))]
    size: Vec<u32>,

    /// Types of the samples; head, hurricane and fluid have types of their own
    #[arg(long = "type", value_name = "TYPE", num_args = 1.., value_enum, default_values_t = [TypeName::F32])]
    types: Vec<TypeName>,

    /// What to time [default: all]
    #[arg(long, value_name = "NAME", num_args = 1.., value_enum)]
    case: Vec<CaseName>,

    /// Shares of the full-resolution triangles to keep; 1 is the full surface, others find their β by bisection first
    #[arg(long, value_name = "F", num_args = 1.., default_values_t = [1.0, 0.25, 0.08], value_parser = fraction)]
    fraction: Vec<f64>,

    /// Runs of each case after one to warm up
    #[arg(long, value_name = "R", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,

    /// What to edit in `stream` [default: all]
    #[arg(long, value_name = "NAME", num_args = 1.., value_enum)]
    edit: Vec<EditName>,

    /// Seconds of each drag of `stream`
    #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = drag_seconds)]
    drag_seconds: f64,

    /// Files that `camera` shows in place of the generated volumes
    #[arg(long, value_name = "PATH", num_args = 1..)]
    file: Vec<PathBuf>,

    /// Isovalue of the files [default: the one that each opens with]
    #[arg(long, value_name = "V", allow_negative_numbers = true, requires = "file")]
    iso: Option<f32>,

    /// Budget of triangles of `camera`
    #[arg(long, value_name = "N", default_value_t = 150_000, value_parser = clap::value_parser!(u64).range(1..))]
    triangles: u64,

    /// Error of `camera`: pixels (1px), spacings (0.1vx) or world units
    #[arg(long, value_name = "E", default_value = "1px")]
    error: ErrorLimit,

    /// Mesher; `camera` always uses dual
    #[arg(long, value_enum, default_value_t = MesherName::Dual)]
    mesher: MesherName,

    /// Decimate only what keeps the topology and stays within 0.1 of a sample's spacing (root mean square); `stream` has settings
    /// of its own
    #[arg(long)]
    guards: bool,

    /// In `stream` and `camera`: use the driver in the server's own process, as `isopeel serve --in-process` does
    #[arg(long)]
    in_process: bool,

    /// Folder to write every volume into, as NRRD, so that other programs can be timed on the same samples
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,

    #[command(flatten)]
    pub(super) device: DeviceArgs,
}

fn fraction(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1.0 => Ok(value),
        _ => Err("expected a number above 0, at most 1".to_owned()),
    }
}

fn drag_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=60.0).contains(&value) => Ok(value),
        _ => Err("expected a number from 0.1 to 60".to_owned()),
    }
}

/// What is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CaseName {
    /// Min/max table of a volume whose samples are on the device
    Load,
    /// Isovalue to mesh on the host, right after a load
    First,
    /// Isovalue to mesh on the host, another one than before
    Next,
    /// α, β and transfer function to mesh on the host, in turns; the pyramid is kept
    Edit,
    /// Another time step on the device to mesh on the host: load and isovalue
    Step,
    /// Mesh on the host to bytes of the stream, on all threads
    Encode,
    /// Edit to the last byte of the stream
    Bytes,
    /// Every edit of a viewer through a socket of the server, and drags
    Stream,
    /// Surfaces that follow a viewer's camera through a socket of the server
    Camera,
}

/// What is edited in `stream`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum EditName {
    /// Isovalue
    Isovalue,
    /// Budget of triangles, and β by half and by a thousandth
    Budget,
    /// Weight of the feature
    Alpha,
    /// Transfer function
    TransferFunction,
    /// Budget, weight of the feature and transfer function after a rest, in which the vertex tree was built
    Rested,
    /// Feature on and off
    Feature,
    /// Time step, new and resident
    Step,
    /// Isovalue and β at 20 and 60 Hz
    Drag,
}

impl Args {
    fn wants_edit(&self, edit: EditName) -> bool {
        self.edit.is_empty() || self.edit.contains(&edit)
    }

    fn wants(&self, case: CaseName) -> bool {
        self.case.is_empty() || self.case.contains(&case)
    }

    /// Whether a case other than `stream` and `camera` was chosen.
    fn wants_stages(&self) -> bool {
        let is_stage = |case: &CaseName| !matches!(case, CaseName::Stream | CaseName::Camera);
        self.case.is_empty() || self.case.iter().any(is_stage)
    }
}

/// Why a benchmark ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// There is no device.
    #[error(transparent)]
    NoDevice(#[from] NoDevice),
    /// Work on the device failed.
    #[error(transparent)]
    Device(#[from] isopeel_kernels::Error),
    /// A mesh could not be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The stream could not be timed.
    #[error(transparent)]
    Stream(#[from] stream::StreamError),
    /// A result differs from the reference.
    #[error("{volume}: {what} is {found}, the reference says {expected}")]
    Wrong {
        /// Title of the volume.
        volume: String,
        /// Name of the count.
        what: &'static str,
        /// Result of the device.
        found: String,
        /// Result of the host.
        expected: String,
    },
    /// A volume could not be written.
    #[error("volume {}", path.display())]
    Save {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// Stdout is closed.
    #[error("a result could not be printed")]
    Print(#[from] std::io::Error),
}

/// The first output line, which describes the device.
#[derive(Serialize)]
struct DeviceLine {
    version: &'static str,
    device: String,
    platform: String,
    driver: String,
    memory_bytes: u64,
    max_allocation_bytes: u64,
    compute_units: u32,
    threads: usize,
    /// Bytes read plus bytes written by copies on the device, in 10⁹ bytes per second.
    copy_gb_s: f64,
    copied_bytes: u64,
    launch_us: f64,
    launch_and_wait_us: f64,
}

/// Median and best time of all runs, in milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
struct Spread {
    median: f64,
    best: f64,
}

impl Spread {
    fn of(times: impl IntoIterator<Item = f64>) -> Self {
        let mut times: Vec<f64> = times.into_iter().collect();
        times.sort_by(f64::total_cmp);
        let at = |index: usize| times.get(index).copied().map_or(f64::NAN, round);
        Self {
            median: at(times.len() / 2),
            best: at(0),
        }
    }
}

/// Rounds to four digits after the decimal point. Times in milliseconds are not exact to a microsecond, and ratios not to the fourth digit.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// The output line of one case.
#[derive(Clone, Debug, Default, Serialize)]
struct Line {
    volume: String,
    dims: [u32; 3],
    #[serde(rename = "type")]
    sample_type: &'static str,
    volume_bytes: u64,
    iso: f32,
    case: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    fraction: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    beta: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mesher: Option<&'static str>,
    repeats: u32,
    /// Time from the call to its result on the host.
    #[serde(skip_serializing_if = "Option::is_none")]
    wall_ms: Option<Spread>,
    /// Sum of the times of all kernels and transfers by events of the device, without the read-back of the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    device_ms: Option<Spread>,
    /// Time of reading the mesh back to the host.
    #[serde(skip_serializing_if = "Option::is_none")]
    read_back_ms: Option<Spread>,
    /// Device time of each stage in the run with the best device time.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    stages_ms: BTreeMap<&'static str, f64>,
    /// Minimum bytes that the case must read: all samples, the samples of active bricks, or the pyramid.
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes_read: Option<u64>,
    /// `bytes_read` divided by the best device time, as a fraction of the copy bandwidth.
    #[serde(skip_serializing_if = "Option::is_none")]
    bandwidth_fraction: Option<f64>,
    /// Maximum bytes on the device in addition to the samples, including the min/max table.
    #[serde(skip_serializing_if = "Option::is_none")]
    device_bytes: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    device_bytes_per_full_triangle: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    full_triangles: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    triangles: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    vertices: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoded_bytes: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes_per_triangle: Option<f64>,
    /// Time of meshoptimizer's strip order, vertex fetch order and codecs for the same regions on the same threads.
    #[serde(skip_serializing_if = "Option::is_none")]
    meshopt_wall_ms: Option<Spread>,
    #[serde(skip_serializing_if = "Option::is_none")]
    meshopt_bytes: Option<u64>,
}

/// Returns the parameters of the cut, with a β for the full surface.
fn params(args: &Args, recipe: &Recipe) -> CutParams {
    CutParams {
        mesher: args.mesher.into(),
        max_error: args.guards.then_some(0.1 * recipe.grid.smallest_spacing()),
        topology: if args.guards {
            Topology::Preserve
        } else {
            Topology::Free
        },
        alpha: if recipe.feature.is_some() { 0.3 } else { 0.0 },
        feature_range: recipe.feature.as_ref().map_or([0.0, 1.0], |(_, range)| *range),
        ..CutParams::paper(-1.0)
    }
}

fn print(line: &impl Serialize) -> Result<(), BenchError> {
    let mut text = serde_json::to_vec(line).map_err(std::io::Error::from)?;
    text.push(b'\n');
    Ok(super::print(&text)?)
}

/// Runs the benchmark, and prints a line for each case.
///
/// # Errors
/// [`BenchError`], after the lines of earlier cases.
pub fn run(args: &Args) -> Result<(), BenchError> {
    let recipes: Vec<Recipe> = args
        .volume
        .iter()
        .flat_map(|name| name.recipes(&args.size, &args.types))
        .collect();
    let files = stream::camera::open(&args.file)?;
    stages(args, &recipes)?;
    // Come last, after `stages` has closed its engine: the server of `stream` and `camera` has another engine, and PoCL 3.1 fails with two
    // in one process.
    if args.wants(CaseName::Stream) {
        recipes.iter().try_for_each(|recipe| stream::run(args, recipe))?;
    }
    if args.wants(CaseName::Camera) {
        stream::camera::run(args, &recipes, files)?;
    }
    Ok(())
}

/// Prints the line of the device, saves the volumes if that was requested, and runs all cases except `stream` and `camera`.
fn stages(args: &Args, recipes: &[Recipe]) -> Result<(), BenchError> {
    let engine = args.device.open()?;
    let speed = engine.measure()?;
    let info = engine.device();
    print(&DeviceLine {
        version: env!("CARGO_PKG_VERSION"),
        device: info.name.clone(),
        platform: info.platform.clone(),
        driver: info.driver.clone(),
        memory_bytes: info.memory_bytes,
        max_allocation_bytes: info.max_allocation_bytes,
        compute_units: info.compute_units,
        threads: rayon::current_num_threads(),
        copy_gb_s: speed.copy_bytes_per_second / 1e9,
        copied_bytes: speed.copied_bytes,
        launch_us: speed.launch_seconds * 1e6,
        launch_and_wait_us: speed.launch_and_wait_seconds * 1e6,
    })?;
    for recipe in recipes {
        if let Some(folder) = &args.save {
            recipe.save(&engine, &recipe.generate(&engine)?, folder)?;
        }
        if args.wants_stages() {
            reference::check_watertight(&engine, args, recipe)?;
            cases::run(&engine, &speed, args, recipe)?;
        }
    }
    Ok(())
}
