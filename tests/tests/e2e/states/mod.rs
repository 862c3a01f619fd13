//! A surface is a function of its view. Tests this with random sequences of edits and events of the server. Each settled state is compared
//! with the surface that a fresh client of a server without caches gets; each prefix is checked by itself.
//!
//! The sequences are the same in each run. With `ISOPEEL_STATES_SECONDS` others are drawn for that time (`make fuzz`), from the seed
//! `ISOPEEL_STATES_SEED` or a new one. A failing sequence is shrunk and printed as a line of JSON; `ISOPEEL_STATES_FILE` names a file with
//! such lines to replay. Those of `tests/fixtures/states.jsonl` have failed once.

mod compare;
mod files;
mod generate;
mod model;
mod run;
mod seat;
mod sequence;
mod shrink;
mod volumes;
mod world;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use compare::Difference;
use run::Counts;
use sequence::Sequence;
use shrink::{Shrinker, play};
use world::World;

use crate::support::repository;

/// Seed of the sequences of each run.
const SEED: u64 = 2013;
const SEQUENCES: u64 = 4;
/// Bursts of edits in a sequence, each until the viewers rest.
const BURSTS: usize = 6;
/// Sequences that are played at a time.
const AT_ONCE: usize = 4;

/// A sequence that failed, and its difference.
type Failure = (Sequence, Difference);

/// Plays random sequences.
struct Tester {
    world: Arc<World>,
    seed: u64,
    /// Sequences are begun until then; `None`: a fixed number of them.
    until: Option<Instant>,
    begun: u64,
    running: JoinSet<(Sequence, Result<Counts, Difference>)>,
    counts: Counts,
    /// The first of each kind.
    failures: BTreeMap<String, Failure>,
}

impl Tester {
    fn is_over(&self) -> bool {
        match self.until {
            Some(until) => Instant::now() > until,
            None => self.begun == SEQUENCES,
        }
    }

    fn begin(&mut self) {
        let sequence = generate::sequence(&self.world, self.seed.wrapping_add(self.begun), BURSTS);
        self.begun += 1;
        let world = Arc::clone(&self.world);
        self.running.spawn(async move {
            let played = play(&world, sequence.clone()).await;
            (sequence, played)
        });
    }

    async fn run(&mut self) {
        loop {
            while self.running.len() < AT_ONCE && !self.is_over() {
                self.begin();
            }
            let Some(ended) = self.running.join_next().await else {
                return;
            };
            match ended.expect("no task panics") {
                (_, Ok(counts)) => self.counts += counts,
                (sequence, Err(of)) => {
                    println!("seed {}: {}: {}", sequence.seed, of.kind, of.detail);
                    println!("{}", serde_json::to_string(&sequence).expect("JSON"));
                    self.failures.entry(of.kind.clone()).or_insert((sequence, of));
                }
            }
        }
    }

    /// Shrinks and prints failing sequences; panics if there are any.
    async fn conclude(self) {
        println!("{} sequences from seed {}: {:?}", self.begun, self.seed, self.counts);
        for (kind, (sequence, of)) in &self.failures {
            let mut shrinker = Shrinker::new(&self.world, sequence.clone(), kind.clone());
            shrinker.shrink().await;
            let json = serde_json::to_string(&shrinker.shortest).expect("JSON");
            println!("{kind}: {}\n{json}", of.detail);
        }
        let kinds: Vec<_> = self.failures.keys().collect();
        assert!(
            kinds.is_empty(),
            "{kinds:#?}: ISOPEEL_STATES_FILE replays a file with a line of JSON from above"
        );
    }
}

/// Returns the value of an environment variable, if it is set and not empty.
fn variable<T: FromStr>(name: &str) -> Option<T> {
    let text = std::env::var(name).ok().filter(|text| !text.is_empty())?;
    let value = text.parse().ok();
    Some(value.unwrap_or_else(|| panic!("{name}: {text:?} is not what is expected")))
}

/// Plays the sequences of a file, one a line.
async fn replay(world: &Arc<World>, file: &Path) {
    let text = std::fs::read_to_string(file).expect("a file");
    for line in text.lines() {
        let sequence = serde_json::from_str(line).expect("a sequence");
        match play(world, sequence).await {
            Ok(counts) => println!("{counts:?}"),
            Err(of) => panic!("{}: {}\n{line}", of.kind, of.detail),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sequences_that_failed_once_lead_to_surfaces_of_their_views() {
    if let Some(world) = World::start().await.map(Arc::new) {
        replay(&world, &repository().join("tests/fixtures/states.jsonl")).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_surface_is_a_function_of_its_view() {
    let Some(world) = World::start().await.map(Arc::new) else {
        return;
    };
    if let Some(file) = variable::<PathBuf>("ISOPEEL_STATES_FILE") {
        return replay(&world, &file).await;
    }
    let seconds: Option<u64> = variable("ISOPEEL_STATES_SECONDS");
    let seed = variable("ISOPEEL_STATES_SEED");
    let mut tester = Tester {
        world,
        seed: seed.unwrap_or_else(|| seconds.map_or(SEED, |_| fastrand::u64(..1 << 32))),
        until: seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds)),
        begun: 0,
        running: JoinSet::new(),
        counts: Counts::default(),
        failures: BTreeMap::new(),
    };
    tester.run().await;
    tester.conclude().await;
}
