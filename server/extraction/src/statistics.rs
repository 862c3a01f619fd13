//! Statistics of one extraction as JSON: `isopeel extract --stats`, the stream's `done` and REST.

use std::collections::BTreeMap;
use std::time::Duration;

use isopeel_kernels::{ErrorEstimate, SurfaceError, Topology};
use serde::{Deserialize, Serialize};

use isopeel_view::quality::{GuardName, MesherName, PixelError, TopologyName};
use isopeel_view::{FeatureName, Outward, View};

/// Tolerance that is stated for a surface in which nothing was merged: below any error.
const NOTHING_MERGED: f32 = -1.0;

/// Measured distance of a mesh from the surface it stands for, in world units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct MeasuredError {
    /// Root mean square of the distance.
    pub rms: f32,
    /// Maximum of the distance.
    pub max: f32,
}

/// Distance of a mesh from the surface it stands for, in world units, as estimated by the quadrics of its leaves. Known before anything is
/// measured, and not a bound: vertices may be farther away.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct EstimatedError {
    /// Root mean square over the surface.
    pub rms: f32,
    /// Root mean square of the worst leaf.
    pub worst_leaf: f32,
}

/// Converts a length to world units, from the device's multiples of the smallest spacing.
pub(crate) fn in_world(length: f32, smallest: f64) -> f32 {
    (f64::from(length) * smallest) as f32
}

impl MeasuredError {
    /// Converts an error to world units, from the device's multiples of the smallest spacing. `None` if the surface has no triangles, and
    /// so no distance from anything.
    pub(crate) fn in_world(SurfaceError { rms, max }: SurfaceError, smallest: f64) -> Option<Self> {
        let [rms, max] = [rms, max].map(|length| in_world(length, smallest));
        (rms.is_finite() && max.is_finite()).then_some(Self { rms, max })
    }
}

impl EstimatedError {
    /// Converts an error to world units, as [`MeasuredError::in_world`].
    fn in_world(ErrorEstimate { rms, worst_leaf }: ErrorEstimate, smallest: f64) -> Self {
        let [rms, worst_leaf] = [rms, worst_leaf].map(|length| in_world(length, smallest));
        Self { rms, worst_leaf }
    }
}

/// The shape of the surface in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Shape {
    /// The side that triangles and normals face: that of high or that of low values.
    pub outward: Outward,
    /// Vertices of the file beyond those of the surface: sheets that touch get vertices of their own.
    pub split_vertices: u64,
    /// Whether each edge has two triangles.
    pub is_closed: bool,
    /// The volume that a closed surface encloses, in cubes of the file's unit.
    pub volume: Option<f64>,
    /// Pairs of triangles that share more than corners and edges. Null: not counted, because the error was not measured and neither `clean`
    /// nor `cap` asks for the count.
    pub self_intersections: Option<u64>,
    /// Cost of the repair, of the whole surface (`clean`) or at its caps (`cap`). Null: neither was asked for.
    pub cleaned: Option<Cleaned>,
}

/// Changes made by `clean` or `cap`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Cleaned {
    /// Pairs of triangles that intersected in the file's numbers, after the cut was refined.
    pub intersections: u64,
    /// Triangles before the cut was refined at intersecting triangles. The budget holds before and after.
    pub triangles_before: u64,
    /// Triangles after the refinement.
    pub triangles_after: u64,
    /// Cuts that were made after the first one; 0 also if the surface is not a cut of the vertex tree.
    pub rounds: u32,
    /// Vertices that were moved, because their triangles still intersected.
    pub moved_vertices: u64,
    /// Largest distance by which a vertex was moved, in the file's unit.
    pub largest_move: f64,
    /// Edges between nearly coplanar triangles that were flipped, so that mesh generators flip none.
    pub flipped_edges: u64,
    /// Such edges that `clean` could not flip. TetGen may end with an error there.
    pub unflipped_edges: u64,
}

