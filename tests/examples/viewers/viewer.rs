//! One viewer of the demo.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use isopeel_client::{Connection, RawFrame, WebSocketConfig, request};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep_until, timeout, timeout_at};

use crate::Error;
use crate::seen::Seen;

/// The demo, and isovalues of it that have a surface.
pub const VOLUME: &str = "mni152";
const ISOVALUES: [f64; 2] = [55.0, 110.0];
/// Longest wait for one answer.
const PATIENCE: Duration = Duration::from_secs(120);

/// Numbers that differ between viewers, and are the same in each run (splitmix64).
pub struct Random(pub u64);

impl Random {
    /// From 0 to 1.
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    pub fn isovalue(&mut self) -> f64 {
        ISOVALUES[0] + (ISOVALUES[1] - ISOVALUES[0]) * self.next()
    }
}

/// What a message says of the edit that is waited for.
enum News {
    Nothing,
    Opened,
    Committed,
    Done,
}

/// Connects to the stream.
pub async fn connect(address: &str) -> Result<Connection, Error> {
    let config = WebSocketConfig::default().read_buffer_size(8 << 10);
    let tcp = TcpStream::connect(address).await?;
    Ok(Connection::handshake(tcp, request(address, "", &[])?, Some(config)).await?)
}

pub struct Viewer {
    connection: Connection,
    seen: Arc<Seen>,
    /// Generations up to this are of edits before.
    known: u64,
    latest: u64,
    /// When the edit was due whose first commit is waited for.
    due: Option<Instant>,
    /// The last edit is not done.
    is_waiting: bool,
}

impl Viewer {
    /// Connects, opens the demo and waits for its surface.
    pub async fn open(address: &str, seen: &Arc<Seen>) -> Result<Self, Error> {
        Self::open_volume(address, VOLUME, seen).await
    }

    /// As [`Viewer::open`], for a volume that has surfaces at the same isovalues.
    pub async fn open_volume(address: &str, volume: &str, seen: &Arc<Seen>) -> Result<Self, Error> {
        let mut viewer = Self {
            connection: connect(address).await?,
            seen: Arc::clone(seen),
            known: 0,
            latest: 0,
            due: None,
            is_waiting: false,
        };
        let open = json!({"type": "open", "volume": volume});
        viewer.connection.send(&open).await?;
        viewer.until(|news| matches!(news, News::Opened)).await?;
        // As it opens.
        viewer.connection.send(&json!({"type": "edit"})).await?;
        viewer.until_done().await?;
        Ok(viewer)
    }

    /// What it sees from now on counts there.
    pub fn count_in(&mut self, seen: &Arc<Seen>) {
        self.seen = Arc::clone(seen);
    }

    async fn edit(&mut self, iso: f64, due: Instant) -> Result<(), Error> {
        if self.due.replace(due).is_some() {
            self.seen.overtaken.fetch_add(1, Ordering::Relaxed);
        }
        (self.known, self.is_waiting) = (self.latest, true);
        self.seen.edits.fetch_add(1, Ordering::Relaxed);
        Ok(self.connection.send(&json!({"type": "edit", "iso": iso})).await?)
    }

    async fn next(&mut self) -> Result<News, Error> {
        let count = |bytes: usize| self.seen.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        let text = match self.connection.next().await? {
            RawFrame::Text(text) => text,
            RawFrame::Chunk(chunk) => {
                count(chunk.len());
                return Ok(News::Nothing);
            }
        };
        count(text.len());
        let message: Value = serde_json::from_str(&text)?;
        let generation = message["generation"].as_u64().unwrap_or(0);
        self.latest = self.latest.max(generation);
        let news = match message["type"].as_str() {
            Some("error") => return Err(text.as_str().into()),
            Some("opened") => News::Opened,
            Some("committed") if generation > self.known => News::Committed,
            Some("done") if generation > self.known => News::Done,
            _ => News::Nothing,
        };
        if matches!(news, News::Committed | News::Done)
            && let Some(due) = self.due.take()
        {
            self.seen.committed(due.elapsed());
        }
        if matches!(news, News::Done) {
            self.is_waiting = false;
            self.seen.done.fetch_add(1, Ordering::Relaxed);
        }
        Ok(news)
    }

    /// Reads until there is news that `ends` the wait.
    async fn until(&mut self, ends: impl Fn(&News) -> bool) -> Result<(), Error> {
        let found = async {
            loop {
                if ends(&self.next().await?) {
                    return Ok(());
                }
            }
        };
        timeout(PATIENCE, found).await.map_err(|_| "no answer in time")?
    }

    async fn until_done(&mut self) -> Result<(), Error> {
        self.until(|news| matches!(news, News::Done)).await
    }

    /// Edits one after the other until time is over, each when the one before is done.
    pub async fn edit_on(&mut self, random: &mut Random, until: Instant) -> Result<(), Error> {
        while Instant::now() < until {
            self.edit(random.isovalue(), Instant::now()).await?;
            self.until_done().await?;
        }
        Ok(())
    }

    /// Sends `edits` edits on a schedule, whether answers have arrived or not.
    pub async fn edit_at(
        &mut self,
        random: &mut Random,
        pause: Duration,
        next: &mut Instant,
        edits: u32,
    ) -> Result<(), Error> {
        let mut made = 0;
        while made < edits || self.due.is_some() {
            tokio::select! {
                news = self.next() => { news?; }
                () = sleep_until(*next) => {
                    let due = *next;
                    made += 1;
                    // From half to one and a half of the mean.
                    *next += pause.mul_f64(0.5 + random.next());
                    self.edit(random.isovalue(), due).await?;
                }
            }
        }
        Ok(())
    }

    /// As [`Viewer::edit_at`] until time is over, and then until the last edit is done.
    pub async fn edit_until(&mut self, random: &mut Random, pause: Duration, until: Instant) -> Result<(), Error> {
        let mut next = Instant::now() + pause.mul_f64(random.next());
        if let Ok(ended) = timeout_at(until, self.edit_at(random, pause, &mut next, u32::MAX)).await {
            return ended;
        }
        match self.is_waiting {
            true => self.until_done().await,
            false => Ok(()),
        }
    }

    /// Reads until time is over.
    pub async fn read_until(&mut self, until: Instant) -> Result<(), Error> {
        let read = async {
            loop {
                self.next().await?;
            }
        };
        timeout_at(until, read).await.unwrap_or(Ok(()))
    }
}
