//! `isopeel slice`: writes a plane of samples, or contours.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use isopeel_extraction::WorkError;
use isopeel_extraction::fields;
use isopeel_volumes::{Dataset, Field, Frame, ReadError, UnknownStep, VolumeStep, open_dataset};

use crate::cli::device::DeviceArgs;
use crate::cli::output::{Output, OutputError};
use crate::cli::stdin::InputPath;
use crate::export::slice::{Axis, BadSlice, Plane, SliceFormat, SliceOptions, load_slice};
use crate::pool::{self, Panicked};
use crate::service::DeviceWorker;

/// Arguments of `isopeel slice`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume, as of extract; -: stdin
    #[arg(value_name = "PATH")]
    path: PathBuf,

    /// Axis that is perpendicular to the plane
    #[arg(long, value_enum, value_name = "AXIS")]
    axis: Axis,

    /// Index of the plane along the axis, counted from 0
    #[arg(long, value_name = "N")]
    index: u32,

    /// Field, or an expression over fields [default: the first]
    #[arg(long, value_name = "NAME")]
    field: Option<String>,

    /// Time step, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    step: u32,

    /// Isovalues of the contours in an SVG or GeoJSON file, up to 64: `300,900`
    #[arg(long, value_name = "V,…", value_delimiter = ',', allow_negative_numbers = true)]
    iso: Vec<f32>,

    /// Width of the range of values between black and white in a PNG, in the field's unit [default: the field's range]
    #[arg(long, value_name = "W")]
    window: Option<f32>,

    /// Value in the middle between black and white in a PNG [default: the middle of the field's range]
    #[arg(long, value_name = "L", allow_negative_numbers = true)]
    level: Option<f32>,

    /// Frame of all positions, as of extract
    #[arg(long, value_name = "FRAME", default_value = "LPS")]
    frame: Frame,

    #[command(flatten)]
    pub(super) device: DeviceArgs,

    /// File to write; its extension is the format: .png, .nrrd, .nii and .nii.gz (the samples with their place), .raw, .svg or .geojson (contours); -: stdout, with
    /// --format
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,

    /// Format of the file [default: what the file's name says]
    #[arg(long, value_enum, value_name = "FORMAT")]
    format: Option<SliceFormat>,
}

/// Why the command has failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SliceError {
    /// The volume cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The volume has no such step.
    #[error(transparent)]
    Step(#[from] UnknownStep),
    /// The volume has no such plane, or the options do not apply to it.
    #[error(transparent)]
    Slice(#[from] BadSlice),
    /// No format is given, and the file name does not imply one.
    #[error(
        "{0:?} does not say the format: expected a name that ends in .png, .nrrd, .nii, .nii.gz, .raw, .svg or .geojson, or --format"
    )]
    NoFormat(PathBuf),
    /// The volume has no such field.
    #[error("no field {name:?}, expected an expression or one of {known}")]
    NoField {
        /// The requested name.
        name: String,
        /// Names of all fields, separated by commas.
        known: String,
    },
    /// Work on the device failed.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The picture cannot be encoded.
    #[error("the picture could not be made")]
    Picture(#[from] png::EncodingError),
    /// The task that makes the file panicked.
    #[error(transparent)]
    Panicked(#[from] Panicked),
    /// A thread could not be started.
    #[error("the process could not go on")]
    System(#[from] io::Error),
}

/// Writes a plane of a volume, or contours on it.
///
/// # Errors
/// [`SliceError`].
pub fn run(args: &Args) -> Result<(), SliceError> {
    let format = args.format.or_else(|| SliceFormat::from_path(&args.output));
    let options = SliceOptions {
        format: format.ok_or_else(|| SliceError::NoFormat(args.output.clone()))?,
        isovalues: args.iso.clone(),
        window: args.window,
        level: args.level,
    };
    let input = InputPath::new(&args.path)?;
    let mut dataset = open_dataset(input.path()).map_err(|error| input.name_in(error))?;
    dataset.set_frame(args.frame);
    let dataset = Arc::new(dataset);
    let field = args.field_of(&dataset)?;
    let types = dataset.fields.iter().map(|field| field.sample_type).collect();
    let volume = VolumeStep::new(dataset, args.step)?;
    let plane = Plane::new(&volume, field, args.axis, args.index)?;
    plane.check(&options)?;
    // Created before the device is opened, so that a folder that is not writable is reported at once.
    let output = Output::create(&args.output)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let file = runtime.block_on(async {
        let worker = DeviceWorker::start_with(args.device.options(types, |text| tracing::info!("{text}")))?;
        worker.ready().await?;
        let (slice, range) = load_slice(&worker, &volume, &plane, &options).await?;
        Ok::<_, SliceError>(pool::run(move || plane.file(slice, &options, range)).await??)
    })?;
    Ok(output.write_bytes(&file)?)
}

impl Args {
    fn field_of(&self, dataset: &Dataset) -> Result<Field, SliceError> {
        let field = match &self.field {
            None => dataset.fields.first().cloned(),
            Some(name) => fields::field_or_computed(dataset, name),
        };
        field.ok_or_else(|| {
            let names: Vec<String> = dataset.field_names().iter().map(|name| format!("{name:?}")).collect();
            SliceError::NoField {
                name: self.field.clone().unwrap_or_default(),
                known: names.join(", "),
            }
        })
    }
}
