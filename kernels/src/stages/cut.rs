//! Decides which nodes are leaves: each leaf represents all nodes below it.

use super::args::kernel_args;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{self, CutParams, Grid, RegionCut};
use crate::{Interest, InterestShape, Level, Mesher, Result, Topology, Volume};

/// Name of the stage.
pub const STAGE: &str = "cut";

kernel_args! {
    /// Arguments of `cut`.
    CutArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the cut depends on.
        params: CutParams,
        /// 1: nodes of all levels exist; 0: those of level 0 alone, which all are leaves.
        whole_pyramid: u32,
    }
}

/// Converts the user's parameters to the kernels' layout.
pub fn layout(params: &crate::CutParams, prefix: Level) -> CutParams {
    let [lo, hi] = params.feature_range;
    CutParams {
        alpha: params.alpha,
        threshold: params.tolerance.unwrap_or(params.beta),
        by_error: params.tolerance.is_some().into(),
        feature_lo: lo,
        feature_span: hi - lo,
        max_level: params.max_level.get().into(),
        prefix: prefix.get().into(),
        // Vertices of the marching-cubes mesher need samples at both ends of their edges.
        fills: (params.mesher == Mesher::Dual).into(),
        points: params.transfer.points().len() as u32,
        interests: params.interest.len() as u32,
        max_error: params.max_error.unwrap_or(f32::INFINITY),
        preserve: (params.topology == Topology::Preserve).into(),
        cap: params.cap.into(),
    }
}

/// Criterion of a cut, in device memory.
pub struct Criterion {
    pub params: CutParams,
    /// Control points of the transfer function.
    pub points: Buffer<[f32; 2]>,
    /// Regions of interest.
    pub interests: Buffer<layout::Interest>,
}

impl Criterion {
    pub fn upload(cx: &Context, params: &crate::CutParams, prefix: Level) -> Result<Self> {
        let points: Vec<[f32; 2]> = params.transfer.points().iter().map(|p| [p.x, p.importance]).collect();
        let interests: Vec<layout::Interest> = params.interest.iter().map(interest).collect();
        Ok(Self {
            params: layout(params, prefix),
            points: cx.upload(STAGE, &points)?,
            interests: cx.upload(STAGE, &interests)?,
        })
    }
}

fn interest(interest: &Interest) -> layout::Interest {
    layout::Interest {
        centre: interest.centre,
        rows: std::array::from_fn(|i| interest.rows[i / 3][i % 3]),
        importance: interest.importance,
        is_cube: (interest.shape == InterestShape::Cube).into(),
    }
}

/// Fills `state`: for each node, the level of the leaf that represents it, or a mark that its leaves are below. Returns sums over the
/// leaves of each region.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    criterion: &Criterion,
    state: &Buffer<u8>,
) -> Result<Vec<RegionCut>> {
    let regions = pyramid.host_regions.len();
    let sums: Buffer<RegionCut> = cx.buffer(STAGE, regions)?;
    let args = CutArgs {
        grid: volume.layout(),
        params: criterion.params,
        whole_pyramid: pyramid.whole.into(),
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "cut")?,
        regions,
        cx.tuning.region_group,
        &[
            &args,
            &criterion.points,
            &criterion.interests,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            &pyramid.vertex_records,
            state,
            &sums,
        ],
    )?;
    cx.read(STAGE, &sums, regions)
}

/// Compares the states of two cuts. Returns for each region one bit per neighbour x + 3 y + 9 z that a node with a different state
/// touches; the region itself is bit 13.
pub fn compare(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    before: &Buffer<u8>,
    after: &Buffer<u8>,
) -> Result<Vec<u32>> {
    let regions = pyramid.host_regions.len();
    let differences: Buffer<u32> = cx.buffer(STAGE, regions)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "cut_compare")?,
        regions,
        cx.tuning.region_group,
        &[&pyramid.regions, &pyramid.nodes, before, after, &differences],
    )?;
    cx.read(STAGE, &differences, regions)
}

/// Fills `state` with that of `after` in the regions whose `takes_after` is 1, else with that of `before`.
pub fn mix(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    takes_after: &[u8],
    before: &Buffer<u8>,
    after: &Buffer<u8>,
    state: &Buffer<u8>,
) -> Result<()> {
    let takes_after = cx.upload(STAGE, takes_after)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "cut_mix")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[&pyramid.regions, &takes_after, before, after, state],
    )
}
