//! What one client that misbehaves costs the others: the same viewers edit without it and beside it, in turns.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::ValueEnum;
use futures_util::{SinkExt, StreamExt};
use isopeel_client::{Connection, Message};
use serde_json::json;
use tokio::io::AsyncWriteExt;
use tokio::task::JoinSet;
use tokio::time::{Instant, interval};

use crate::seen::Seen;
use crate::server::Server;
use crate::viewer::{Random, VOLUME, Viewer, connect};
use crate::{BUSY_VIEWERS, Error};

/// A client that misbehaves. Closed, it comes again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Beside {
    /// Edits ten times a second, asks for the full surface, and never reads
    Stalled,
    /// Opens the volume as fast as it is let
    Opens,
    /// Edits as fast as it is let
    Edits,
    /// Sends messages that are none, and before the server closes the connection a good one
    Malformed,
    /// Sends pings, and pongs that the server did not request
    Pings,
    /// Sends a message in pieces without end, each of which is empty
    Pieces,
    /// Sends bytes that are no frames, again and again on connections of their own
    Garbage,
}

/// Between two edits of [`Beside::Stalled`].
const STALLED_PAUSE: Duration = Duration::from_millis(100);
/// Messages that are none in a row: the server closes with the sixteenth.
const MALFORMED_IN_A_ROW: u32 = 15;
/// Bytes that are no frames: reserved bits and an unknown kind.
const GARBAGE: [u8; 64] = [0xFF; 64];

/// A text frame and one that continues it, both masked, without contents, and not the last.
const FIRST_PIECE: [u8; 6] = [0x01, 0x80, 0, 0, 0, 0];
const NEXT_PIECE: [u8; 6] = [0x00, 0x80, 0, 0, 0, 0];

impl Beside {
    fn name(self) -> &'static str {
        match self {
            Self::Stalled => "a stalled reader",
            Self::Opens => "a flood of opens",
            Self::Edits => "a flood of edits",
            Self::Malformed => "a flood of malformed messages",
            Self::Pings => "a flood of pings",
            Self::Pieces => "a flood of pieces",
            Self::Garbage => "a flood of garbage",
        }
    }

    /// Misbehaves until it is aborted.
    async fn run(self, address: String) {
        loop {
            if let Ok(connection) = connect(&address).await {
                // The server may close the connection.
                let _ = self.talk(connection).await;
            }
        }
    }

    async fn talk(self, mut connection: Connection) -> Result<(), Error> {
        let open = Message::text(json!({"type": "open", "volume": VOLUME}).to_string());
        let mut random = Random(9);
        let mut edit = || Message::text(json!({"type": "edit", "iso": random.isovalue(), "beta": -1}).to_string());
        if let Self::Garbage | Self::Pieces = self {
            return self.send_bytes(connection).await;
        }
        connection.send_raw(open.clone()).await?;
        if self == Self::Stalled {
            let mut pause = interval(STALLED_PAUSE);
            loop {
                pause.tick().await;
                connection.send_raw(edit()).await?;
            }
        }
        // A client that floods the server reads the answers.
        let (mut sink, mut stream) = connection.into_socket().split();
        let reading = async { while let Some(Ok(_)) = stream.next().await {} };
        let sending = async {
            for n in 0.. {
                sink.send(match self {
                    Self::Opens => open.clone(),
                    Self::Malformed if n % (MALFORMED_IN_A_ROW + 1) == MALFORMED_IN_A_ROW => edit(),
                    Self::Malformed => Message::text("{"),
                    Self::Pings if n % 2 == 0 => Message::Ping(Default::default()),
                    Self::Pings => Message::Pong(Default::default()),
                    _ => edit(),
                })
                .await?;
            }
            Ok(())
        };
        tokio::select! {
            () = reading => Ok(()),
            sent = sending => sent,
        }
    }

    /// What no library sends.
    async fn send_bytes(self, mut connection: Connection) -> Result<(), Error> {
        let tcp = connection.stream_mut();
        if self == Self::Pieces {
            tcp.write_all(&FIRST_PIECE).await?;
            let pieces = NEXT_PIECE.repeat(1 << 14);
            loop {
                tcp.write_all(&pieces).await?;
            }
        }
        tcp.write_all(&GARBAGE).await?;
        connection.close_code().await?;
        Ok(())
    }
}

/// What the viewers have seen in all rounds of one kind.
struct Turns {
    beside: Option<Beside>,
    /// At half of the capacity.
    paced: Arc<Seen>,
    /// Some of them as fast as they can, and how long.
    busy: Arc<Seen>,
    busy_time: Duration,
    cpu_seconds: f64,
}

impl Turns {
    fn new(beside: Option<Beside>) -> Result<Self, Error> {
        Ok(Self {
            beside,
            paced: Seen::new()?,
            busy: Seen::new()?,
            busy_time: Duration::ZERO,
            cpu_seconds: 0.0,
        })
    }

    fn done_a_second(&self) -> f64 {
        self.busy.done.load(Ordering::Relaxed) as f64 / self.busy_time.as_secs_f64()
    }

