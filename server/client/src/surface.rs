//! A surface as a client holds it, and the frames that the protocol allows next.

use std::collections::HashMap;

use serde_json::Value;

use crate::chunk::{Chunk, RegionKey};
use crate::error::{Error, ensure};
use crate::frame::{Mesher, Prefix};

/// Meshes by region.
pub type Meshes = HashMap<RegionKey, Chunk>;

/// Returns whether two surfaces have the same regions with the same meshes.
pub fn same_meshes(one: &Meshes, other: &Meshes) -> bool {
    let is_same = |(region, mesh): (_, &Chunk)| other.get(region).is_some_and(|other| other.same_mesh(mesh));
    one.len() == other.len() && one.iter().all(is_same)
}

/// A prefix between `prefix` and `committed`.
pub(crate) struct Pending {
    pub announced: Prefix,
    pub chunks: Meshes,
}

/// Progress of the newest generation.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
enum Stage {
    /// Prefixes come; the last committed one, and whether it was final.
    Running { committed: Option<(u8, bool)> },
    /// After `done`; whether a better surface came, and `measured`.
    Done { improved: bool, measured: bool },
    /// A better surface comes after `done`; whether it is committed.
    Improving { committed: bool },
    /// After `superseded`, or before the first generation.
    #[default]
    Ended,
}

/// A surface as a client holds it.
#[derive(Default)]
pub struct Surface {
    /// The shown meshes: the last committed mesh of every region that has one.
    pub shown: Meshes,
    /// Number of the newest generation.
    generation: u32,
    stage: Stage,
    /// Mesher of the prefix that was committed last.
    mesher: Option<Mesher>,
    /// See [`Surface::color_field`].
    color_field: Option<String>,
}

impl Surface {
    /// Returns the number of the newest generation.
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// Returns the number of shown triangles.
    pub fn triangles(&self) -> usize {
        self.shown.values().map(|chunk| chunk.triangles.len()).sum()
    }

    /// Returns the field whose values the shown meshes have if the client reads values; `None` without one.
    pub fn color_field(&self) -> Option<&str> {
        self.color_field.as_deref()
    }

    /// Returns whether all frames that follow at rest have arrived.
    pub fn is_measured(&self) -> bool {
        matches!(self.stage, Stage::Done { measured: true, .. })
    }

    /// Returns whether an annotation may come: all frames that follow at rest have arrived, or the newest generation failed. Marching
    /// cubes are not measured.
    pub(crate) fn may_annotate(&self) -> bool {
        let is_marched = self.mesher == Some(Mesher::MarchingCubes);
        self.is_measured() || is_marched && !self.is_running() || self.stage == Stage::Ended
    }

    /// Checks that a frame is of the newest generation.
    fn check_newest(&self, generation: u32) -> Result<(), Error> {
        ensure(generation == self.generation, || {
            format!("a frame of generation {generation}, the newest is {}", self.generation)
        })
    }

    pub(crate) fn on_done(&mut self, generation: u32, statistics: &Value) -> Result<(), Error> {
        self.check_newest(generation)?;
        let improved = match self.stage {
            Stage::Running {
                committed: Some((_, true)),
            } => false,
            Stage::Improving { committed: true } => true,
            other => return Err(Error::Violation(format!("`done` without a final prefix: {other:?}"))),
        };
        let is_tree_cut = statistics["isTreeCut"] == true;
        ensure(!improved || is_tree_cut, || "a better surface is no tree cut".into())?;
        self.stage = Stage::Done {
            improved,
            measured: false,
        };
        let is_marched = statistics["mesher"] == "marching-cubes";
        ensure(is_marched == (self.mesher == Some(Mesher::MarchingCubes)), || {
            format!("mesher of the statistics; of the prefix: {:?}", self.mesher)
        })?;
        self.check_triangles(statistics["triangles"].as_u64())
    }

    /// Checks a stated number of triangles.
    fn check_triangles(&self, stated: Option<u64>) -> Result<(), Error> {
        let held = self.triangles() as u64;
        ensure(stated == Some(held), || {
            format!("{stated:?} triangles stated, the client holds {held}")
        })
    }

