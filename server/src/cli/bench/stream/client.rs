//! A viewer that reads as fast as it can: it counts chunks and bytes, and decodes nothing.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use isopeel_client::{Connection, Error, RawFrame};
use isopeel_view::Edit;
use serde::{Deserialize, Serialize};
use tokio::time::{Instant, timeout, timeout_at};

use super::StreamError;

/// Longest wait for a frame: a volume of many gigabytes is read and uploaded meanwhile.
const FRAME_TIMEOUT: Duration = Duration::from_secs(300);

/// Time without a frame of a generation after which the server has settled.
const QUIET: Duration = Duration::from_secs(2);

/// A text frame to the server.
#[derive(Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
enum Request<'a> {
    Open { volume: &'a str, step: u32 },
    Edit(&'a Edit),
}

/// Fields of a text frame that the client reads.
#[derive(Deserialize)]
struct Reply<'a> {
    #[serde(rename = "type")]
    kind: &'a str,
    code: Option<String>,
    message: Option<String>,
}

/// Fields of `done` that the client reads.
#[derive(Deserialize)]
struct Done {
    statistics: Statistics,
}

/// Of a generation, by the server.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Statistics {
    pub beta: Option<f32>,
    pub tolerance: Option<f32>,
    pub full_triangles: u64,
    pub triangles: u64,
    pub vertices: u64,
    pub stages_ms: BTreeMap<String, f64>,
    pub wall_ms: f64,
    pub device_bytes: u64,
}

impl Statistics {
    /// Sum of the stages.
    pub fn device_ms(&self) -> f64 {
        self.stages_ms.values().sum()
    }
}

/// One edit from the call to its `done`, with times since the call.
#[derive(Clone, Debug, Default)]
pub struct Streamed {
    /// To `opened`, if the edit came with an `open`.
    pub opened: Option<Duration>,
    /// To the first `committed`; `None` if nothing had to be shown.
    pub first: Option<Duration>,
    /// To `done`.
    pub done: Duration,
    pub prefixes: u64,
    pub chunks: u64,
    pub bytes: u64,
    pub statistics: Statistics,
}

/// Measurements of a viewer while a value was dragged.
#[derive(Clone, Debug, Default)]
pub struct Dragged {
    /// Prefixes committed until one interval after the last edit.
    pub commits: u64,
    /// Maximum time without one, during the drag.
    pub longest_gap: Duration,
    /// From the last edit to the last `done`.
    pub settle: Duration,
    /// Of all chunks, those after the drag included.
    pub bytes: u64,
    /// Of the last `done`.
    pub statistics: Statistics,
    /// Whether a generation has begun and not ended.
    working: bool,
}

/// A viewer's connection.
pub struct Client {
    connection: Connection,
    volume: String,
}

impl Client {
    /// Connects; no volume is open yet.
    pub async fn connect(address: SocketAddr, volume: &str) -> Result<Self, StreamError> {
        Ok(Self {
            connection: Connection::connect(address).await?,
            volume: volume.to_owned(),
        })
    }

    async fn send_open(&mut self, step: u32) -> Result<(), Error> {
        let volume = &self.volume;
        self.connection.send(&Request::Open { volume, step }).await
    }

    async fn next_in_time(&mut self) -> Result<RawFrame, StreamError> {
        let next = timeout(FRAME_TIMEOUT, self.connection.next()).await;
        Ok(next.map_err(|_| StreamError::Silent(FRAME_TIMEOUT))??)
    }

    /// Opens a step and waits for the view that it opens with.
    pub async fn open(&mut self, step: u32) -> Result<Edit, StreamError> {
        #[derive(Deserialize)]
        struct Opened {
            edit: Edit,
        }
        self.send_open(step).await?;
        loop {
            if let RawFrame::Text(text) = self.next_in_time().await?
                && kind(&text)? == "opened"
            {
                let opened: Opened = serde_json::from_str(&text).map_err(Error::from)?;
                return Ok(opened.edit);
            }
        }
    }

    /// Sends an edit and reads to its `done`.
    pub async fn edit(&mut self, edit: &Edit) -> Result<Streamed, StreamError> {
        let start = Instant::now();
        self.connection.send(&Request::Edit(edit)).await?;
        self.read_to_done(start).await
    }

