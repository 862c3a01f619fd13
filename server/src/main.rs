//! The `isopeel` binary.

use std::io::{self, Write};
use std::process::ExitCode;

use isopeel::cli::{self, log};

fn main() -> ExitCode {
    for (name, folder) in isopeel::device::cache::driver_folders() {
        // SAFETY: this is the only thread so far.
        unsafe { std::env::set_var(name, folder) };
    }
    let cli = match cli::settings::parse() {
        Ok(cli) => cli,
        Err(error) => return failed(&error),
    };
    log::start(cli.log_format, cli.command.default_log());
    let ended = cli::run(cli);
    log::finish();
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => failed(&*error),
    }
}

fn failed(error: &(dyn std::error::Error + 'static)) -> ExitCode {
    // Standard error may be closed.
    let _ = writeln!(io::stderr(), "error: {}", isopeel::error::chain(error));
    ExitCode::from(cli::exit_code(error))
}
