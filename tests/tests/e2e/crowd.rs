//! Many viewers who follow one: the time until an edit of the leader is on all of their screens, their cost, and that they are not delayed
//! by clients that misbehave.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use isopeel_client::{Connection, Message};
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::metrics::{counted, metrics_of};
use crate::support::process::Process;
use crate::support::viewer::connect;
use crate::support::{ball, process};

/// Followers; `ISOPEEL_FOLLOWERS` has another number.
const FOLLOWERS: usize = 100;
/// Edits of the leader before there are followers, and while there are.
const EDITS: usize = 4;
/// Between the end of an edit and the next.
const PAUSE: Duration = Duration::from_millis(300);
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);

async fn say(connection: &mut Connection, message: Value) {
    connection.send(&message).await.expect("it is sent");
}

async fn until(connection: &mut Connection, kind: &str) -> Value {
    let message = timeout(PATIENCE, connection.until(kind)).await;
    message.expect("a message in time").expect("no error")
}

/// A follower: sends the time at which it has the first surface of each isovalue, until the group ends.
async fn follow(address: SocketAddr, group: String, seen: mpsc::Sender<(u64, Instant)>) {
    let mut connection = connect(address).await;
    say(&mut connection, json!({"type": "join", "group": group})).await;
    let mut expected = None;
    loop {
        let message = timeout(PATIENCE, connection.next_message()).await;
        let message = message.expect("a message in time").expect("no error");
        match message["type"].as_str().expect("a type") {
            "led" => expected = message["surfaces"][0]["edit"]["iso"].as_f64(),
            "committed" => {
                if let Some(iso) = expected.take() {
                    seen.send((iso.to_bits(), Instant::now()))
                        .await
                        .expect("the test listens");
                }
            }
            "error" => panic!("{message}"),
            "left" => return,
            _ => {}
        }
    }
}

/// Returns the time that `percent` per cent of the times do not exceed.
fn percentile(times: &mut [Duration], percent: usize) -> Duration {
    times.sort_unstable();
    times[(times.len() * percent / 100).min(times.len() - 1)]
}

/// Isovalues that no viewer has been shown before.
fn iso(n: usize) -> f64 {
    2.0 + n as f64 * 0.75
}

/// A server with the ball, a group on it, and its followers.
struct Crowd {
    server: Process,
    leader: Connection,
    /// Of the leader's last edit.
    generation: u64,
    followers: usize,
    all: mpsc::Receiver<(u64, Instant)>,
    tasks: JoinSet<()>,
    _folder: tempfile::TempDir,
}