    pub(crate) fn on_measured(&mut self, generation: u32, regions: &[([u32; 3], [f64; 2])]) -> Result<(), Error> {
        self.check_newest(generation)?;
        let Stage::Done {
            improved,
            measured: false,
        } = self.stage
        else {
            return Err(Error::Violation(format!(
                "`measured` comes once, after `done`: {:?}",
                self.stage
            )));
        };
        self.stage = Stage::Done {
            improved,
            measured: true,
        };
        for (region, _) in regions {
            // A larger region may have the mesh there.
            let is_shown = RegionKey::around(*region).any(|region| self.shown.contains_key(&region));
            ensure(is_shown, || format!("region {region:?} was measured, but is not shown"))?;
        }
        Ok(())
    }

    pub(crate) fn on_superseded(&mut self, generation: u32) -> Result<(), Error> {
        let is_done = generation == self.generation && matches!(self.stage, Stage::Done { .. });
        ensure(!is_done && self.start(generation)?, || {
            format!("`superseded` of generation {generation}, which has ended")
        })?;
        self.stage = Stage::Ended;
        Ok(())
    }

    /// A volume was opened: no mesh is held, and running generations have ended.
    pub(crate) fn on_opened(&mut self) {
        self.shown.clear();
        self.stage = Stage::Ended;
    }

    pub(crate) fn on_removed(&mut self) -> Result<(), Error> {
        ensure(!self.is_running(), || {
            "a surface was removed whose generation has not ended".into()
        })?;
        self.on_opened();
        Ok(())
    }

    /// Returns whether the newest generation has neither ended nor is done.
    fn is_running(&self) -> bool {
        matches!(self.stage, Stage::Running { .. } | Stage::Improving { .. })
    }

    /// Starts a generation if it is newer; returns false if it has already ended.
    fn start(&mut self, generation: u32) -> Result<bool, Error> {
        ensure(generation > 0 && generation >= self.generation, || {
            format!("generation {generation} after a frame of {}", self.generation)
        })?;
        if generation > self.generation {
            ensure(!self.is_running(), || {
                format!("generation {generation} begins before {} has ended", self.generation)
            })?;
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
        Ok(matches!(
            self.stage,
            Stage::Running { .. } | Stage::Improving { committed: false }
        ))
    }

    pub(crate) fn on_prefix(&mut self, announced: &Prefix) -> Result<(), Error> {
        let is_new = self.start(announced.generation)?;
        let allowed = match self.stage {
            Stage::Improving { .. } => announced.is_final,
            Stage::Running {
                committed: Some((level, was_final)),
            } => !was_final && announced.level <= level,
            _ => true,
        };
        ensure(is_new && allowed, || format!("{announced:?} after {:?}", self.stage))
    }

    /// `committed` has surface, generation, level and `final`.
    pub(crate) fn on_committed(&mut self, committed: (u8, u32, u8, bool), pending: Pending) -> Result<(), Error> {
        let Pending { announced, chunks } = pending;
        let expected = (
            announced.surface,
            announced.generation,
            announced.level,
            announced.is_final,
        );
        ensure(committed == expected, || {
            format!("`committed` {committed:?}, expected {expected:?}")
        })?;
        self.check_newest(announced.generation)?;
        self.mesher = Some(announced.mesher);
        let unchanged = self.shown.keys().filter(|region| !chunks.contains_key(*region)).count();
        let counts = (chunks.len(), unchanged);
        ensure(counts == (announced.regions, announced.unchanged), || {
            format!("{counts:?} regions came and stay: {announced:?}")
        })?;
        for (region, chunk) in chunks {
            if chunk.vertices.is_empty() {
                self.shown.remove(&region);
            } else {
                self.shown.insert(region, chunk);
            }
        }
        for region in self.shown.keys() {
            let overlapping = region.larger().find(|larger| self.shown.contains_key(larger));
            ensure(overlapping.is_none(), || {
                format!("{region:?} is inside {overlapping:?}")
            })?;
        }
        self.check_triangles(Some(announced.triangles as u64))?;
        self.color_field = announced.color_field;
        self.stage = match self.stage {
            Stage::Improving { .. } => Stage::Improving { committed: true },
            _ => Stage::Running {
                committed: Some((announced.level, announced.is_final)),
            },
        };
        Ok(())
    }
}
