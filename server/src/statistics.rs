//! What one extraction did, as JSON: `isopeel extract --stats`, the stream's `done` and REST speak of it in these names.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Counts, times and bytes of one surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Statistics {
    /// Triangles of the undecimated marching-cubes surface.
    pub full_triangles: u64,
    /// Cells that the surface crosses.
    pub active_cells: u64,
    /// Leaves of the cut at each level, 0 (finest) first.
    pub leaves: [u64; 6],
    /// Triangles of this surface.
    pub triangles: u64,
    /// Different vertices of this surface: what regions share counts once.
    pub vertices: u64,
    /// Decimated cubes whose corners all have one sign: they emit nothing.
    pub lost_cubes: u64,
    /// Vertices on a coarser leaf's face where that leaf has no segment to move to.
    pub unpatched_vertices: u64,
    /// Device time by stage, milliseconds by the device's own events.
    pub stages_ms: BTreeMap<String, f64>,
    /// Milliseconds from the start of the work to the surface; neither waiting for the device nor reading files is in it.
    pub wall_ms: f64,
    /// Most bytes allocated on the device beyond resident volumes.
    pub device_bytes: u64,
    /// Bytes of the resident volumes this surface was made from.
    pub volume_bytes: u64,
    /// Name of the device.
    pub device: String,
}

impl Statistics {
    /// The kernels' statistics with what they cannot know.
    pub fn new(kernels: &isopeel_kernels::Statistics, wall: Duration, device: &str) -> Self {
        let mut stages_ms = BTreeMap::new();
        for stage in &kernels.stages {
            *stages_ms.entry(stage.stage.to_owned()).or_default() += stage.milliseconds;
        }
        Self {
            full_triangles: kernels.full_triangles,
            active_cells: kernels.active_cells,
            leaves: kernels.leaves,
            triangles: kernels.triangles,
            vertices: kernels.vertices,
            lost_cubes: kernels.lost_cubes,
            unpatched_vertices: kernels.unpatched_vertices,
            stages_ms,
            wall_ms: wall.as_secs_f64() * 1e3,
            device_bytes: kernels.device_bytes,
            volume_bytes: kernels.volume_bytes,
            device: device.to_owned(),
        }
    }
}
