//! The `isopeel` binary.

use std::io::{self, IsTerminal};
use std::process::ExitCode;

use isopeel::cli::{self, LogFormat};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    for (name, folder) in isopeel::device::cache::driver_folders() {
        // SAFETY: this is the only thread so far.
        unsafe { std::env::set_var(name, folder) };
    }
    let cli = match cli::settings::parse() {
        Ok(cli) => cli,
        Err(error) => return failed(&error),
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(cli.command.default_log()));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal());
    match cli.log_format {
        LogFormat::Text => log.init(),
        LogFormat::Json => log.json().flatten_event(true).init(),
    }
    match cli::run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => failed(&*error),
    }
}

fn failed(error: &(dyn std::error::Error + 'static)) -> ExitCode {
    eprintln!("error: {}", isopeel::error::chain(error));
    ExitCode::from(cli::exit_code(error))
}
