//! Failures at start-up: the message names cause and remedy.

use std::process::{Command, Output};

use crate::support::command::binary;
use crate::support::server::has_device;

/// Runs `isopeel serve` in a shell after these lines, to its end, or for this many seconds.
fn serve(lines: &str, variables: &[(&str, &str)], seconds: u32) -> Output {
    // In the foreground `timeout` sends one signal, else a second one within microseconds. LLVM's handler in PoCL leaves the default action for
    // that one, which ends the process at once.
    let script = format!(
        "{lines}\nexec timeout --foreground --preserve-status {seconds} \"$0\" serve --no-auth --listen 127.0.0.1:0"
    );
    let mut command = Command::new("bash");
    command.args(["-c", &script]).arg(binary());
    command.envs(variables.iter().copied());
    command.output().expect("a shell")
}

#[track_caller]
fn refuses(lines: &str, variables: &[(&str, &str)], expected: &[&str]) {
    let output = serve(lines, variables, 60);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{lines}: {said}");
    assert!(!said.contains("panicked"), "{lines}: {said}");
    for part in expected {
        assert!(said.contains(part), "{lines}: {part:?} is missing in {said}");
    }
}

#[test]
fn without_a_driver_the_server_says_which_to_install() {
    let folder = tempfile::tempdir().expect("a folder");
    let vendors = folder.path().to_str().expect("text");
    refuses(
        "",
        &[("OCL_ICD_VENDORS", vendors)],
        &["found no driver", "apt-get install pocl-opencl-icd"],
    );
}

#[test]
fn without_any_folder_for_kernels_the_server_says_which_to_name() {
    if !has_device() {
        return;
    }
    let nowhere = "/proc/nowhere";
    let variables = [("HOME", nowhere), ("TMPDIR", nowhere), ("XDG_CACHE_HOME", nowhere)];
    refuses(
        "unset POCL_CACHE_DIR",
        &variables,
        &["/proc/nowhere", "TMPDIR", "POCL_CACHE_DIR names another one"],
    );
}

#[test]
fn limits_of_the_process_are_named_with_their_remedy() {
    for (lines, expected) in [
        ("ulimit -v 1000000", ["1024000000 bytes of address space", "ulimit -v"]),
        ("ulimit -f 1", ["may have 1024 bytes", "ulimit -f"]),
    ] {
        refuses(lines, &[], &expected);
    }
}

#[test]
fn without_standard_output_the_server_says_so_and_without_standard_error_it_runs() {
    refuses("exec >/dev/full", &[], &["standard output cannot be written"]);
    if !has_device() {
        return;
    }
    for lines in ["exec 2>&-", "exec 2>/dev/full", "exec <&- >&- 2>&-"] {
        let output = serve(lines, &[], 4);
        assert_eq!(output.status.code(), Some(0), "{lines}: SIGTERM ends it");
    }
}