/// Counts, times and bytes of one surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "Statistics"))]
#[cfg_attr(feature = "openapi", schema(as = Statistics))]
#[serde(rename_all = "camelCase")]
pub struct ExtractionStatistics {
    /// Mesher that made the surface.
    pub mesher: MesherName,
    /// Importance up to which cubes were decimated: as given, or for marching cubes as found for a budget. Null: an error or a
    /// budget decided.
    pub beta: Option<f32>,
    /// Error over weight up to which parts were merged, world units: as given, or as found for a budget. Below 0: nothing was
    /// merged. Null: β decided.
    pub tolerance: Option<f32>,
    /// Guard on the error of a decimated part, world units; null: off.
    pub max_error: Option<f32>,
    /// The setting that was in force: whether decimation could change the topology.
    pub topology: TopologyName,
    /// Values of the feature that count as 0 and 1: as given, or its own range. Null: no feature.
    pub feature_range: Option<[f32; 2]>,
    /// Guards that were `auto` and were relaxed to keep the budget, in this order: first the error, then the topology.
    pub gave_way: Vec<GuardName>,
    /// Whether this is a cut of the vertex tree, or else of the octree.
    pub is_tree_cut: bool,
    /// Distance from the surface it stands for: over every full-resolution crossing the distance to the nearest triangle
    /// around its leaf's vertex, and the distance of each triangle's centre to the isosurface. Null: not measured.
    pub error: Option<MeasuredError>,
    /// The same distance as the leaves' quadrics estimate it. Null: not known.
    pub estimated_error: Option<EstimatedError>,
    /// Error in the picture of the camera that the surface was made for. Null: it was made for no camera, or is a cut of the octree.
    pub pixels: Option<PixelError>,
    /// Triangles of the undecimated marching-cubes surface, without removed parts.
    pub full_triangles: u64,
    /// Triangles of the undecimated surface by the mesher of this one, without removed parts. Null: not counted.
    pub mesher_triangles: Option<u64>,
    /// Parts that were removed, because of `minPart` or `parts`. Null: removal was not asked for, or this is a cut of the octree, which
    /// contains all parts.
    pub removed_parts: Option<u64>,
    /// Triangles of the removed parts in the undecimated marching-cubes surface; those of a cell with several parts count for one of them.
    /// Null as `removedParts`.
    pub removed_triangles: Option<u64>,
    /// Positions of `parts` with no surface next to them, which selected nothing. Null as `removedParts`.
    pub unmatched_positions: Option<u64>,
    /// Small parts that the cut leaves out, because no cut with all parts is within the budget, or because `topology` is `free`.
    /// Null: this is a cut of cubes, in which parts that vanish are not counted.
    pub vanished_parts: Option<u64>,
    /// Cells that the surface crosses.
    pub active_cells: u64,
    /// Leaves of the cut at each level, 0 (finest) first.
    pub leaves: [u64; 6],
    /// Triangles of this surface.
    pub triangles: u64,
    /// Distinct vertices of this surface: a vertex shared by regions counts once.
    pub vertices: u64,
    /// Decimated cubes whose corners all have the same sign: they emit no triangles.
    pub lost_cubes: u64,
    /// Vertices on a coarser leaf's face that stayed, because that leaf has no segment there to move to.
    pub unpatched_vertices: u64,
    /// Device time by stage, milliseconds by the device's own events.
    pub stages_ms: BTreeMap<String, f64>,
    /// Milliseconds from the start of the work to the surface, without time spent waiting for the device or reading files.
    pub wall_ms: f64,
    /// Peak of bytes allocated on the device beyond resident volumes.
    pub device_bytes: u64,
    /// Bytes of the resident volumes this surface was made from.
    pub volume_bytes: u64,
    /// Name of the device.
    pub device: String,
    /// The shape of a file's surface. Never in the stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "typescript", ts(optional))]
    pub shape: Option<Shape>,
    /// What the format of a file could not keep. Never in the stream.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "typescript", ts(as = "Option<Vec<String>>", optional))]
    pub notices: Vec<String>,
}

impl ExtractionStatistics {
    /// Names of the costs of making a surface, which differ from one run to the next.
    const COSTS: [&str; 4] = ["stagesMs", "wallMs", "deviceBytes", "volumeBytes"];

    /// Returns the statistics of the surface alone, without the costs of making it, as a JSON object.
    pub fn of_surface(&self) -> serde_json::Value {
        let mut json = serde_json::to_value(self).unwrap_or_default();
        if let Some(object) = json.as_object_mut() {
            object.retain(|name, _| !Self::COSTS.contains(&name.as_str()));
        }
        json
    }

    /// Merges the statistics of the surfaces in one file.
    ///
    /// - Counts and times are sums. Measured error, tolerance and bytes are maxima.
    /// - Guards that gave way and notices are those of any surface.
    /// - `is_tree_cut` is true only if all surfaces are tree cuts. Several surfaces have no estimated errors.
    /// - All other values are those of the first surface.
    pub fn of_several(surfaces: Vec<Self>) -> Self {
        let mut surfaces = surfaces.into_iter();
        let mut sum = surfaces.next().unwrap_or_default();
        for next in surfaces {
            sum.add(next);
        }
        sum
    }

