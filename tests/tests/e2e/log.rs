//! A server whose log cannot be written.

use std::time::Duration;

use crate::support::{http, process};

/// Requests that log more lines than a pipe holds.
const REQUESTS: usize = 1500;

/// Each of these requests is a line of the log.
#[track_caller]
fn answers(process: &process::Process) {
    for request in 0..REQUESTS {
        let answer = http::get(process.address, "/api/v1/nothing");
        assert_eq!(answer.status, 404, "request {request}");
    }
}

#[test]
fn a_server_whose_log_nobody_reads_works_and_ends() {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    let Some(process) = process::start_logging_to(writer.into()) else {
        return;
    };
    answers(&process);
    process.signal("TERM");
    process.ended_within(Duration::from_secs(5));
    drop(reader);
}

#[test]
fn a_server_whose_log_has_no_reader_any_more_works_and_ends() {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    let Some(process) = process::start_logging_to(writer.into()) else {
        return;
    };
    drop(reader);
    answers(&process);
    process.signal("TERM");
    process.ended_within(Duration::from_secs(5));
}