    /// Opens another step and sends an edit right behind, as the protocol allows, and reads to its `done`.
    pub async fn step(&mut self, step: u32, edit: &Edit) -> Result<Streamed, StreamError> {
        let start = Instant::now();
        self.send_open(step).await?;
        self.connection.send(&Request::Edit(edit)).await?;
        self.read_to_done(start).await
    }

    async fn read_to_done(&mut self, start: Instant) -> Result<Streamed, StreamError> {
        let mut seen = Streamed::default();
        loop {
            let text = match self.next_in_time().await? {
                RawFrame::Chunk(chunk) => {
                    seen.chunks += 1;
                    seen.bytes += chunk.len() as u64;
                    continue;
                }
                RawFrame::Text(text) => text,
            };
            let now = start.elapsed();
            match kind(&text)? {
                "opened" => seen.opened = Some(now),
                "committed" => {
                    seen.prefixes += 1;
                    seen.first.get_or_insert(now);
                }
                "done" => {
                    seen.done = now;
                    seen.statistics = statistics(&text)?;
                    return Ok(seen);
                }
                _ => {}
            }
        }
    }

    /// Sends edits in even intervals while it reads, then reads until the server has settled.
    pub async fn drag(&mut self, edits: &[Edit], interval: Duration) -> Result<Dragged, StreamError> {
        let mut seen = Dragged::default();
        let start = Instant::now();
        let (mut last_edit, mut last_commit, mut due) = (start, start, start);
        for edit in edits {
            last_edit = Instant::now();
            self.connection.send(&Request::Edit(edit)).await?;
            due += interval;
            while let Ok(frame) = timeout_at(due, self.connection.next()).await {
                if seen.count(&frame?, last_edit)? {
                    seen.commits += 1;
                    seen.longest_gap = seen.longest_gap.max(last_commit.elapsed());
                    last_commit = Instant::now();
                }
            }
        }
        seen.longest_gap = seen.longest_gap.max(last_commit.elapsed());
        self.settle(seen, last_edit).await
    }

    /// Reads until the server has nothing more to do for this viewer, work at rest included.
    pub async fn rest(&mut self) -> Result<(), StreamError> {
        self.settle(Dragged::default(), Instant::now()).await.map(drop)
    }

    async fn settle(&mut self, mut seen: Dragged, last_edit: Instant) -> Result<Dragged, StreamError> {
        loop {
            // In the midst of a generation the server may be silent for longer.
            let limit = if seen.working { FRAME_TIMEOUT } else { QUIET };
            match timeout(limit, self.connection.next()).await {
                Ok(frame) => {
                    seen.count(&frame?, last_edit)?;
                }
                Err(_) if seen.working => return Err(StreamError::Silent(FRAME_TIMEOUT)),
                Err(_) => return Ok(seen),
            }
        }
    }
}

impl Dragged {
    /// Whether the frame is a `committed`.
    fn count(&mut self, frame: &RawFrame, last_edit: Instant) -> Result<bool, Error> {
        let text = match frame {
            RawFrame::Chunk(chunk) => {
                self.bytes += chunk.len() as u64;
                return Ok(false);
            }
            RawFrame::Text(text) => text,
        };
        match kind(text)? {
            "done" => {
                self.working = false;
                self.settle = last_edit.elapsed();
                self.statistics = statistics(text)?;
            }
            "superseded" => self.working = false,
            "measured" => {}
            "committed" => return Ok(true),
            _ => self.working = true,
        }
        Ok(false)
    }
}

/// Returns the kind of a text frame; an `error` is returned as an error.
fn kind(text: &str) -> Result<&str, Error> {
    let reply: Reply<'_> = serde_json::from_str(text)?;
    if reply.kind == "error" {
        return Err(Error::Answer {
            code: reply.code.unwrap_or_default(),
            message: reply.message.unwrap_or_default(),
        });
    }
    Ok(reply.kind)
}

fn statistics(done: &str) -> Result<Statistics, Error> {
    Ok(serde_json::from_str::<Done>(done)?.statistics)
}
