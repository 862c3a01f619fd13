//! Makes a sequence that fails shorter, as long as it fails in the same way.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::compare::Difference;
use super::run::{Counts, LOG, Run};
use super::sequence::{Event, Sequence};
use super::world::World;

/// Longest time for one sequence.
const LIMIT: Duration = Duration::from_secs(120);
/// Length of the part of a panic's message that identifies its kind.
const KIND_LENGTH: usize = 60;

/// Plays a sequence; a panic of its client, which checks each frame, is a difference too.
pub async fn play(world: &Arc<World>, sequence: Sequence) -> Result<Counts, Difference> {
    let world = Arc::clone(world);
    let folder = Arc::new(tempfile::tempdir().expect("a folder"));
    let log = folder.path().join(LOG);
    let of_run = Arc::clone(&folder);
    let played = tokio::spawn(async move { Run::play(&world, &sequence, of_run.path()).await }).await;
    let played = played.unwrap_or_else(|error| Err(of_panic(error.into_panic())));
    played.map_err(|of| {
        let log = std::fs::read_to_string(log).unwrap_or_default();
        Difference::new(of.kind, format!("{}\n{log}", of.detail).trim_end())
    })
}

/// Removes events, and fields of edits, until nothing can be removed.
pub struct Shrinker<'a> {
    world: &'a Arc<World>,
    kind: String,
    until: Instant,
    pub shortest: Sequence,
}

impl<'a> Shrinker<'a> {
    pub fn new(world: &'a Arc<World>, sequence: Sequence, kind: String) -> Self {
        Self {
            world,
            kind,
            until: Instant::now() + LIMIT,
            shortest: sequence,
        }
    }

    /// Returns whether the sequence fails in the same way; if so, it becomes the shortest one.
    async fn accepts(&mut self, sequence: Sequence) -> bool {
        if Instant::now() > self.until {
            return false;
        }
        let fails = play(self.world, sequence.clone()).await;
        let is_same = fails.is_err_and(|of| of.kind == self.kind);
        if is_same {
            self.shortest = sequence;
        }
        is_same
    }

    pub async fn shrink(&mut self) {
        self.remove_events().await;
        let plain = Sequence {
            line: None,
            ..self.shortest.clone()
        };
        if plain != self.shortest {
            self.accepts(plain).await;
        }
        self.remove_fields().await;
        self.remove_events().await;
    }

    /// Tries halves first, then quarters, down to single events.
    async fn remove_events(&mut self) {
        let mut size = self.shortest.events.len() / 2;
        while size > 0 {
            let mut at = 0;
            while at < self.shortest.events.len() {
                let mut shorter = self.shortest.clone();
                let end = (at + size).min(shorter.events.len());
                shorter.events.drain(at..end);
                if !self.accepts(shorter).await {
                    at += size;
                }
            }
            size /= 2;
        }
    }

    async fn remove_fields(&mut self) {
        for at in 0..self.shortest.events.len() {
            let Event::Send { message, .. } = &self.shortest.events[at] else {
                continue;
            };
            let is_field = |name: &&String| !["type", "surface"].contains(&name.as_str());
            let fields = message.as_object().into_iter().flat_map(|fields| fields.keys());
            for name in fields.filter(is_field).cloned().collect::<Vec<_>>() {
                let mut shorter = self.shortest.clone();
                if let Event::Send {
                    message: Value::Object(fields),
                    ..
                } = &mut shorter.events[at]
                {
                    fields.remove(&name);
                }
                self.accepts(shorter).await;
            }
        }
    }
}

/// Converts a client's panic about a frame to a difference. Numbers in the message are not part of the kind.
fn of_panic(panic: Box<dyn std::any::Any + Send>) -> Difference {
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
    let text = text.unwrap_or_else(|| "a panic without text".into());
    let kind: String = text.chars().filter(|c| !c.is_ascii_digit()).take(KIND_LENGTH).collect();
    Difference::new(format!("protocol: {kind}"), text)
}