    /// Beside the same without such a client.
    fn report(&self, alone: &Self) {
        let name = self.beside.map_or("nobody", Beside::name);
        let (p50, p99, done) = (
            self.paced.quantile(0.5),
            self.paced.quantile(0.99),
            self.done_a_second(),
        );
        println!(
            "beside {name}: p50 {p50:.0} ms ({:.2}), p99 {p99:.0} ms ({:.2}), {done:.1} edits a second ({:.2}), {:.1} s of processors ({:.2}), {} edits, {} errors",
            p50 / alone.paced.quantile(0.5),
            p99 / alone.paced.quantile(0.99),
            done / alone.done_a_second(),
            self.cpu_seconds,
            self.cpu_seconds / alone.cpu_seconds,
            self.paced.edits.load(Ordering::Relaxed),
            self.paced.errors.load(Ordering::Relaxed) + self.busy.errors.load(Ordering::Relaxed),
        );
    }
}

/// Viewers who edit for a while, each with its numbers.
pub struct Crowd<'a> {
    pub server: &'a Server,
    pub viewers: Vec<(Viewer, Random)>,
    /// Between two edits of one of them.
    pub pause: Duration,
    pub time: Duration,
}

impl Crowd<'_> {
    /// Measures edits without any other client and beside each of these, in turns, for this number of rounds.
    pub async fn measure(mut self, beside: &[Beside], rounds: u32) -> Result<(), Error> {
        // What is made for viewers that rest is made by then.
        self.cost_of(None).await?;
        let resting = self.cost_of(None).await?;
        for kind in beside {
            let cost = self.cost_of(Some(*kind)).await?;
            println!(
                "{} while nobody edits: {:.3} of a processor, {resting:.3} without",
                kind.name(),
                cost
            );
        }
        let kinds = [None].into_iter().chain(beside.iter().copied().map(Some));
        let mut turns: Vec<_> = kinds.map(Turns::new).collect::<Result<_, _>>()?;
        for _ in 0..rounds {
            for turn in &mut turns {
                let used = self.server.cpu_seconds()?;
                let client = turn
                    .beside
                    .map(|beside| tokio::spawn(beside.run(self.server.address.clone())));
                self.edit_paced(&turn.paced).await?;
                turn.busy_time += self.edit_busily(&turn.busy).await?;
                turn.cpu_seconds += self.server.cpu_seconds()? - used;
                if let Some(client) = client {
                    client.abort();
                }
            }
        }
        turns.iter().for_each(|turn| turn.report(&turns[0]));
        Ok(())
    }

    /// Returns the number of processors that the server uses while no viewer edits, with or without this other client.
    async fn cost_of(&mut self, beside: Option<Beside>) -> Result<f64, Error> {
        let client = beside.map(|beside| tokio::spawn(beside.run(self.server.address.clone())));
        let (used, start) = (self.server.cpu_seconds()?, Instant::now());
        let (seen, until) = (Seen::new()?, start + self.time / 2);
        self.each(&seen, move |_, mut viewer, random| async move {
            let ended = viewer.read_until(until).await;
            (viewer, random, ended)
        })
        .await?;
        let cost = (self.server.cpu_seconds()? - used) / start.elapsed().as_secs_f64();
        if let Some(client) = client {
            client.abort();
        }
        Ok(cost)
    }

    /// All of them, at times that do not wait for answers.
    async fn edit_paced(&mut self, seen: &Arc<Seen>) -> Result<(), Error> {
        let (until, pause) = (Instant::now() + self.time, self.pause);
        self.each(seen, move |_, mut viewer, mut random| async move {
            let ended = viewer.edit_until(&mut random, pause, until).await;
            (viewer, random, ended)
        })
        .await
    }

    /// Some of them, each as fast as it can; how long that took.
    async fn edit_busily(&mut self, seen: &Arc<Seen>) -> Result<Duration, Error> {
        let start = Instant::now();
        let until = start + self.time / 2;
        self.each(seen, move |number, mut viewer, mut random| async move {
            let ended = match number {
                ..BUSY_VIEWERS => viewer.edit_on(&mut random, until).await,
                BUSY_VIEWERS.. => viewer.read_until(until).await,
            };
            (viewer, random, ended)
        })
        .await?;
        Ok(start.elapsed())
    }

    /// Each viewer does something; one that fails is counted, and another one comes.
    async fn each<F>(&mut self, seen: &Arc<Seen>, act: impl Fn(usize, Viewer, Random) -> F) -> Result<(), Error>
    where
        F: Future<Output = (Viewer, Random, Result<(), Error>)> + Send + 'static,
    {
        let mut acts = JoinSet::new();
        for (number, (mut viewer, random)) in self.viewers.drain(..).enumerate() {
            viewer.count_in(seen);
            acts.spawn(act(number, viewer, random));
        }
        while let Some(acted) = acts.join_next().await {
            let (viewer, random, ended) = acted?;
            let viewer = match ended {
                Ok(()) => viewer,
                Err(error) => {
                    eprintln!("a viewer: {error}");
                    seen.errors.fetch_add(1, Ordering::Relaxed);
                    Viewer::open(&self.server.address, seen).await?
                }
            };
            self.viewers.push((viewer, random));
        }
        Ok(())
    }
}
