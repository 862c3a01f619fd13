//! A client of the stream that reads as fast as it can. It counts chunks and bytes, and decodes nothing.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use isopeel_client::{Connection, Error, RawFrame};
use isopeel_codec::chunk::ChunkHeader;
use isopeel_geometry::DVec3;
use isopeel_view::{CameraJson, Edit};
use serde::{Deserialize, Serialize};
use tokio::time::{Instant, timeout, timeout_at};

use super::StreamError;

/// Maximum wait for a frame. The server may have to read and upload a volume of many gigabytes before it sends one.
const FRAME_TIMEOUT: Duration = Duration::from_secs(300);

/// The server has settled if no generation is running and no frame arrives for this long.
const QUIET: Duration = Duration::from_secs(2);

/// A text frame to the server.
#[derive(Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum Request<'a> {
    Open { volume: &'a str, step: u32 },
    Edit(&'a Edit),
    Camera { camera: &'a CameraJson },
}

/// Fields of a text frame that the client reads.
#[derive(Deserialize)]
struct Reply<'a> {
    #[serde(rename = "type")]
    kind: &'a str,
    code: Option<String>,
    message: Option<String>,
}

/// Fields of `prefix` that the client reads.
#[derive(Deserialize)]
struct Prefix {
    regions: u64,
    unchanged: u64,
}

/// Fields of `done` that the client reads.
#[derive(Deserialize)]
struct Done {
    statistics: Statistics,
}

/// Statistics of a generation, as the server states them.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Statistics {
    pub beta: Option<f32>,
    pub tolerance: Option<f32>,
    pub is_tree_cut: bool,
    pub full_triangles: u64,
    pub triangles: u64,
    pub vertices: u64,
    pub stages_ms: BTreeMap<String, f64>,
    pub wall_ms: f64,
    pub device_bytes: u64,
}

impl Statistics {
    /// Returns the sum of all stages.
    pub fn device_ms(&self) -> f64 {
        self.stages_ms.values().sum()
    }
}

/// Measurements of one edit. All times begin when the client sends the edit.
#[derive(Clone, Debug, Default)]
pub struct Streamed {
    /// Time to `opened`, if the client has sent `open` before the edit.
    pub opened: Option<Duration>,
    /// Time to the first `committed`; `None` if the edit did not change the surface.
    pub first: Option<Duration>,
    /// Time to `done`.
    pub done: Duration,
    pub prefixes: u64,
    /// Regions of the last prefix that were sent.
    pub regions: u64,
    /// Regions of the last prefix that the client kept.
    pub unchanged: u64,
    pub chunks: u64,
    pub bytes: u64,
    pub statistics: Statistics,
}

/// Measurements of a drag.
#[derive(Clone, Debug, Default)]
pub struct Dragged {
    /// Number of prefixes that were committed until one interval after the last edit.
    pub commits: u64,
    /// Maximum time without a commit during the drag.
    pub longest_gap: Duration,
    /// Time from the last edit to the last `done`.
    pub settle: Duration,
    /// Bytes of all chunks, including those after the drag.
    pub bytes: u64,
    /// Statistics of the last `done`.
    pub statistics: Statistics,
    /// Whether a generation has begun and not ended.
    is_working: bool,
}

