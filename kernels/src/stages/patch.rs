//! Moves vertices of finer leaves onto the segments that coarser leaves make on their faces.

use super::args::kernel_args;
use super::march::Gathered;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Counters, Grid, WorkVertex};
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "patch";

kernel_args! {
    /// Arguments of `patch`.
    PatchArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Level whose segments the vertices are moved onto.
        level: u32,
    }
}

/// Moves `vertices`, coarsest deciding level first; `levels` is the coarsest level that has leaves.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    gathered: &Gathered<'_>,
    levels: u32,
    vertices: &Buffer<WorkVertex>,
    counters: &Buffer<Counters>,
) -> Result<()> {
    if levels == 0 {
        return Ok(());
    }
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let local = cx.tuning.region_group;
    let groups = pyramid.host_regions.len();
    let grid = volume.layout();
    let Gathered {
        state, marks, meshes, ..
    } = gathered;
    cx.launch(
        STAGE,
        &kernel("patch_level")?,
        groups,
        local,
        &[
            &grid,
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            *state,
            &marks.refined,
            *meshes,
            vertices,
        ],
    )?;
    for level in (1..=levels).rev() {
        cx.launch(
            STAGE,
            &kernel("patch")?,
            groups,
            local,
            &[
                &PatchArgs { grid, level },
                &pyramid.region_index,
                &pyramid.regions,
                &pyramid.bricks,
                &pyramid.nodes,
                *state,
                &marks.refined,
                &marks.owners,
                *meshes,
                vertices,
                counters,
            ],
        )?;
    }
    Ok(())
}
