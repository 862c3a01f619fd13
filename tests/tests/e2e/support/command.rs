//! The command line, run as a user runs it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// The binary under test: `$ISOPEEL_BINARY`, or the server's own `main.rs` as this package builds it (see Cargo.toml).
pub fn binary() -> PathBuf {
    std::env::var_os("ISOPEEL_BINARY").map_or_else(
        || PathBuf::from(env!("CARGO_BIN_EXE_isopeel-under-test")),
        PathBuf::from,
    )
}

/// Runs the binary to its end.
pub fn run<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> Output {
    let mut command = Command::new(binary());
    command
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("the binary starts")
}

/// Runs the binary, which must succeed; returns its stdout.
#[track_caller]
pub fn succeed<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> String {
    let output = run(arguments);
    assert!(
        output.status.success(),
        "{}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("stdout is UTF-8")
}

/// Runs the binary, which must refuse; returns its stderr.
#[track_caller]
pub fn fail<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> String {
    let output = run(arguments);
    let said = String::from_utf8(output.stderr).expect("stderr is UTF-8");
    assert!(matches!(output.status.code(), Some(1 | 2)), "{}: {said}", output.status);
    assert!(!said.contains("panicked"), "{said}");
    said
}

/// `extract ARGUMENTS --stats`: the one JSON object on stdout.
#[track_caller]
pub fn extract<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> Value {
    let arguments = arguments.into_iter().map(|argument| argument.as_ref().to_owned());
    let all = ["extract".into()]
        .into_iter()
        .chain(arguments)
        .chain(["--stats".into()]);
    let printed = succeed(all);
    serde_json::from_str(&printed).unwrap_or_else(|e| panic!("stdout is not one JSON object ({e}): {printed}"))
}

/// `extract VOLUME OPTIONS -o OUT --stats`, the options as a user types them.
#[track_caller]
pub fn extract_to(volume: &Path, options: &str, out: &Path) -> Value {
    let options = options.split_whitespace().map(OsStr::new);
    let output = [OsStr::new("-o"), out.as_os_str()];
    extract([volume.as_os_str()].into_iter().chain(options).chain(output))
}
