//! The `isopeel` binary.

use std::io::{self, Write};
use std::process::ExitCode;

use isopeel::cli::{self, limits, log};
use isopeel::device::cache::{DriverFolders, driver_folders};

fn main() -> ExitCode {
    let cli = match cli::settings::parse() {
        Ok(cli) => cli,
        Err(error) => return failed(&error),
    };
    // Comes first: `driver_folders` writes files, and a write beyond the limit of the file size would end the process.
    if cli.command.uses_device()
        && let Err(error) = limits::check()
    {
        return failed(&error);
    }
    let folders = cli.command.uses_device().then(driver_folders);
    for (name, folder) in folders.iter().flat_map(|folders| &folders.variables) {
        // SAFETY: no other thread is running, because the threads that `limits::check` has started have ended.
        unsafe { std::env::set_var(name, folder) };
    }
    let confined = cli.command.confine();
    log::start(cli.log_format, cli.command.default_log());
    folders.iter().for_each(DriverFolders::warn);
    confined.log();
    let outcome = cli::run(cli);
    log::finish();
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => failed(&*error),
    }
}

fn failed(error: &(dyn std::error::Error + 'static)) -> ExitCode {
    // An error is ignored, because standard error may be closed.
    let _ = writeln!(io::stderr(), "error: {}", isopeel::error::chain(error));
    ExitCode::from(cli::exit_code(error))
}
