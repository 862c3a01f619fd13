//! Which nodes stand for all below them.

use super::args::kernel_args;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{self, Counters};
use crate::{CutParams, Level, Result, Topology, Volume};

/// Name of the stage.
pub const STAGE: &str = "cut";

kernel_args! {}

/// What the kernels see of the user's parameters.
pub fn layout(params: &CutParams, prefix: Level) -> layout::CutParams {
    let [lo, hi] = params.feature_range;
    layout::CutParams {
        alpha: params.alpha,
        beta: params.beta,
        feature_lo: lo,
        feature_span: hi - lo,
        max_level: params.max_level.get().into(),
        prefix: prefix.get().into(),
        points: params.transfer.points().len() as u32,
        max_error: params.max_error.unwrap_or(f32::INFINITY),
        preserve: (params.topology == Topology::Preserve).into(),
        cap: params.cap.into(),
    }
}

/// Fills `state`: the level of the leaf that stands for each node, or that leaves are below.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    params: &layout::CutParams,
    points: &Buffer<[f32; 2]>,
    state: &Buffer<u8>,
    counters: &Buffer<Counters>,
) -> Result<()> {
    cx.launch(
        STAGE,
        cx.kernels(volume.sample_type)?.get("cut"),
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[
            params,
            points,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            &pyramid.vertex_records,
            state,
            counters,
        ],
    )
}
