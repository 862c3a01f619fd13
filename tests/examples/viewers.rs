//! Many viewers of one server: how long the first picture of an edit takes, what memory they cost, and whether that grows.
//!
//!     cargo run --release --package isopeel-tests --example viewers -- SERVER [--viewers 1000] [--seconds 60] [--churn]
//!
//! Starts the binary SERVER with its demo. First one viewer alone edits, one edit after the other is done; then sixteen do, each as fast as it can:
//! the capacity. Then all viewers are connected, and edit at half of that together, each its own isovalues, at times that do not wait for answers: an
//! edit's time counts from when it was due. With `--churn` each leaves after four edits and another one comes.

use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use clap::Parser;
use futures_util::{SinkExt, StreamExt};
use hdrhistogram::Histogram;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Message, http::HeaderValue};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// The demo, and isovalues of it that have a surface.
const VOLUME: &str = "mni152";
const ISOVALUES: [f64; 2] = [55.0, 110.0];
/// Viewers of the capacity.
const BUSY_VIEWERS: usize = 16;
/// The upper bound of the histogram, in microseconds: longer times count as this one.
const LONGEST_US: u64 = 600_000_000;
/// Longest wait for one answer.
const PATIENCE: Duration = Duration::from_secs(120);
/// Edits of a viewer that then leaves, with `--churn`.
const EDITS_OF_A_VISIT: u32 = 4;
/// Viewers that connect at a time.
const ARRIVALS: usize = 16;

#[derive(Parser)]
struct Options {
    /// The server's binary
    server: PathBuf,
    /// Viewers that are connected
    #[arg(long, default_value_t = 1000)]
    viewers: usize,
    /// How long they edit
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// Edits a second of all viewers; by default half of the capacity
    #[arg(long)]
    rate: Option<f64>,
    /// Viewers leave after four edits, and others come
    #[arg(long)]
    churn: bool,
}

/// A server of its own, ended when dropped.
struct Server {
    child: tokio::process::Child,
    address: String,
}

