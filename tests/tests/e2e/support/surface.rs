//! State of one surface in an independent viewer, and the frames that `server/PROTOCOL.md` allows next.

use std::collections::HashMap;

use serde_json::Value;

use super::chunk::Chunk;
use super::frame::Prefix;

/// A prefix between `prefix` and `committed`.
pub struct Pending {
    pub announced: Prefix,
    pub chunks: HashMap<[u32; 3], Chunk>,
}

/// Progress of the newest generation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// Prefixes come; the last committed one, and whether it was final.
    Running { committed: Option<(u8, bool)> },
    /// After `done`; whether a better surface came, and `measured`.
    Done { improved: bool, measured: bool },
    /// A better surface comes after `done`; whether it is committed.
    Improving { committed: bool },
    /// After `superseded`, or before the first generation.
    Ended,
}

/// State of a surface in a viewer.
pub struct Surface {
    /// The shown meshes: the last committed mesh of every region that has one.
    pub shown: HashMap<[u32; 3], Chunk>,
    /// The newest.
    generation: u32,
    stage: Stage,
    /// Whether marching cubes made the prefix that was committed last.
    is_marched: bool,
}

impl Default for Surface {
    fn default() -> Self {
        Self {
            shown: HashMap::new(),
            generation: 0,
            stage: Stage::Ended,
            is_marched: false,
        }
    }
}

impl Surface {
    /// Number of the newest generation.
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// Whether all frames that follow at rest have arrived.
    pub fn is_measured(&self) -> bool {
        matches!(self.stage, Stage::Done { measured: true, .. })
    }

    /// Whether an annotation may come: all frames that follow at rest have arrived, or its newest generation failed. Marching cubes are not
    /// measured.
    pub fn may_annotate(&self) -> bool {
        self.is_measured() || self.is_marched && !self.is_running() || self.stage == Stage::Ended
    }

    pub fn on_done(&mut self, generation: u32, statistics: &Value) {
        assert_eq!(generation, self.generation, "`done` of the newest generation");
        let improved = match self.stage {
            Stage::Running {
                committed: Some((_, true)),
            } => false,
            Stage::Improving { committed: true } => true,
            other => panic!("`done` follows the final prefix, found {other:?}"),
        };
        assert!(
            !improved || statistics["isTreeCut"] == true,
            "a better surface is a tree cut"
        );
        self.stage = Stage::Done {
            improved,
            measured: false,
        };
        assert_eq!(
            statistics["mesher"] == "marching-cubes",
            self.is_marched,
            "mesher of the prefix and of the statistics"
        );
        let triangles = self.triangles();
        assert_eq!(
            statistics["triangles"], triangles,
            "triangles of the map and of the statistics"
        );
    }

    pub fn on_measured(&mut self, generation: u32, regions: &[([u32; 3], [f64; 2])]) {
        assert_eq!(generation, self.generation, "`measured` of the newest generation");
        let Stage::Done {
            improved,
            measured: false,
        } = self.stage
        else {
            panic!("`measured` once, after `done`, found {:?}", self.stage)
        };
        self.stage = Stage::Done {
            improved,
            measured: true,
        };
        for (region, _) in regions {
            assert!(
                self.shown.contains_key(region),
                "region {region:?} was measured, but is not there"
            );
        }
    }

    pub fn on_superseded(&mut self, generation: u32) {
        let is_done = generation == self.generation && matches!(self.stage, Stage::Done { .. });
        assert!(
            !is_done && self.takes_up(generation),
            "generation {generation} ended before"
        );
        self.stage = Stage::Ended;
    }

    /// A volume was opened: no mesh is held, and running generations have ended.
    pub fn on_opened(&mut self) {
        self.shown.clear();
        self.stage = Stage::Ended;
    }

    /// The surface was removed.
    pub fn on_removed(&mut self) {
        assert!(!self.is_running(), "a surface was removed whose generation did not end");
        self.shown.clear();
        self.stage = Stage::Ended;
    }

    /// Whether its newest generation has neither ended nor is done.
    fn is_running(&self) -> bool {
        matches!(self.stage, Stage::Running { .. } | Stage::Improving { .. })
    }

    /// Triangles of the map.
    fn triangles(&self) -> usize {
        self.shown.values().map(|chunk| chunk.triangles.len()).sum()
    }

    /// Takes up a generation if it is newer; returns false if it has already ended.
    fn takes_up(&mut self, generation: u32) -> bool {
        assert!(generation > 0, "generations count from 1");
        assert!(
            generation >= self.generation,
            "generation {generation} after a frame of {}",
            self.generation
        );
        if generation > self.generation {
            assert!(
                !self.is_running(),
                "generation {generation} begins before {} ended",
                self.generation
            );
            self.generation = generation;
            self.stage = Stage::Running { committed: None };
        }
        if let Stage::Done {
            improved: false,
            measured: false,
        } = self.stage
        {
            self.stage = Stage::Improving { committed: false };
        }
        matches!(
            self.stage,
            Stage::Running { .. } | Stage::Improving { committed: false }
        )
    }

    pub fn on_prefix(&mut self, announced: Prefix) {
        let Prefix { generation, level, .. } = announced;
        assert!(
            self.takes_up(generation),
            "a prefix of generation {generation}, which has ended"
        );
        assert!(
            announced.is_final || !matches!(self.stage, Stage::Improving { .. }),
            "a better surface is final: {announced:?}"
        );
        if let Stage::Running {
            committed: Some((before, was_final)),
        } = self.stage
        {
            assert!(!was_final, "prefix {level} after the final surface");
            assert!(
                level <= before,
                "prefix {level} after prefix {before}: levels do not rise"
            );
        }
    }

    pub fn on_committed(&mut self, of: (u8, u32, u8, bool), pending: Pending) {
        let Pending { announced, chunks } = pending;
        let (_, generation, level, is_final) = of;
        assert_eq!(
            of,
            (announced.surface, self.generation, announced.level, announced.is_final),
            "surface, generation, level and `final` of `committed`"
        );
        assert_eq!(generation, announced.generation);
        self.is_marched = announced.is_marched;
        assert_eq!(
            chunks.len(),
            announced.regions,
            "chunks of the prefix and its `regions`"
        );
        let is_unchanged = |region: &&[u32; 3]| !chunks.contains_key(*region);
        assert_eq!(
            self.shown.keys().filter(is_unchanged).count(),
            announced.unchanged,
            "regions that stay and the prefix's `unchanged`"
        );
        for (region, chunk) in chunks {
            if chunk.vertices.is_empty() {
                self.shown.remove(&region);
            } else {
                self.shown.insert(region, chunk);
            }
        }
        assert_eq!(
            self.triangles(),
            announced.triangles,
            "triangles of the map and of the prefix"
        );
        self.stage = match self.stage {
            Stage::Improving { .. } => Stage::Improving { committed: true },
            _ => Stage::Running {
                committed: Some((level, is_final)),
            },
        };
    }
}
