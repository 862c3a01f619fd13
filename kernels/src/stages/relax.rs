//! Vertices of cells, moved towards the crossings around them.

use super::SlabWork;
use super::construct::Input;
use crate::Result;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Node, Placement};
use crate::program::brick_group;

/// Name of the stage.
pub const STAGE: &str = "relax";

/// Moves the vertices of level 0 in `placements`.
pub fn run(cx: &Context, input: &Input<'_>, nodes: &Buffer<Node>, placements: &Buffer<Placement>) -> Result<()> {
    let kernels = cx.kernels(input.volume.sample_type)?;
    let grid = input.volume.layout();
    for SlabWork {
        samples, z0, bricks, ..
    } in input.work
    {
        cx.launch(
            STAGE,
            kernels.get("relax"),
            bricks.len(),
            brick_group(cx.found.info.kind),
            &[
                &grid,
                *samples,
                z0,
                &input.iso,
                &(bricks.start as u32),
                input.regions,
                input.bricks,
                nodes,
                placements,
            ],
        )?;
    }
    Ok(())
}