impl Crowd {
    /// A server, on which one viewer has opened the ball.
    async fn start() -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        let volume = folder.path().join("ball.npy");
        ball::write(&volume);
        let server = process::start(&[volume], &["--no-demo"])?;
        let mut leader = connect(server.address).await;
        say(&mut leader, json!({"type": "open", "volume": "ball"})).await;
        until(&mut leader, "opened").await;
        Some(Self {
            server,
            leader,
            generation: 0,
            followers: 0,
            all: mpsc::channel(1).1,
            tasks: JoinSet::new(),
            _folder: folder,
        })
    }

    /// Makes `followers` viewers follow from now on, and waits until they have the shown surface.
    async fn join(&mut self, followers: usize) {
        say(&mut self.leader, json!({"type": "lead"})).await;
        let group = until(&mut self.leader, "group").await["group"]
            .as_str()
            .expect("an id")
            .to_owned();
        let (seen, all) = mpsc::channel(followers);
        (self.followers, self.all) = (followers, all);
        for _ in 0..followers {
            self.tasks
                .spawn(follow(self.server.address, group.clone(), seen.clone()));
        }
        for _ in 0..followers {
            self.next().await;
        }
    }

    /// An edit of the leader: when it was sent, and how long it took to its first commit.
    async fn edit(&mut self, iso: f64) -> (Instant, Duration) {
        let start = Instant::now();
        say(&mut self.leader, json!({"type": "edit", "iso": iso})).await;
        // The previous surface may be improved meanwhile.
        let before = self.generation;
        while self.generation == before {
            let committed = until(&mut self.leader, "committed").await;
            self.generation = committed["generation"].as_u64().expect("a number").max(before);
        }
        let first = start.elapsed();
        let is_of_edit = |done: &Value| done["generation"].as_u64() == Some(self.generation);
        while !is_of_edit(&until(&mut self.leader, "done").await) {}
        (start, first)
    }

    /// The next first commit of a follower.
    async fn next(&mut self) -> (u64, Instant) {
        let next = timeout(PATIENCE, self.all.recv()).await;
        next.expect("all see it").expect("a follower")
    }

    /// How long edits of these isovalues take to the first commit of each follower.
    async fn edits(&mut self, isovalues: impl IntoIterator<Item = f64>) -> Vec<Duration> {
        let mut times = Vec::new();
        for iso in isovalues {
            let (start, _) = self.edit(iso).await;
            for _ in 0..self.followers {
                let (of, at) = self.next().await;
                assert_eq!(f64::from_bits(of), iso);
                times.push(at - start);
            }
            tokio::time::sleep(PAUSE).await;
        }
        times
    }

    fn metrics(&self) -> String {
        metrics_of(self.server.address)
    }

    /// The group ends, and no follower has failed.
    async fn end(mut self) {
        say(&mut self.leader, json!({"type": "leave"})).await;
        until(&mut self.leader, "left").await;
        while let Some(ended) = self.tasks.join_next().await {
            ended.expect("no follower fails");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_that_follows_sees_an_edit_soon_and_costs_little() {
    let Some(mut crowd) = Crowd::start().await else { return };
    let followers = std::env::var("ISOPEEL_FOLLOWERS").map_or(FOLLOWERS, |n| n.parse().expect("a number"));
    let mut alone = Vec::new();
    for n in 0..EDITS {
        alone.push(crowd.edit(iso(n)).await.1);
        tokio::time::sleep(PAUSE).await;
    }
    let alone = percentile(&mut alone, 50);
    let before = crowd.server.resident_bytes();
    crowd.join(followers).await;
    let mut times = crowd.edits((EDITS..2 * EDITS).map(iso)).await;
    let more = crowd.server.resident_bytes().saturating_sub(before);
    let (p50, p99) = (percentile(&mut times, 50), percentile(&mut times, 99));
    println!(
        "one alone: first commit {alone:?} (p50); {followers} followers: p50 {p50:?}, p99 {p99:?}; {} MiB more",
        more >> 20
    );
    let metrics = crowd.metrics();
    assert_eq!(counted(&metrics, "isopeel_followers", ""), followers as f64);
    assert_eq!(counted(&metrics, "isopeel_stream_errors_total", ""), 0.0);
    // Each step is made once for all viewers: two or three per edit, and the improved one.
    let made = counted(&metrics, "isopeel_cache_requests_total", r#"what="step",result="miss""#);
    assert!(made <= (2 * EDITS * 8) as f64, "{made} steps");
    assert!(more < 2 << 30, "{} MiB", more >> 20);
    crowd.end().await;
}

/// A client that misbehaves until the server closes the connection. It reads only as much as necessary.
async fn misbehave(address: SocketAddr, how: usize) {
    let Ok(mut connection) = Connection::connect(address).await else {
        return;
    };
    let open = Message::text(json!({"type": "open", "volume": "ball"}).to_string());
    let mut edits = (0..).map(|n| json!({"type": "edit", "iso": 2.0 + f64::from(n % 97) * 0.1, "beta": -1}));
    let mut edit = || Message::text(edits.next().expect("without end").to_string());
    match how {
        // Edits ten times a second and never reads.
        0 => {
            let _ = connection.send_raw(open).await;
            while connection.send_raw(edit()).await.is_ok() {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
        1 => flood(connection, || open.clone()).await,
        2 => flood(connection, || Message::Ping(Default::default())).await,
        3 => flood(connection, || Message::Pong(Default::default())).await,
        // 15 malformed messages, and a valid one, which has no effect because no volume is open.
        4 => {
            let mut n = 0;
            flood(connection, || {
                n += 1;
                if n % 16 == 0 { edit() } else { Message::text("{") }
            })
            .await
        }
        // A message of endless empty fragments, as masked bytes on the wire.
        _ => {
            let tcp = connection.stream_mut();
            let _ = tcp.write_all(&[0x01, 0x80, 0, 0, 0, 0]).await;
            let pieces = [0x00, 0x80, 0, 0, 0, 0].repeat(1 << 14);
            while tcp.write_all(&pieces).await.is_ok() {}
        }
    }
}

/// Sends as fast as the server accepts messages, and reads all frames.
pub async fn flood(connection: Connection, mut next: impl FnMut() -> Message) {
    let (mut sink, mut stream) = connection.into_socket().split();
    let reading = async { while let Some(Ok(_)) = stream.next().await {} };
    let sending = async { while sink.send(next()).await.is_ok() {} };
    tokio::select! {
        () = reading => {}
        () = sending => {}
    }
}

/// Number of kinds of [`misbehave`]; one client of each kind runs at a time.
const KINDS: usize = 6;
/// In turns, without them and beside them.
const ROUNDS: usize = 2;
/// Edits of each.
const EDITS_OF_A_ROUND: usize = 2;
/// Limit for an edit beside misbehaving clients: `MAX_RATIO` times the time of an edit without them, because they have a share of the
/// device as any viewer has, plus the time of two turns of the device, each about 50 ms: without them an edit may take less than one turn.
const MAX_RATIO: f64 = 4.0;
const TWO_TURNS: Duration = Duration::from_millis(100);
/// Time for the initial burst of the misbehaving clients, and then for which their cost is measured, both without edits.
const BURST: Duration = Duration::from_secs(2);
const ALONE: Duration = Duration::from_secs(4);
/// Limit for the processor time that all of them together cost the server in a second, in edits of the leader: processors differ and are
/// shared. On two cores it is about the 0.2 s that an absolute limit allowed.
const MAX_FLOOD: f64 = 0.75;

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_goes_on_beside_those_who_stall_or_flood() {
    let Some(mut crowd) = Crowd::start().await else { return };
    crowd.edit(iso(0)).await;
    crowd.join(FOLLOWERS).await;
    let (mut alone, mut beside, mut next, mut edits_cost) = (Vec::new(), Vec::new(), 1, 0.0);
    let mut isovalues = || {
        next += EDITS_OF_A_ROUND;
        (next - EDITS_OF_A_ROUND..next).map(iso)
    };
    for _ in 0..ROUNDS {
        let before = crowd.server.cpu_seconds();
        alone.extend(crowd.edits(isovalues()).await);
        edits_cost += crowd.server.cpu_seconds() - before;
        let mut others = JoinSet::new();
        (0..KINDS).for_each(|how| drop(others.spawn(misbehave(crowd.server.address, how))));
        tokio::time::sleep(PAUSE).await;
        beside.extend(crowd.edits(isovalues()).await);
    }
    let edit_cost = edits_cost / (ROUNDS * EDITS_OF_A_ROUND) as f64;
    let flood_cost = {
        let mut others = JoinSet::new();
        (0..KINDS).for_each(|how| drop(others.spawn(misbehave(crowd.server.address, how))));
        tokio::time::sleep(BURST).await;
        let before = crowd.server.cpu_seconds();
        tokio::time::sleep(ALONE).await;
        (crowd.server.cpu_seconds() - before) / ALONE.as_secs_f64()
    };
    let (alone, beside) = (percentile(&mut alone, 50), percentile(&mut beside, 50));
    println!(
        "{FOLLOWERS} followers: p50 {alone:?}, beside those who stall or flood {beside:?}; an edit takes {edit_cost:.2} s of a \
         processor, a second of these alone {flood_cost:.2} s"
    );
    let metrics = crowd.metrics();
    assert_eq!(counted(&metrics, "isopeel_stream_errors_total", r#"code="busy""#), 0.0);
    assert!(
        beside < alone.mul_f64(MAX_RATIO) + TWO_TURNS,
        "{beside:?} beside them, {alone:?} without"
    );
    assert!(
        flood_cost < MAX_FLOOD * edit_cost,
        "{flood_cost:.2} s a second, an edit {edit_cost:.2} s"
    );
    // None of them has failed or left: each has seen each edit.
    crowd.end().await;
}
