//! Follows a job by its events, over connections that break and servers that start again.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::JobsError;
use super::client::Client;
use crate::jobs::{JobEvent, JobInfo};

/// Time between attempts to connect again.
const PAUSE: Duration = Duration::from_secs(1);
/// Attempts to connect again before it is given up: a server that starts again is there within a minute.
const MAX_ATTEMPTS: u32 = 60;

/// Follows a job to its end, with a bar on stderr where that is a terminal.
pub(super) async fn watch(client: &Client, id: &str) -> Result<JobInfo, JobsError> {
    let job = client.job(id).await?;
    let bar = bar(job.extractions.total);
    let (mut last, mut attempts) = ("0".to_owned(), 0);
    loop {
        match follow(client, id, &mut last, &bar).await {
            Ok(()) => attempts = 0,
            Err(JobsError::Connection { .. }) if attempts < MAX_ATTEMPTS => {
                attempts += 1;
                tokio::time::sleep(PAUSE).await;
            }
            Err(error) => return Err(error),
        }
        // The stream ends with the job, and with the server.
        match client.job(id).await {
            Ok(job) if job.state.is_finished() => {
                bar.finish_and_clear();
                return Ok(job);
            }
            Ok(job) => {
                if let Some(why) = job.paused {
                    bar.set_message(format!("paused: {why}"));
                }
            }
            Err(JobsError::Connection { .. }) => {}
            Err(error) => return Err(error),
        }
    }
}

/// Follows one stream of events to its end.
async fn follow(client: &Client, id: &str, last: &mut String, bar: &ProgressBar) -> Result<(), JobsError> {
    let Some(mut response) = client.events(id, last).await? else {
        return Ok(());
    };
    let mut text = Vec::new();
    while let Some(bytes) = response.chunk().await.map_err(|error| client.connection(error))? {
        text.extend_from_slice(&bytes);
        while let Some(end) = text.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = text.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            if let Some(number) = line.strip_prefix("id:") {
                *last = number.trim().to_owned();
            } else if let Some(data) = line.strip_prefix("data:") {
                let event: JobEvent = client.parse(data.trim().as_bytes())?;
                bar.set_position(event.extractions.done + event.extractions.failed);
                bar.set_message(event.state.name());
            }
        }
    }
    Ok(())
}

/// A bar of so many extractions, which is drawn where stderr is a terminal.
pub(crate) fn bar(extractions: u64) -> ProgressBar {
    let bar = ProgressBar::new(extractions);
    // A template that is not one would be a fault of this line, and has a test.
    bar.set_style(ProgressStyle::with_template(TEMPLATE).unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

const TEMPLATE: &str = "{wide_bar} {pos}/{len}  {elapsed_precise}, {eta} left  {msg}";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_has_a_template() {
        ProgressStyle::with_template(TEMPLATE).unwrap();
    }
}
