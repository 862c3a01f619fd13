//! Follows a job by its events. Reconnects after a lost connection or a restart of the server.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::JobsError;
use super::client::Client;
use crate::jobs::{JobEvent, JobInfo};

/// Time between attempts to reconnect.
const PAUSE: Duration = Duration::from_secs(1);
/// Maximum attempts to reconnect. A restarted server is ready within a minute.
const MAX_ATTEMPTS: u32 = 60;

/// Follows a job to its end, with a progress bar if stderr is a terminal.
pub(super) async fn watch(client: &Client, id: &str) -> Result<JobInfo, JobsError> {
    let job = client.job(id).await?;
    let bar = bar(job.extractions.total);
    let (mut last, mut attempts) = ("0".to_owned(), 0);
    loop {
        let followed = follow(client, id, &mut last, &bar).await;
        // The stream of events ends when the job is finished, and when the server shuts down. So asks for the state of the job.
        let job = client.job(id).await;
        if let Ok(job) = &job {
            bar.set_position(job.extractions.ended());
        }
        match (followed, job) {
            (_, Ok(job)) if job.state.is_finished() => {
                bar.finish_and_clear();
                return Ok(job);
            }
            // The server responds.
            (Ok(()), Ok(_)) => attempts = 0,
            (Err(error), Ok(_)) if error.is_transient() => attempts = 0,
            (Err(error), _) | (_, Err(error)) if !error.is_transient() || attempts == MAX_ATTEMPTS => {
                return Err(error);
            }
            _ => attempts += 1,
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Follows one stream of events to its end. `last` is the id of the last complete event.
async fn follow(client: &Client, id: &str, last: &mut String, bar: &ProgressBar) -> Result<(), JobsError> {
    let Some(mut response) = client.events(id, last).await? else {
        return Ok(());
    };
    let (mut text, mut current_id) = (Vec::new(), None);
    while let Some(bytes) = response.chunk().await.map_err(|error| client.connection_error(error))? {
        text.extend_from_slice(&bytes);
        while let Some(end) = text.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = text.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            if let Some(number) = line.strip_prefix("id:") {
                current_id = Some(number.trim().to_owned());
            } else if let Some(data) = line.strip_prefix("data:") {
                let event: JobEvent = client.parse(data.trim().as_bytes())?;
                bar.set_position(event.extractions.ended());
                bar.set_message(
                    event
                        .paused
                        .map_or(event.state.name().into(), |why| format!("paused: {why}")),
                );
            } else if line.trim_end().is_empty()
                && let Some(id) = current_id.take()
            {
                // An empty line ends an event. If the connection breaks before that, the server sends the event again.
                *last = id;
            }
        }
    }
    Ok(())
}

/// Returns a progress bar for this number of extractions. It is visible only if stderr is a terminal.
pub(crate) fn bar(extractions: u64) -> ProgressBar {
    let bar = ProgressBar::new(extractions);
    // Cannot fail: a test checks the template.
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
