//! Many viewers of one server: how long the first picture of an edit takes, what memory they cost, whether that grows, and what one client that
//! misbehaves costs the others.
//!
//!     cargo run --release --package isopeel-tests --example viewers -- SERVER [--viewers 1000] [--seconds 60] [--churn | --beside | --device 0 --device 1]
//!
//! Starts the binary SERVER with its demo. First one viewer alone edits, one edit after the other is done; then sixteen do, each as fast as it can:
//! the capacity. Then all viewers are connected, and edit at half of that together, each its own isovalues, at times that do not wait for answers: an
//! edit's time counts from when it was due. With `--churn` each leaves after four edits and another one comes. With `--beside` the same viewers edit
//! alone and beside each client of `beside`, in turns. With `--device`, given several times, each viewer opens a volume of its own and edits as fast as
//! it can: first with the first of these devices, then with all of them.

mod beside;
mod own;
mod seen;
mod server;
mod viewer;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::Parser;
use futures_util::StreamExt;
use tokio::time::{Instant, sleep};

use beside::{Beside, Crowd};
use seen::Seen;
use server::Server;
use viewer::{Random, Viewer};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Viewers of the capacity.
const BUSY_VIEWERS: usize = 16;
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
    /// How long they edit; with `--beside` each time, and half as long once more, each as fast as it can
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// Edits a second of all viewers; by default half of the capacity
    #[arg(long)]
    rate: Option<f64>,
    /// Viewers leave after four edits, and others come
    #[arg(long)]
    churn: bool,
    /// They edit alone and beside each of these clients, in turns
    #[arg(long, value_enum, num_args = 0.., value_delimiter = ',', default_missing_value = "stalled,opens,edits,malformed,pings,pieces,garbage", conflicts_with = "churn")]
    beside: Option<Vec<Beside>>,
    /// Each viewer has a volume of its own; the server has the first of these devices, then all of them
    #[arg(long, conflicts_with_all = ["churn", "beside"])]
    device: Vec<String>,
    /// Samples along each axis of these volumes, of 8 bits
    #[arg(long, default_value_t = 256)]
    side: u16,
    /// How often, with `--beside`
    #[arg(long, default_value_t = 4)]
    rounds: u32,
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
        .edit_on(&mut Random(1), Instant::now() + Duration::from_secs(seconds))
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
        .map(|(mut viewer, seed)| tokio::spawn(async move { viewer.edit_on(&mut Random(seed), until).await }))
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
    if !options.device.is_empty() {
        return own::measure(&options).await;
    }
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
    if let Some(beside) = &options.beside {
        let crowd = Crowd {
            server: &server,
            viewers: viewers.into_iter().zip((1000..).map(Random)).collect(),
            pause,
            time: Duration::from_secs(options.seconds),
        };
        return crowd.measure(beside, options.rounds).await;
    }
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
    Ok(())
}