impl Server {
    async fn start(binary: &PathBuf) -> Result<Self, Error> {
        let mut child = tokio::process::Command::new(binary)
            .args(["serve", "--demo", "--no-auth", "--listen", "127.0.0.1:0"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()?;
        let out = child.stdout.take().ok_or("no output")?;
        let line = BufReader::new(out).lines().next_line().await?.ok_or("no address")?;
        let (_, rest) = line.split_once("://").ok_or("no address")?;
        let address = rest.split('/').next().unwrap_or(rest).to_owned();
        Ok(Self { child, address })
    }

    /// Bytes that the process holds, and those of volumes among them.
    async fn memory(&self) -> Result<(u64, u64), Error> {
        let url = format!("http://{}/api/v1/memory", self.address);
        let text = tokio::task::spawn_blocking(move || ureq::get(url).call()?.body_mut().read_to_string()).await??;
        let used: Value = serde_json::from_str(&text)?;
        let bytes = |name: &str| used[name].as_u64().ok_or("no number of bytes");
        Ok((bytes("residentBytes")?, bytes("volumeBytes")?))
    }
}

/// What all viewers have seen.
struct Seen {
    /// From when an edit was due to its first commit, in microseconds.
    first_commits: Mutex<Histogram<u64>>,
    errors: AtomicU64,
    /// Edits whose viewer's next one was due before their first commit.
    overtaken: AtomicU64,
    edits: AtomicU64,
    bytes: AtomicU64,
    is_over: AtomicBool,
}

impl Seen {
    fn new() -> Result<Arc<Self>, Error> {
        Ok(Arc::new(Self {
            first_commits: Mutex::new(Histogram::new_with_bounds(1, LONGEST_US, 3)?),
            errors: AtomicU64::new(0),
            overtaken: AtomicU64::new(0),
            edits: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
        }))
    }

    fn committed(&self, after: Duration) {
        let mut histogram = self
            .first_commits
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        histogram.saturating_record(after.as_micros() as u64);
    }

    /// A quantile of the first commits, in milliseconds.
    fn quantile(&self, share: f64) -> f64 {
        let histogram = self
            .first_commits
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        histogram.value_at_quantile(share) as f64 / 1e3
    }

    fn report(&self, name: &str) {
        println!(
            "{name}: {} edits, first commit p50 {:.0} ms, p99 {:.0} ms, slowest {:.0} ms; {} overtaken, {} errors, {} MB",
            self.edits.load(Ordering::Relaxed),
            self.quantile(0.5),
            self.quantile(0.99),
            self.quantile(1.0),
            self.overtaken.load(Ordering::Relaxed),
            self.errors.load(Ordering::Relaxed),
            self.bytes.load(Ordering::Relaxed) / 1_000_000
        );
    }
}

/// Numbers that differ between viewers, and are the same in each run (splitmix64).
struct Random(u64);

impl Random {
    /// From 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    fn isovalue(&mut self) -> f64 {
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

struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    seen: Arc<Seen>,
    /// Generations up to this are of edits before.
    known: u64,
    latest: u64,
}

impl Viewer {
    /// Connects, opens the demo and waits for its surface.
    async fn open(address: &str, seen: &Arc<Seen>) -> Result<Self, Error> {
        let mut request = format!("ws://{address}/api/v1/stream").into_client_request()?;
        let protocol = HeaderValue::from_static("isopeel.v2");
        request.headers_mut().insert("sec-websocket-protocol", protocol);
        let config = WebSocketConfig::default().read_buffer_size(8 << 10);
        let (socket, _) = connect_async_with_config(request, Some(config), true).await?;
        let mut viewer = Self {
            socket,
            seen: Arc::clone(seen),
            known: 0,
            latest: 0,
        };
        viewer.send(json!({"type": "open", "volume": VOLUME})).await?;
        viewer.until(|news| matches!(news, News::Opened)).await?;
        // As it opens.
        viewer.send(json!({"type": "edit"})).await?;
        viewer.until_done().await?;
        Ok(viewer)
    }

    async fn send(&mut self, message: Value) -> Result<(), Error> {
        Ok(self.socket.send(Message::text(message.to_string())).await?)
    }

    async fn edit(&mut self, iso: f64) -> Result<(), Error> {
        self.known = self.latest;
        self.seen.edits.fetch_add(1, Ordering::Relaxed);
        self.send(json!({"type": "edit", "iso": iso})).await
    }

    async fn next(&mut self) -> Result<News, Error> {
        let message = self
            .socket
            .next()
            .await
            .ok_or("the server has closed the connection")??;
        self.seen.bytes.fetch_add(message.len() as u64, Ordering::Relaxed);
        let Message::Text(text) = message else {
            return Ok(News::Nothing);
        };
        let message: Value = serde_json::from_str(&text)?;
        let generation = message["generation"].as_u64().unwrap_or(0);
        self.latest = self.latest.max(generation);
        match message["type"].as_str() {
            Some("error") => Err(text.as_str().into()),
            Some("opened") => Ok(News::Opened),
            Some("committed") if generation > self.known => Ok(News::Committed),
            Some("done") if generation > self.known => Ok(News::Done),
            _ => Ok(News::Nothing),
        }
    }

    /// Reads until there is news that `ends` the wait.
    async fn until(&mut self, ends: impl Fn(&News) -> bool) -> Result<News, Error> {
        let found = async {
            loop {
                let news = self.next().await?;
                if ends(&news) {
                    return Ok(news);
                }
            }
        };
        timeout(PATIENCE, found).await.map_err(|_| "no answer in time")?
    }

    async fn until_done(&mut self) -> Result<(), Error> {
        self.until(|news| matches!(news, News::Done)).await.map(|_| ())
    }

    /// Edits one after the other until time is over, each when the one before is done.
    async fn edit_on(&mut self, mut random: Random, until: Instant) -> Result<(), Error> {
        while Instant::now() < until {
            let start = Instant::now();
            self.edit(random.isovalue()).await?;
            let first = self.until(|news| matches!(news, News::Committed | News::Done)).await?;
            self.seen.committed(start.elapsed());
            if matches!(first, News::Committed) {
                self.until_done().await?;
            }
        }
        Ok(())
    }

    /// Edits when it is time, whatever has come; so many times.
    async fn edit_at(
        &mut self,
        random: &mut Random,
        pause: Duration,
        next: &mut Instant,
        edits: u32,
    ) -> Result<(), Error> {
        let mut due: Option<Instant> = None;
        let mut made = 0;
        while made < edits || due.is_some() {
            if self.seen.is_over.load(Ordering::Relaxed) {
                return Ok(());
            }
            tokio::select! {
                news = self.next() => if let (News::Committed | News::Done, Some(since)) = (news?, due) {
                    self.seen.committed(since.elapsed());
                    due = None;
                },
                () = sleep_until(*next) => {
                    if due.is_some() {
                        self.seen.overtaken.fetch_add(1, Ordering::Relaxed);
                    }
                    due = Some(*next);
                    made += 1;
                    // From half to one and a half of the mean.
                    *next += pause.mul_f64(0.5 + random.next());
                    self.edit(random.isovalue()).await?;
                }
            }
        }
        Ok(())
    }
}

/// One place among the viewers, until it is over: with `churn` others come to it.
async fn stay(address: String, seen: Arc<Seen>, mut viewer: Viewer, number: u64, pause: Duration, churn: bool) {
    let mut random = Random(number);
    let mut next = Instant::now() + pause.mul_f64(random.next());
    let edits = if churn { EDITS_OF_A_VISIT } else { u32::MAX };
    while !seen.is_over.load(Ordering::Relaxed) {
        let visit = viewer.edit_at(&mut random, pause, &mut next, edits).await;
        if seen.is_over.load(Ordering::Relaxed) {
            break;
        }
        if let Err(error) = visit {
            seen.errors.fetch_add(1, Ordering::Relaxed);
            eprintln!("viewer {number}: {error}");
        }
        viewer = match Viewer::open(&address, &seen).await {
            Ok(viewer) => viewer,
            Err(error) => {
                seen.errors.fetch_add(1, Ordering::Relaxed);
                eprintln!("viewer {number} comes back: {error}");
                return;
            }
        };
    }
}

/// The first commit's median of one viewer alone, in milliseconds.
async fn alone(server: &Server, seconds: u64) -> Result<f64, Error> {
    let seen = Seen::new()?;
    let mut viewer = Viewer::open(&server.address, &seen).await?;
    viewer
        .edit_on(Random(1), Instant::now() + Duration::from_secs(seconds))
        .await?;
    seen.report("one viewer alone");
    Ok(seen.quantile(0.5))
}

/// Edits a second that the server makes.
async fn capacity(server: &Server, seconds: u64) -> Result<f64, Error> {
    let seen = Seen::new()?;
    let mut viewers = Vec::new();
    for _ in 0..BUSY_VIEWERS {
        viewers.push(Viewer::open(&server.address, &seen).await?);
    }
    let until = Instant::now() + Duration::from_secs(seconds);
    let start = Instant::now();
    let tasks: Vec<_> = (viewers.into_iter().zip(100..))
        .map(|(mut viewer, seed)| tokio::spawn(async move { viewer.edit_on(Random(seed), until).await }))
        .collect();
    for task in tasks {
        task.await??;
    }
    seen.report("capacity, 16 viewers");
    Ok(seen.edits.load(Ordering::Relaxed) as f64 / start.elapsed().as_secs_f64())
}

/// All viewers, connected a few at a time.
async fn arrive(server: &Server, seen: &Arc<Seen>, count: usize) -> Result<Vec<Viewer>, Error> {
    let arrivals = futures_util::stream::iter(0..count).map(|_| Viewer::open(&server.address, seen));
    let mut arrivals = arrivals.buffer_unordered(ARRIVALS);
    let mut viewers = Vec::with_capacity(count);
    while let Some(viewer) = arrivals.next().await {
        viewers.push(viewer?);
    }
    Ok(viewers)
}

#[tokio::main]
async fn main() -> Result<(), Error> {
    let options = Options::parse();
    rlimit::increase_nofile_limit(u64::MAX)?;
    let server = Server::start(&options.server).await?;
    let megabytes = |bytes: u64| bytes / 1_000_000;
    let median = alone(&server, 10).await?;
    let capacity = capacity(&server, 10).await?;
    let rate = options.rate.unwrap_or(capacity / 2.0);
    println!(
        "capacity {capacity:.1} edits a second; {} viewers make {rate:.1}",
        options.viewers
    );

    let (start, seen) = (Instant::now(), Seen::new()?);
    let viewers = arrive(&server, &seen, options.viewers).await?;
    println!(
        "{} viewers have their surface after {:.1} s",
        viewers.len(),
        start.elapsed().as_secs_f64()
    );
    let pause = Duration::from_secs_f64(options.viewers as f64 / rate);
    let tasks: Vec<_> = (viewers.into_iter().zip(1000..))
        .map(|(viewer, number)| {
            let (address, seen) = (server.address.clone(), Arc::clone(&seen));
            tokio::spawn(stay(address, seen, viewer, number, pause, options.churn))
        })
        .collect();
    let until = Instant::now() + Duration::from_secs(options.seconds);
    let interval = Duration::from_secs((options.seconds / 30).max(1));
    let mut resident = Vec::new();
    while Instant::now() < until {
        sleep(interval).await;
        let (bytes, volumes) = server.memory().await?;
        resident.push(bytes - volumes);
    }
    seen.is_over.store(true, Ordering::Relaxed);
    seen.report(&format!("{} viewers", options.viewers));
    let mean = |part: &[u64]| part.iter().sum::<u64>() / part.len().max(1) as u64;
    let quarters = resident.len() / 4;
    println!(
        "memory beyond volumes: most {} MB, second quarter {} MB, last quarter {} MB",
        megabytes(resident.iter().copied().max().unwrap_or(0)),
        megabytes(mean(&resident[quarters..2 * quarters])),
        megabytes(mean(&resident[resident.len() - quarters..])),
    );
    println!(
        "p99 with {} viewers ÷ p50 of one alone: {:.1}",
        options.viewers,
        seen.quantile(0.99) / median
    );
    for task in tasks {
        task.abort();
    }
    drop(server.child);
    Ok(())
}
