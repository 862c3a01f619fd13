//! The hidden command `isopeel worker`: the process of a server's device.

use std::os::fd::RawFd;

use tracing_subscriber::filter::LevelFilter;

use super::serve::memory::return_freed_memory;
use crate::error::BoxError;
use crate::service::process::{self, Confined};

/// Arguments of `isopeel worker`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Number of the open file that is the socket to the server
    #[arg(long, value_name = "FILE")]
    socket: RawFd,

    /// Number of the open file that both processes map
    #[arg(long, value_name = "FILE")]
    memory: RawFd,

    /// Least level of the lines of its log, unless RUST_LOG says otherwise
    #[arg(long, value_name = "LEVEL")]
    pub log_level: LevelFilter,

    /// Number of the open file that says what this process may do; without it, it is not confined
    #[arg(long, value_name = "FILE")]
    confinement: Option<RawFd>,
}

/// Returns the arguments for a log with lines of this level and above.
pub(super) fn log_level(level: LevelFilter) -> Vec<String> {
    vec!["--log-level".to_owned(), level.to_string()]
}

/// Confines this process as the server wants. It must have one thread only.
pub fn confine(args: &Args) -> Confined {
    args.confinement.map_or(Confined::NotWanted, process::confine)
}

/// Runs jobs of a server until it ends.
///
/// # Errors
/// The files are not those of a server, or a thread cannot be started.
pub fn run(args: &Args) -> Result<(), BoxError> {
    return_freed_memory();
    process::run(args.socket, args.memory)
}
