//! The commands of the binary.

pub mod batch;
pub mod bench;
mod control_group;
pub mod device;
pub mod devices;
pub mod extract;
pub mod info;
pub mod jobs;
pub mod limits;
pub mod log;
mod output;
pub mod serve;
pub mod settings;
mod slice;
mod stdin;
mod surface;
pub mod token;
mod worker;

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{CommandFactory, Parser, Subcommand};
use tracing_subscriber::filter::LevelFilter;

use crate::error::BoxError;
use crate::pool;
use crate::service::process::Confined;
use stdin::InputPath;

/// Isosurfaces of volumes, decimated by importance before they are made.
#[derive(Debug, Parser)]
#[command(name = "isopeel", version, max_term_width = 110)]
pub struct Cli {
    /// How lines of the log are written; `RUST_LOG` says which
    #[arg(long, global = true, value_name = "FORMAT", value_enum, default_value_t = LogFormat::Text, env = "ISOPEEL_LOG_FORMAT")]
    pub log_format: LogFormat,

    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// How lines of the log are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// An object of JSON each, for programs.
    Json,
}

impl LogFormat {
    /// Returns the arguments of a process that writes its log in this format.
    fn arguments(self) -> Vec<String> {
        let name = match self {
            Self::Text => "text",
            Self::Json => "json",
        };
        vec!["--log-format".to_owned(), name.to_owned()]
    }
}

/// A command with its arguments.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve volumes to browsers and programs over HTTP and WebSocket, until ctrl-c
    Serve(Box<serve::Args>),
    /// Extract one isosurface to a file, or count its triangles
    Extract(Box<extract::Args>),
    /// Submit, follow and fetch batch jobs of a server that keeps some (--state-folder)
    Jobs(jobs::Args),
    /// Make, list and revoke the tokens that a server with a --state-folder lets people and programs in by
    Token(token::Args),
    /// Extract isosurfaces of many volumes and time steps to files, without a server; interrupted, the same command goes on
    Batch(Box<batch::Args>),
    /// Write a plane of a volume as a picture or NRRD, or contours on it as SVG or GeoJSON
    Slice(slice::Args),
    /// Say what a volume is: dimensions, type, spacing, range and histogram of every field
    Info(InfoArgs),
    /// List the OpenCL devices, the preferred one first; with --check, say which of them compute rightly
    Devices(devices::Args),
    /// Print completions for a shell: `isopeel completions bash > ~/.local/share/bash-completion/completions/isopeel`
    Completions(CompletionsArgs),
    /// Write manual pages, one of each command, into a folder
    Manual(ManualArgs),
    /// Time every stage on volumes made on the device, against the device's own speed; one JSON object a line
    Bench(bench::Args),
    /// Use a device for a server, which starts this command
    #[command(hide = true)]
    Worker(worker::Args),
}

/// Arguments of `isopeel info`.
#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// Volume: a file, a folder whose files share one grid, or the address of a Zarr store (https://, http://, s3://) or of a volume of
    /// Neuroglancer (precomputed://https://…); -: stdin
    #[arg(value_name = "PATH")]
    path: PathBuf,

    /// Print one JSON object, with whole histograms
    #[arg(long)]
    json: bool,
}

/// Arguments of `isopeel completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell
    #[arg(value_enum, value_name = "SHELL")]
    shell: clap_complete::Shell,
}

/// Arguments of `isopeel manual`.
#[derive(Debug, clap::Args)]
pub struct ManualArgs {
    /// Folder, made if there is none
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

fn completions(args: &CompletionsArgs) -> io::Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "isopeel", &mut text);
    print(&text)
}

fn manual(args: &ManualArgs) -> io::Result<()> {
    std::fs::create_dir_all(&args.folder)?;
    clap_mangen::generate_to(Cli::command(), &args.folder)
}

impl Command {
    /// Whether the command loads device drivers.
    pub fn uses_device(&self) -> bool {
        match self {
            Self::Serve(_) | Self::Extract(_) | Self::Batch(_) | Self::Slice(_) | Self::Devices(_) | Self::Bench(_) => {
                true
            }
            // The server has prepared the folders of the driver for its worker.
            Self::Worker(_) => false,
            Self::Jobs(_) | Self::Token(_) | Self::Info(_) | Self::Completions(_) | Self::Manual(_) => false,
        }
    }

