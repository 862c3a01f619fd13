//! What is known of the surface next to a position.

use super::args::kernel_args;
use super::cut::Criterion;
use crate::context::Context;
use crate::layout::{CutParams, Grid, NONE, ProbedCell};
use crate::{Pyramid, Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "probe";

kernel_args! {
    /// Arguments of `probe`.
    ProbeArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the importance depends on.
        params: CutParams,
        /// Position in index space.
        x: f32,
        /// As `x`.
        y: f32,
        /// As `x`.
        z: f32,
    }
}

/// The active cell whose vertex is nearest to a position inside the volume; `None` where no cell near it is active.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    criterion: &Criterion,
    [x, y, z]: [f32; 3],
) -> Result<Option<ProbedCell>> {
    let out = cx.buffer::<ProbedCell>(STAGE, 1)?;
    let args = ProbeArgs {
        grid: volume.layout(),
        params: criterion.params,
        x,
        y,
        z,
    };
    cx.launch(
        STAGE,
        cx.kernels(volume.sample_type)?.get("probe"),
        1,
        1,
        &[
            &args,
            &criterion.points,
            &criterion.interests,
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            &pyramid.vertex_records,
            &out,
        ],
    )?;
    let cell = cx.read(STAGE, &out, 1)?[0];
    Ok((cell.slots[0] != NONE).then_some(cell))
}