/// A connection to the server.
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

    /// Returns the next frame.
    ///
    /// # Errors
    /// No frame arrives within [`FRAME_TIMEOUT`].
    async fn next_frame(&mut self) -> Result<RawFrame, StreamError> {
        let next = timeout(FRAME_TIMEOUT, self.connection.next()).await;
        Ok(next.map_err(|_| StreamError::Silent(FRAME_TIMEOUT))??)
    }

    /// Opens a time step, and returns the view with which it opens.
    pub async fn open(&mut self, step: u32) -> Result<Edit, StreamError> {
        #[derive(Deserialize)]
        struct Opened {
            edit: Edit,
        }
        self.send_open(step).await?;
        loop {
            if let RawFrame::Text(text) = self.next_frame().await?
                && kind(&text)? == "opened"
            {
                let opened: Opened = serde_json::from_str(&text).map_err(Error::from)?;
                return Ok(opened.edit);
            }
        }
    }

    /// Sends an edit, and reads until its `done`.
    pub async fn edit(&mut self, edit: &Edit) -> Result<Streamed, StreamError> {
        self.request(&Request::Edit(edit)).await
    }

    /// Sends a camera that differs from the previous one, and reads until the `done` of its generation. The shown surface is a tree cut.
    pub async fn camera(&mut self, camera: &CameraJson) -> Result<Streamed, StreamError> {
        self.request(&Request::Camera { camera }).await
    }

    async fn request(&mut self, request: &Request<'_>) -> Result<Streamed, StreamError> {
        let start = Instant::now();
        self.connection.send(request).await?;
        self.read_to_done(start).await
    }

    /// Sends an edit, and reads until a tree cut is shown, which may follow at rest. Returns the bounding box of the surface in index
    /// space: lower and upper corner.
    ///
    /// # Errors
    /// The surface is empty, or a cut of cubes although the viewer rests.
    pub async fn tree_cut(&mut self, edit: &Edit) -> Result<[DVec3; 2], StreamError> {
        self.connection.send(&Request::Edit(edit)).await?;
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        loop {
            let text = match self.next_frame().await? {
                RawFrame::Chunk(chunk) => {
                    let header = ChunkHeader::parse(&chunk)?;
                    if header.vertex_count > 0 {
                        low = low.min(DVec3::from(header.min.map(f64::from)));
                        high = high.max(DVec3::from(header.max.map(f64::from)));
                    }
                    continue;
                }
                RawFrame::Text(text) => text,
            };
            match kind(&text)? {
                "done" if statistics(&text)?.is_tree_cut && low.is_finite() => return Ok([low, high]),
                "measured" => return Err(StreamError::NoTreeCut),
                _ => {}
            }
        }
    }

    /// Opens another time step, sends an edit without waiting, which the protocol allows, and reads until its `done`.
    pub async fn step(&mut self, step: u32, edit: &Edit) -> Result<Streamed, StreamError> {
        let start = Instant::now();
        self.send_open(step).await?;
        self.connection.send(&Request::Edit(edit)).await?;
        self.read_to_done(start).await
    }

    async fn read_to_done(&mut self, start: Instant) -> Result<Streamed, StreamError> {
        let mut streamed = Streamed::default();
        loop {
            let text = match self.next_frame().await? {
                RawFrame::Chunk(chunk) => {
                    streamed.chunks += 1;
                    streamed.bytes += chunk.len() as u64;
                    continue;
                }
                RawFrame::Text(text) => text,
            };
            let now = start.elapsed();
            match kind(&text)? {
                "opened" => streamed.opened = Some(now),
                "prefix" => {
                    let prefix: Prefix = serde_json::from_str(&text).map_err(Error::from)?;
                    streamed.regions = prefix.regions;
                    streamed.unchanged = prefix.unchanged;
                }
                "committed" => {
                    streamed.prefixes += 1;
                    streamed.first.get_or_insert(now);
                }
                "done" => {
                    streamed.done = now;
                    streamed.statistics = statistics(&text)?;
                    return Ok(streamed);
                }
                _ => {}
            }
        }
    }

    /// Sends edits or cameras at regular intervals while it reads frames, then reads until the server has settled.
    pub async fn drag(
        &mut self,
        requests: impl IntoIterator<Item = Request<'_>>,
        interval: Duration,
    ) -> Result<Dragged, StreamError> {
        let mut dragged = Dragged::default();
        let start = Instant::now();
        let (mut last_edit, mut last_commit, mut due) = (start, start, start);
        for request in requests {
            last_edit = Instant::now();
            self.connection.send(&request).await?;
            due += interval;
            while let Ok(frame) = timeout_at(due, self.connection.next()).await {
                if dragged.count(&frame?, last_edit)? {
                    dragged.commits += 1;
                    dragged.longest_gap = dragged.longest_gap.max(last_commit.elapsed());
                    last_commit = Instant::now();
                }
            }
        }
        dragged.longest_gap = dragged.longest_gap.max(last_commit.elapsed());
        self.settle(dragged, last_edit).await
    }

    /// Reads until the server has settled, which includes its work for a viewer at rest.
    pub async fn rest(&mut self) -> Result<(), StreamError> {
        self.settle(Dragged::default(), Instant::now()).await.map(drop)
    }

    async fn settle(&mut self, mut dragged: Dragged, last_edit: Instant) -> Result<Dragged, StreamError> {
        loop {
            // Waits longer while a generation is running, because the server may have to load a volume.
            let limit = if dragged.is_working { FRAME_TIMEOUT } else { QUIET };
            match timeout(limit, self.connection.next()).await {
                Ok(frame) => {
                    dragged.count(&frame?, last_edit)?;
                }
                Err(_) if dragged.is_working => return Err(StreamError::Silent(FRAME_TIMEOUT)),
                Err(_) => return Ok(dragged),
            }
        }
    }
}

impl Dragged {
    /// Adds a frame to the measurements. Returns whether the frame is `committed`.
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
                self.is_working = false;
                self.settle = last_edit.elapsed();
                self.statistics = statistics(text)?;
            }
            "superseded" => self.is_working = false,
            "measured" => {}
            "committed" => return Ok(true),
            _ => self.is_working = true,
        }
        Ok(false)
    }
}

/// Returns the type of a text frame. A frame of the type `error` becomes an error.
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