    /// Confines this process if it is the process of a server's device. Comes before other threads are started, which would not be confined.
    pub fn confine(&self) -> Confined {
        match self {
            Self::Worker(args) => worker::confine(args),
            _ => Confined::NotWanted,
        }
    }

    /// Returns the log level that applies if `RUST_LOG` is not set.
    pub fn default_log(&self) -> LevelFilter {
        match self {
            Self::Worker(args) => args.log_level,
            Self::Serve(_) => LevelFilter::INFO,
            Self::Extract(_)
            | Self::Slice(_)
            | Self::Jobs(_)
            | Self::Token(_)
            | Self::Batch(_)
            | Self::Info(_)
            | Self::Devices(_)
            | Self::Completions(_)
            | Self::Manual(_)
            | Self::Bench(_) => LevelFilter::WARN,
        }
    }
}

/// Runs a command.
///
/// # Errors
/// The error of the command. The caller prints it.
pub fn run(cli: Cli) -> Result<(), BoxError> {
    pool::start()?;
    // `serve` has an option for it.
    if cli.command.uses_device() && !matches!(cli.command, Command::Serve(_)) {
        control_group::limit_memory(None);
    }
    let log_arguments = [cli.log_format.arguments(), worker::log_level(cli.command.default_log())].concat();
    match cli.command {
        Command::Serve(args) => Ok(serve::run(&args, &log_arguments)?),
        Command::Extract(args) => Ok(args.device.or_restart(extract::run(&args))?),
        Command::Slice(args) => Ok(args.device.or_restart(slice::run(&args))?),
        Command::Jobs(args) => Ok(jobs::run(&args)?),
        Command::Token(args) => Ok(token::run(&args)?),
        Command::Batch(args) => Ok(args.device.or_restart(batch::run(&args))?),
        Command::Info(args) => print_info(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Completions(args) => Ok(completions(&args)?),
        Command::Manual(args) => Ok(manual(&args)?),
        Command::Worker(args) => worker::run(&args),
        Command::Bench(args) => Ok(args.device.or_restart(bench::run(&args))?),
    }
}

/// Runs `isopeel info`.
fn print_info(args: &InfoArgs) -> Result<(), BoxError> {
    let (mut text, input) = (Vec::new(), InputPath::new(&args.path)?);
    let outcome = if args.json {
        info::run_json(input.path(), &mut text)
    } else {
        info::run(input.path(), &mut text)
    };
    outcome.map_err(|error| match error {
        info::InfoError::Read(error) => info::InfoError::Read(input.name_in(error)),
        error => error,
    })?;
    Ok(print(&text)?)
}

/// Exit code of `isopeel extract` if the surface has no triangles and `--allow-empty` is not given.
const EXIT_EMPTY: u8 = 3;

/// Returns the exit code of a command that ended with an error.
pub fn exit_code(error: &(dyn std::error::Error + 'static)) -> u8 {
    match error.downcast_ref() {
        Some(extract::ExtractError::Empty(_)) => EXIT_EMPTY,
        _ => 1,
    }
}

/// Prints to stdout. A closed pipe, as in `isopeel devices | head -1`, is not an error.
pub(crate) fn print(text: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_surface_has_an_exit_code_of_its_own() {
        assert_eq!(exit_code(&extract::ExtractError::Empty("no surface".into())), 3);
        assert_eq!(exit_code(&extract::ExtractError::Interrupted), 1);
    }

    #[test]
    fn completions_and_manual_know_the_options() {
        let mut text = Vec::new();
        clap_complete::generate(clap_complete::Shell::Bash, &mut Cli::command(), "isopeel", &mut text);
        assert!(String::from_utf8(text).unwrap().contains("--allow-empty"));
        let folder = tempfile::tempdir().unwrap();
        let args = ManualArgs {
            folder: folder.path().join("man"),
        };
        manual(&args).unwrap();
        let page = std::fs::read_to_string(args.folder.join("isopeel-extract.1")).unwrap();
        assert!(page.contains("allow\\-empty"), "{page}");
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_option_has_help() {
        let cli = Cli::command();
        let commands = cli.get_subcommands();
        for command in commands.flat_map(|command| [command].into_iter().chain(command.get_subcommands())) {
            assert!(command.get_about().is_some(), "{}", command.get_name());
            for argument in command.get_arguments() {
                assert!(
                    argument.get_help().is_some(),
                    "{} {}",
                    command.get_name(),
                    argument.get_id()
                );
            }
        }
    }
}
