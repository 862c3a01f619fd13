//! Results of work on the device: a surface, or a step towards one.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use isopeel_kernels::{Level, RefinementCost, StageTime, Surface, SurfaceStatistics};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use super::dataset_views::view_space;
use super::identity::LAST_ENGINE;
use super::joined::{JoinError, WorldMesh};
use super::{ExtractionStatistics, MeasuredError};

/// A surface and its view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Extraction {
    /// The surface.
    pub surface: Surface,
    /// The view it shows, with isovalue and feature range filled in.
    pub view: View,
    /// Time of the work, without time spent waiting or reading files.
    pub wall: Duration,
    /// The error, if it was measured after the surface was made.
    pub measured: Option<MeasuredError>,
    /// Cost of refining the surface at intersecting triangles, if that was asked for and the surface is a cut of the vertex tree.
    pub refined: Option<RefinementCost>,
}

impl Extraction {
    /// Returns the statistics of the surface, which a device of this name made of the volume.
    pub fn statistics(&self, volume: &VolumeStep, device: &str) -> ExtractionStatistics {
        let smallest = volume.dataset().smallest_length();
        let statistics = ExtractionStatistics::new(&self.surface.statistics, &self.view, smallest, self.wall, device);
        ExtractionStatistics {
            error: self.measured.or(statistics.error),
            ..statistics
        }
    }
}

impl Extraction {
    /// Returns the surface as one mesh in the world, whose unit is that of the dataset.
    ///
    /// # Errors
    /// As [`WorldMesh::new`].
    pub fn mesh(&self, volume: &VolumeStep) -> Result<WorldMesh, JoinError> {
        let (_, space) = view_space(volume.dataset(), &self.view);
        WorldMesh::new(&self.surface.regions, &space)
    }
}

/// Work that an export requests in addition to its view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExportWork {
    /// Whether the error is measured.
    pub measuring: Measuring,
    /// Whether and where the surface is refined if its triangles intersect.
    pub refining: Refining,
}

/// How a final surface is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Making {
    /// Maximum triangles.
    pub ceiling: u64,
    /// Whether the error is measured.
    pub measures: bool,
    /// Whether and where the surface is refined if its triangles intersect.
    pub refining: Refining,
}

impl Default for Making {
    /// Makes a surface without a limit on triangles, measures it, and does not refine it.
    fn default() -> Self {
        Self {
            ceiling: u64::MAX,
            measures: true,
            refining: Refining::Never,
        }
    }
}

/// Places at which a cut of the vertex tree is refined if triangles intersect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refining {
    /// Nowhere.
    Never,
    /// Less than a cell from the faces at which a capped surface is closed.
    AtCaps,
    /// Everywhere.
    Everywhere,
}

/// Whether the error of a surface is measured. Measuring takes about as long as all other work on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measuring {
    /// The error is measured.
    Always,
    /// The error is measured, unless that takes longer than this time.
    Within(Duration),
    /// The error is not measured.
    Never,
}

/// The number of the last cut. Numbers are unique in the process, because sessions may refer to cuts of a lost device after it was
/// reopened.
static LAST_CUT: AtomicU64 = AtomicU64::new(0);

/// Makes the numbers of engines and cuts begin after `last`, so that they differ from those of an earlier process. Call this once, before
/// any work.
pub fn number_from(last: u64) {
    LAST_ENGINE.store(last, Ordering::Relaxed);
    LAST_CUT.store(last, Ordering::Relaxed);
}

/// Id of a cut that the workspace caches: the cut that a client shows, or its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CutId(u64);

impl CutId {
    /// Returns the id with this number.
    pub fn new(number: u64) -> Self {
        Self(number)
    }

    /// Returns an id that no other cut has.
    pub(crate) fn next() -> Self {
        Self(LAST_CUT.fetch_add(1, Ordering::Relaxed) + 1)
    }
}

/// A step on the way from the surface that a client shows to that of its view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// The surface that the client shows.
    pub shown: Shown,
    /// The cut of the view, if an earlier step has made it.
    pub target: Option<CutId>,
    /// Triangles of the surface that the last step towards this view has made; 0 before the first step.
    pub made_triangles: u64,
    /// Approximate number of triangles to make of a new surface.
    pub fresh_triangles: u64,
    /// Approximate number of triangles to remake of a surface that is shown.
    pub triangles: u64,
    /// Approximate number of bytes to send.
    pub bytes: u64,
    /// Bytes that the connection sends in the time of a step, as observed. Pauses of the sender, or of a client that draws, do not count.
    pub line_bytes: u64,
}

/// The surface that a client shows when a step begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Shown {
    /// Nothing, or a surface of another volume, time step, field, mask or isovalue. A coarse surface may replace it.
    Another,
    /// The surface of the view, except for a property that affects every region. The final surface replaces it in one step.
    Alike,
    /// As `Alike`, and this cut of the surface. Regions that are the same in both need not be made.
    AlikeCut(CutId),
    /// A cut of the same surface. Its regions can be replaced one by one.
    Cut(CutId),
}

impl Shown {
    /// Whether only the final surface may replace it.
    pub fn is_replaced_at_once(self) -> bool {
        matches!(self, Self::Alike | Self::AlikeCut(_))
    }
}

/// Result of a step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Refinement {
    /// The surface, or the regions in which it differs from the shown surface. The stages in its statistics are those of this step.
    pub surface: Surface,
    /// The view that the step leads to, with every value in force, including the fit that keeps a budget.
    pub view: View,
    /// The cut of the surface.
    pub cut: CutId,
    /// The final cut of the view, once it is known.
    pub target: Option<CutId>,
    /// Whether the surface is the final one of the view.
    pub is_final: bool,
    /// Whether a better surface of the same view exists, which [`super::Workspace::improve`] takes longer to make.
    pub can_improve: bool,
    /// Time of the work, without time spent waiting or reading files.
    pub wall: Duration,
    /// Part of `wall`: the time from the cut to the mesh on the host.
    pub meshing: Duration,
}

impl Refinement {
    /// Returns a surface of the view without triangles.
    pub fn nothing(view: &View) -> Self {
        Self {
            surface: Surface {
                regions: Vec::new(),
                remade: None,
                prefix: Level::FINEST,
                statistics: SurfaceStatistics::default(),
            },
            view: view.clone(),
            cut: CutId::next(),
            target: None,
            is_final: false,
            can_improve: false,
            wall: Duration::ZERO,
            meshing: Duration::ZERO,
        }
    }
}

/// Counts for a full surface, from before any of it is made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FullCount {
    /// Triangles of the full surface, including those of small parts.
    pub triangles: u64,
    /// Stages of the counting.
    pub stages: Vec<StageTime>,
    /// Time of the work, without time spent waiting or reading files.
    pub wall: Duration,
}

/// Measured distance of a final surface from the undecimated one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Error of the whole surface, world units.
    pub whole: MeasuredError,
    /// Error of each region that has triangles, world units.
    pub regions: Vec<([u32; 3], MeasuredError)>,
}

#[cfg(test)]
mod tests {
    use super::CutId;

    #[test]
    fn no_two_cuts_of_a_process_have_one_id() {
        let ids = [CutId::next(), CutId::next(), CutId::next()];
        assert!(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], "{ids:?}");
    }
}