    /// Adds the statistics of a further surface in the same file.
    fn add(&mut self, next: Self) {
        let sum = |a: Option<u64>, b: Option<u64>| a.into_iter().chain(b).reduce(|a, b| a + b);
        self.removed_parts = sum(self.removed_parts, next.removed_parts);
        self.removed_triangles = sum(self.removed_triangles, next.removed_triangles);
        self.unmatched_positions = sum(self.unmatched_positions, next.unmatched_positions);
        self.vanished_parts = self.vanished_parts.zip(next.vanished_parts).map(|(a, b)| a + b);
        for guard in next.gave_way {
            if !self.gave_way.contains(&guard) {
                self.gave_way.push(guard);
            }
        }
        self.is_tree_cut &= next.is_tree_cut;
        self.tolerance = self.tolerance.zip(next.tolerance).map(|(a, b)| a.max(b));
        self.error = self.error.zip(next.error).map(|(a, b)| MeasuredError {
            rms: a.rms.max(b.rms),
            max: a.max.max(b.max),
        });
        (self.estimated_error, self.pixels) = (None, None);
        self.full_triangles += next.full_triangles;
        self.mesher_triangles = self.mesher_triangles.zip(next.mesher_triangles).map(|(a, b)| a + b);
        self.active_cells += next.active_cells;
        for (sum, leaves) in self.leaves.iter_mut().zip(next.leaves) {
            *sum += leaves;
        }
        self.triangles += next.triangles;
        self.vertices += next.vertices;
        self.lost_cubes += next.lost_cubes;
        self.unpatched_vertices += next.unpatched_vertices;
        for (stage, milliseconds) in next.stages_ms {
            *self.stages_ms.entry(stage).or_default() += milliseconds;
        }
        self.wall_ms += next.wall_ms;
        self.device_bytes = self.device_bytes.max(next.device_bytes);
        self.volume_bytes = self.volume_bytes.max(next.volume_bytes);
        self.shape = None;
        for notice in next.notices {
            if !self.notices.contains(&notice) {
                self.notices.push(notice);
            }
        }
    }

    /// Combines the kernels' statistics with the view, the time and the device. `smallest`: the device's unit of length, in world units.
    pub fn new(
        kernels: &isopeel_kernels::SurfaceStatistics,
        view: &View,
        smallest: f64,
        wall: Duration,
        device: &str,
    ) -> Self {
        let mut stages_ms = BTreeMap::new();
        for stage in &kernels.stages {
            *stages_ms.entry(stage.stage.to_owned()).or_default() += stage.milliseconds;
        }
        let is_tree_cut = view.is_by_error() && view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
        Self {
            mesher: view.mesher,
            beta: view.beta_in_force(),
            // JSON has no infinity, but the tolerance is infinite if everything was merged that can be, or negative infinity if nothing
            // was.
            tolerance: view.tolerance_in_force(smallest).map(|tolerance| match tolerance {
                ..0.0 => NOTHING_MERGED,
                f32::MAX.. => in_world(kernels.estimate.worst_leaf, smallest),
                _ => in_world(tolerance, smallest),
            }),
            max_error: view.max_error_in_force().map(|distance| distance.world(smallest)),
            topology: match view.topology_in_force() {
                Topology::Preserve => TopologyName::Preserve,
                Topology::Free => TopologyName::Free,
            },
            feature_range: view.feature_range.filter(|_| view.feature != FeatureName::None),
            gave_way: view.gave_way(smallest),
            is_tree_cut,
            error: kernels.error.and_then(|error| MeasuredError::in_world(error, smallest)),
            estimated_error: Some(EstimatedError::in_world(kernels.estimate, smallest)),
            pixels: view.fitted.and_then(|fitted| fitted.pixels),
            full_triangles: kernels.full_triangles,
            mesher_triangles: kernels.mesher_triangles,
            removed_parts: kernels.removed.map(|removed| removed.parts),
            removed_triangles: kernels.removed.map(|removed| removed.full_triangles),
            unmatched_positions: kernels.removed.map(|removed| removed.unmatched),
            vanished_parts: is_tree_cut.then_some(kernels.vanished_parts),
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
            shape: None,
            notices: Vec::new(),
        }
    }
}
