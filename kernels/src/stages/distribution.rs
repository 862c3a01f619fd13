//! Histogram of the blended feature over a cut's leaves.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::CutParams;
use crate::{Pyramid, Result, VertexTree, Volume};

/// Name of the stage.
pub const STAGE: &str = "distribution";

kernel_args! {
    /// Arguments of `distribution_cut` and `distribution_tree`.
    DistributionArgs {
        /// What the feature depends on.
        params: CutParams,
        /// Bins from 0 to 1.
        bins: u32,
        /// Points of the vertex tree.
        points: u32,
    }
}

/// Counts of a cut of cubes: first all vertices, then those whose leaf is coarse.
pub fn of_cut(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    params: CutParams,
    state: &Buffer<u8>,
    bins: u32,
) -> Result<Vec<u32>> {
    let counts = cx.filled(STAGE, 2 * bins as usize, 0)?;
    let args = DistributionArgs {
        params,
        bins,
        points: 0,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "distribution_cut")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[&args, &pyramid.regions, &pyramid.bricks, &pyramid.nodes, state, &counts],
    )?;
    cx.read(STAGE, &counts, counts.len())
}

/// As [`of_cut`], for a cut of the vertex tree. `leaves`: the leaf of each point.
pub fn of_tree(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    params: CutParams,
    tree: &VertexTree,
    leaves: &Buffer<u32>,
    bins: u32,
) -> Result<Vec<u32>> {
    let counts = cx.filled(STAGE, 2 * bins as usize, 0)?;
    let args = DistributionArgs {
        params,
        bins,
        points: tree.point_count(),
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "distribution_tree")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[
            &args,
            &pyramid.regions,
            &tree.built.regions,
            &tree.built.nodes,
            &tree.points,
            &pyramid.nodes,
            leaves,
            &counts,
        ],
    )?;
    cx.read(STAGE, &counts, counts.len())
}
