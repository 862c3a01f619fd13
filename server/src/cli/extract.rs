//! `isopeel extract`

use std::fs::File;
use std::io::{self, BufWriter, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::ArgGroup;
use isopeel_kernels::MAX_LEVEL;
use tempfile::NamedTempFile;
use tokio_util::sync::CancellationToken;

use crate::api::extras;
use crate::budget;
use crate::device_worker::{DeviceWorker, Extraction, UnknownStep, VolumeStep, WorkError};
use crate::edit::{Edit, EditError, TransferFunctionJson, View};
use crate::export::{self, ExportError, Format, Mesh};
use crate::quality::{MaxError, MesherName, TopologyName};
use crate::statistics::Statistics;
use crate::volumes::{Dataset, ReadError, open_dataset};

/// Weight of the feature where one is chosen and `--alpha` is not given; the viewer opens with it too.
const FEATURE_ALPHA: f32 = 0.3;
/// Largest transfer function file in bytes: 64 points are some 4 KiB.
const MAX_TRANSFER_FUNCTION_BYTES: u64 = 1 << 20;
/// Written at once.
const BUFFER_BYTES: usize = 1 << 20;

/// Arguments of `isopeel extract`.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("result").args(["output", "stats"]).required(true).multiple(true)))]
pub struct Args {
    /// Volume: a file, or a folder whose files share one grid and become the fields of one dataset
    #[arg(value_name = "PATH")]
    path: PathBuf,

    /// Isovalue, in the field's units
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    iso: f32,

    /// Field whose isosurface is extracted [default: the main one]
    #[arg(long, value_name = "NAME")]
    field: Option<String>,

    /// Feature that matters beside smoothness: the name of a field, or `gradient-magnitude` [default: none]
    #[arg(long, value_name = "NAME")]
    feature: Option<String>,

    /// Feature values that become 0 and 1, in the feature's units [default: the feature's least and greatest value]
    #[arg(long, num_args = 2, value_names = ["LO", "HI"], allow_negative_numbers = true, requires = "feature")]
    feature_range: Option<Vec<f32>>,

    /// Weight of the feature against smoothness, 0 to 1 [default: 0.3 with --feature, else 0]
    #[arg(long, value_name = "A", allow_negative_numbers = true)]
    alpha: Option<f32>,

    /// Importance up to which the surface is decimated, 0 to 1; below 0 gives the full surface. Given, it means exactly
    /// that cut: the guards --max-error and --topology are off unless they are given too [default: 0.02, guards on]
    #[arg(long, value_name = "B", allow_negative_numbers = true, group = "quality")]
    beta: Option<f32>,

    /// The most triangles, instead of --beta: the β whose surface comes nearest below is found (`beta` in --stats)
    #[arg(long, value_name = "N", group = "quality", value_parser = clap::value_parser!(u64).range(1..))]
    triangles: Option<u64>,

    /// The most bytes that the surface may take on the wire of `isopeel serve`, instead of --beta; files are larger
    #[arg(long, value_name = "N", group = "quality", value_parser = clap::value_parser!(u64).range(1..))]
    bytes: Option<u64>,

    /// Guard: farthest that a decimated cube's vertex may be from the surface it stands for, root mean square, in world
    /// units or as multiples of the smallest spacing (0.25vx), or `none` [default: 0.25vx; with --beta: none]
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    max_error: Option<MaxError>,

    /// Guard: whether decimation may change the topology [default: preserve; with --beta: free]
    #[arg(long, value_name = "TOPOLOGY")]
    topology: Option<TopologyName>,

    /// Which mesher turns the cut into triangles
    #[arg(long, value_name = "MESHER", default_value = "dual")]
    mesher: MesherName,

    /// Close surfaces that leave the volume on its faces; the dual mesher alone can
    #[arg(long)]
    cap: bool,

    /// Simplify the surface once more by quadric edge collapse: to the --triangles asked for, else as far as the error
    /// guard allows (0.25vx where it is off)
    #[arg(long)]
    polish: bool,

    /// Transfer function, JSON as `{"points":[{"x":0,"importance":0,"color":"#3465a4"}, …]}`, x and importance 0 to 1; a
    /// GLB gets its colours [default: importance is the blended feature itself]
    #[arg(long, value_name = "FILE.json")]
    transfer_function: Option<PathBuf>,

    /// Coarsest level, 0 to 5: cubes of up to 2^L cells per axis
    #[arg(long, value_name = "L", default_value_t = MAX_LEVEL.get(), value_parser = clap::value_parser!(u8).range(..=i64::from(MAX_LEVEL.get())))]
    max_level: u8,

    /// Time step, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    step: u32,

    /// OpenCL device: an index or a part of a name, as `isopeel devices` lists them [default: the first]
    #[arg(long, value_name = "SEL")]
    device: Option<String>,

    /// File to write, in world units; its extension is the format: .glb, .ply or .stl
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
    /// The volume's file is at fault.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The volume has no such step.
    #[error(transparent)]
    Step(#[from] UnknownStep),
    /// A value out of its range.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The device, or what it was asked for.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The surface does not fit its format.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The transfer function's file is at fault.
    #[error("transfer function {}", path.display())]
    TransferFunction {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// The output's file cannot be written.
    #[error("output {}", path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Stdout took no more, or the process got no thread or signal handler.
    #[error("the process could not go on")]
    System(#[from] io::Error),
    /// Ctrl-C.
    #[error("interrupted, nothing was written")]
    Interrupted,
}

/// Extracts one surface. Whatever goes wrong, no file is left behind that was not there before.
///
/// # Errors
/// [`ExtractError`].
pub fn run(args: &Args) -> Result<(), ExtractError> {
    let format = args.output.as_deref().map(Format::from_path).transpose()?;
    let dataset = Arc::new(open_dataset(&args.path)?);
    let view = args.view(&dataset)?;
    let volume = VolumeStep::new(dataset, args.step)?;
    // Before the work: a folder that cannot be written should not cost the time of an extraction.
    let output = match (&args.output, format) {
        (Some(path), Some(format)) => Some(Output::create(path, format)?),
        _ => None,
    };
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
            // It was done before the signal reached it.
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
    let worker = DeviceWorker::start(args.device.clone())?;
    let device = worker.ready().await?;
    progress.say(&format!("extracting on {}", device.name.trim()));
    let extraction = budget::extract(&worker, &volume, &view, u64::MAX, &token).await?;
    let statistics = Statistics::new(
        &extraction.surface.statistics,
        &extraction.view,
        volume.dataset().geometry.spacing,
        extraction.wall,
        &device.name,
    );
    if let Some(output) = output {
        progress.say(&format!(
            "writing {} triangles to {}",
            statistics.triangles,
            output.path.display()
        ));
        let colored = args.transfer_function.is_some();
        let about = (volume, statistics.clone());
        // Off this thread, which has Ctrl-C to listen to.
        let written = tokio::task::spawn_blocking(move || output.write(extraction, about, colored, &token));
        written.await.map_err(io::Error::from)??;
    }
    if args.stats {
        let mut line = serde_json::to_string(&statistics).map_err(io::Error::from)?;
        line.push('\n');
        super::print(line.as_bytes())?;
    }
    progress.say("done");
    Ok(())
}

impl Args {
    /// The view that the arguments describe: from the command's own defaults, so that it depends on nothing else.
    fn view(&self, dataset: &Dataset) -> Result<View, ExtractError> {
        let defaults = View::plain(dataset);
        let feature_alpha = self.feature.as_ref().map(|_| FEATURE_ALPHA);
        let edit = Edit {
            iso: Some(self.iso),
            field: self.field.clone(),
            feature: self.feature.clone(),
            feature_range: self.feature_range.as_deref().and_then(|range| range.try_into().ok()),
            alpha: self.alpha.or(feature_alpha),
            beta: self.beta,
            triangles: self.triangles,
            bytes: self.bytes,
            max_error: self.max_error,
            topology: self.topology,
            mesher: Some(self.mesher),
            cap: Some(self.cap),
            polish: Some(self.polish),
            max_level: Some(self.max_level),
            transfer_function: self
                .transfer_function
                .as_deref()
                .map(read_transfer_function)
                .transpose()?,
        };
        Ok(defaults.apply(&edit.alone(), dataset)?)
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

/// The output while it is made: a file beside it that takes its place when all is written, or goes.
struct Output {
    path: PathBuf,
    format: Format,
    file: NamedTempFile,
}

impl Output {
    fn create(path: &Path, format: Format) -> Result<Self, ExtractError> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let mut builder = tempfile::Builder::new();
        builder.prefix(".isopeel-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // What any new file gets: the umask takes its share of it.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let create = || {
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            builder.tempfile_in(folder.unwrap_or(Path::new(".")))
        };
        let file = create().map_err(|source| ExtractError::Output {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            format,
            file,
        })
    }

    fn write(
        mut self,
        extraction: Extraction,
        (volume, statistics): (VolumeStep, Statistics),
        colored: bool,
        token: &CancellationToken,
    ) -> Result<(), ExtractError> {
        let geometry = volume.dataset().geometry.of_view(&extraction.view);
        let mut mesh = Mesh::new(&extraction.surface, &geometry)?;
        if colored && self.format == Format::Glb {
            mesh.colorize(&extraction.view.transfer_function, extraction.view.alpha);
        }
        let extras = extras(
            &volume.dataset().id,
            volume.step(),
            &extraction.view.to_edit(),
            &statistics,
        );
        let file = Interruptible {
            file: self.file.as_file_mut(),
            token,
        };
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, file);
        let written = export::write(&mesh, self.format, &extras, &mut out).and_then(|()| Ok(out.flush()?));
        drop(out);
        match written {
            Ok(()) => {}
            Err(ExportError::Io(source)) => {
                return Err(ExtractError::Output {
                    path: self.path,
                    source,
                });
            }
            Err(other) => return Err(other.into()),
        }
        self.file.persist(&self.path).map_err(|error| ExtractError::Output {
            path: self.path,
            source: error.error,
        })?;
        Ok(())
    }
}

/// A file that takes no more once the token says stop.
struct Interruptible<'a> {
    file: &'a mut File,
    token: &'a CancellationToken,
}

impl Write for Interruptible<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.token.is_cancelled() {
            // Not `Interrupted`, after which writers try again.
            return Err(io::Error::other("interrupted"));
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// What is being done, on stderr where that is a terminal.
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
mod tests {
    use clap::Parser;

    use super::super::{Cli, Command};
    use super::*;
    use crate::edit::FeatureName;
    use crate::volumes::{Field, Geometry, Samples, Source};

    fn parse(line: &str) -> Result<Args, clap::Error> {
        match Cli::try_parse_from(line.split_whitespace())?.command {
            Command::Extract(args) => Ok(args),
            other => panic!("{other:?}"),
        }
    }

    #[derive(Debug)]
    struct Nothing;

    impl Source for Nothing {
        fn load(&self, _: u32) -> Result<Samples, ReadError> {
            Ok(Samples::U8(vec![0; 8]))
        }
    }

    fn dataset() -> Dataset {
        let field = |name: &str| Field {
            name: name.into(),
            stored_type: "uint8".into(),
            sample_type: isopeel_kernels::SampleType::U8,
            missing: None,
            unit: None,
            source: Arc::new(Nothing),
        };
        Dataset {
            id: "head".into(),
            title: "Head".into(),
            geometry: Geometry {
                dims: [2; 3],
                spacing: [1.0; 3],
                origin: [0.0; 3],
                direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            },
            steps: 1,
            fields: vec![field("t1"), field("gm")],
            notice: None,
            opening: Some(Edit {
                alpha: Some(0.9),
                ..Edit::default()
            }),
        }
    }

    #[test]
    fn negative_numbers_are_values() {
        let args =
            parse("isopeel extract a.nrrd --iso -300 --beta -1 --feature gm --feature-range -5 -2.5 --stats").unwrap();
        assert_eq!((args.iso, args.beta), (-300.0, Some(-1.0)));
        assert_eq!(args.feature_range, Some(vec![-5.0, -2.5]));
    }

    #[test]
    fn a_result_must_be_asked_for_and_ranges_hold() {
        for line in [
            "isopeel extract a.nrrd --iso 1",
            "isopeel extract a.nrrd --stats",
            "isopeel extract a.nrrd --iso 1 --stats --max-level 6",
            "isopeel extract a.nrrd --iso 1 --stats --feature gm --feature-range 1",
            "isopeel extract a.nrrd --iso 1 --stats --feature-range 1 2",
        ] {
            assert!(parse(line).is_err(), "{line}");
        }
    }

    #[test]
    fn beta_alone_means_the_papers_cut_and_all_else_is_guarded() {
        let (off, on) = (
            (MaxError::None, TopologyName::Free),
            (MaxError::Spacings(0.25), TopologyName::Preserve),
        );
        for (options, expected) in [
            ("", on),
            ("--beta 0.02", off),
            ("--mesher marching-cubes --beta 0.02", off),
            ("--triangles 1000", on),
            ("--bytes 1000", on),
            ("--max-error 0.5", (MaxError::World(0.5), TopologyName::Preserve)),
            (
                "--beta 0.02 --max-error 0.1vx",
                (MaxError::Spacings(0.1), TopologyName::Free),
            ),
            (
                "--beta 0.02 --topology preserve",
                (MaxError::None, TopologyName::Preserve),
            ),
            ("--triangles 9 --max-error none --topology free", off),
        ] {
            let args = parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).unwrap();
            let view = args.view(&dataset()).unwrap();
            assert_eq!((view.max_error, view.topology), expected, "{options}");
        }
        for options in [
            "--beta 1 --triangles 1",
            "--triangles 0",
            "--max-error -1",
            "--max-error x",
            "--bytes 1 --beta 1",
        ] {
            assert!(
                parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).is_err(),
                "{options}"
            );
        }
    }

    #[test]
    fn without_a_feature_smoothness_alone_decides() {
        let view = parse("isopeel extract a.nrrd --iso 517 --stats")
            .unwrap()
            .view(&dataset())
            .unwrap();
        assert_eq!(
            (view.field.as_str(), view.feature.clone(), view.alpha),
            ("t1", FeatureName::None, 0.0)
        );
        assert_eq!((view.beta, view.max_level), (0.02, MAX_LEVEL));
        let view = parse("isopeel extract a.nrrd --iso 517 --stats --feature gm")
            .unwrap()
            .view(&dataset())
            .unwrap();
        assert_eq!(
            (view.feature, view.alpha),
            (FeatureName::Field("gm".into()), FEATURE_ALPHA)
        );
    }

    #[test]
    fn what_the_dataset_has_not_is_named() {
        for (options, expected) in [
            ("--field t2", "field: \"t2\", expected one of \"t1\", \"gm\""),
            ("--alpha 2", "alpha: 2, expected 0 to 1"),
            (
                "--feature gm --feature-range 2 1",
                "featureRange: [2, 1], expected two finite numbers",
            ),
            ("--beta nan", "beta: NaN, expected a finite number"),
        ] {
            let args = parse(&format!("isopeel extract a.nrrd --iso 1 --stats {options}")).unwrap();
            let error = args.view(&dataset()).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{options}: {error}");
        }
    }

    #[test]
    fn a_transfer_function_is_read_or_its_file_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        std::fs::write(&path, r##"{"points":[{"x":0.5,"importance":1,"color":"#ffffff"}]}"##).unwrap();
        assert_eq!(read_transfer_function(&path).unwrap().points.len(), 1);
        std::fs::write(&path, r#"{"points":[{"x":0.5}]}"#).unwrap();
        let error = super::super::chain(&read_transfer_function(&path).unwrap_err());
        assert!(error.contains("t.json: missing field `importance`"), "{error}");
        let error = super::super::chain(&read_transfer_function(&folder.path().join("no.json")).unwrap_err());
        assert!(error.contains("no.json: No such file"), "{error}");
    }

    #[test]
    fn an_output_that_cannot_be_written_fails_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(
            Output::create(folder.path(), Format::Glb),
            Err(ExtractError::Output { .. })
        ));
        let missing = folder.path().join("no/such/a.glb");
        assert!(matches!(
            Output::create(&missing, Format::Glb),
            Err(ExtractError::Output { .. })
        ));
        let error = Format::from_path(Path::new("head.obj")).unwrap_err().to_string();
        assert_eq!(
            error,
            "\"head.obj\" does not say the format: expected a name that ends in .glb, .ply or .stl"
        );
    }

    fn extraction(view: View) -> Extraction {
        Extraction {
            surface: isopeel_kernels::Surface {
                regions: Vec::new(),
                prefix: isopeel_kernels::Level::FINEST,
                statistics: isopeel_kernels::Statistics::default(),
            },
            view,
            wall: std::time::Duration::ZERO,
        }
    }

    #[test]
    fn the_output_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let view = parse("isopeel extract a.nrrd --iso 1 --stats")
            .unwrap()
            .view(&dataset())
            .unwrap();
        let volume = VolumeStep::new(Arc::new(dataset()), 0).unwrap();
        let about = || (volume.clone(), Statistics::default());
        let files = || std::fs::read_dir(folder.path()).unwrap().count();

        let stopped = CancellationToken::new();
        stopped.cancel();
        let output = Output::create(&path, Format::Glb).unwrap();
        assert!(output.write(extraction(view.clone()), about(), true, &stopped).is_err());
        assert_eq!(files(), 0);

        let output = Output::create(&path, Format::Glb).unwrap();
        assert_eq!(files(), 1);
        output
            .write(extraction(view), about(), true, &CancellationToken::new())
            .unwrap();
        assert_eq!(files(), 1);
        assert_eq!(&std::fs::read(&path).unwrap()[..4], b"glTF");
    }
}
