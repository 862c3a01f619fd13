//! A client that checks received messages against the rules of `PROTOCOL.md`.

use std::collections::{BTreeMap, HashMap};

use serde_json::Value;

use isopeel_codec::decode::decode;

/// A prefix that is not committed yet.
struct Pending {
    message: Value,
    chunks: BTreeMap<u32, i32>,
}

#[derive(Default)]
pub(super) struct Held {
    /// Shapes of regions.
    pub map: BTreeMap<u32, i32>,
    newest: u64,
    /// Whether the newest generation has ended.
    has_ended: bool,
    final_committed: bool,
    /// Triangles of the last final surface.
    triangles: u64,
}

/// State of the client.
#[derive(Default)]
pub(super) struct Client {
    pub surfaces: HashMap<u64, Held>,
    pending: Option<Pending>,
    pub newest: u64,
    /// Maximum triangles of all final surfaces together.
    max_triangles: Option<u64>,
    /// Types, surfaces and generations of the messages, to help find the cause of a failure.
    pub log: Vec<String>,
}

impl Client {
    /// `max_triangles`: maximum triangles of all final surfaces together.
    pub fn new(max_triangles: Option<u64>) -> Self {
        Self {
            max_triangles,
            ..Self::default()
        }
    }

    pub fn text(&mut self, text: &Value) {
        let [surface, generation] = ["surface", "generation"].map(|name| text[name].to_string());
        self.log.push(format!("{} {surface} {generation}", text["type"]));
        let number = |name: &str| text[name].as_u64().unwrap_or_else(|| panic!("{name} in {text}"));
        match text["type"].as_str().expect("a type") {
            "prefix" => {
                assert!(self.pending.is_none(), "prefixes mix: {text}");
                let generation = number("generation");
                let held = self.surfaces.entry(number("surface")).or_default();
                assert!(
                    generation > held.newest || !held.has_ended && generation == held.newest,
                    "{text}"
                );
                if generation > held.newest {
                    *held = Held {
                        map: std::mem::take(&mut held.map),
                        newest: generation,
                        triangles: held.triangles,
                        ..Held::default()
                    };
                }
                self.newest = self.newest.max(generation);
                let (message, chunks) = (text.clone(), BTreeMap::new());
                self.pending = Some(Pending { message, chunks });
            }
            "committed" => {
                let Pending { message, chunks } = self.pending.take().expect("a prefix before");
                for name in ["surface", "generation", "level", "final"] {
                    assert_eq!(message[name], text[name], "{name}");
                }
                assert_eq!(message["regions"], chunks.len());
                let held = self.surfaces.get_mut(&number("surface")).expect("a surface");
                let stay = held.map.keys().filter(|region| !chunks.contains_key(region));
                assert_eq!(message["unchanged"], stay.count());
                for (region, shape) in chunks {
                    match shape {
                        0 => held.map.remove(&region),
                        _ => held.map.insert(region, shape),
                    };
                }
                if text["final"] == true {
                    held.final_committed = true;
                    held.triangles = message["triangles"].as_u64().expect("a count");
                    let sum: u64 = self.surfaces.values().map(|held| held.triangles).sum();
                    assert!(
                        self.max_triangles.is_none_or(|max| sum <= max),
                        "{sum} triangles: {text}"
                    );
                }
            }
            "done" | "measured" => {
                let held = &self.surfaces[&number("surface")];
                assert!(held.final_committed && held.newest == number("generation"), "{text}");
            }
            "superseded" => {
                let held = self.surfaces.entry(number("surface")).or_default();
                let generation = number("generation");
                assert!(generation > held.newest || !held.has_ended, "{text}");
                (held.newest, held.has_ended, held.final_committed) = (generation, true, false);
                if self
                    .pending
                    .as_ref()
                    .is_some_and(|pending| pending.message["generation"] == generation)
                {
                    self.pending = None;
                }
            }
            "removed" => {
                let surface = number("surface");
                let is_of = |pending: &Pending| pending.message["surface"] == surface;
                assert!(!self.pending.as_ref().is_some_and(is_of), "{text}");
                self.surfaces.remove(&surface);
            }
            "error" => assert!(
                ["bad-edit", "unknown-surface"].iter().any(|code| text["code"] == *code),
                "{text}"
            ),
            other => panic!("{other}"),
        }
    }

    pub fn chunk(&mut self, bytes: &[u8]) {
        let chunk = decode(bytes).expect("a valid chunk");
        let Pending { message, chunks } = self.pending.as_mut().expect("a chunk in a prefix");
        let of = chunk.header.prefix;
        assert_eq!(message["surface"], of.surface);
        assert_eq!(
            (&message["generation"], &message["level"]),
            (&of.generation.into(), &of.level.into())
        );
        let shape = chunk
            .vertices
            .iter()
            .map(|vertex| i32::from(vertex.position[1]) / 64)
            .max();
        assert_eq!(chunks.insert(chunk.header.region.coords[0], shape.unwrap_or(0)), None);
    }
}
