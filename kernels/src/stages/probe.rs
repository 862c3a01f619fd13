//! Finds the surface next to positions.

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
        /// How many there are.
        positions: u32,
    }
}

/// The active cells whose vertices are nearest to positions inside the volume; `None` if no cell near it is active.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    criterion: &Criterion,
    positions: &[[f32; 3]],
) -> Result<Vec<Option<ProbedCell>>> {
    let out = cx.buffer::<ProbedCell>(STAGE, positions.len())?;
    let args = ProbeArgs {
        grid: volume.layout(),
        params: criterion.params,
        positions: positions.len() as u32,
    };
    let padded: Vec<[f32; 4]> = positions.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "probe")?,
        positions.len(),
        1,
        &[
            &args,
            &cx.upload(STAGE, &padded)?,
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
    let cells = cx.read(STAGE, &out, positions.len())?;
    Ok(cells
        .into_iter()
        .map(|cell| (cell.slots[0] != NONE).then_some(cell))
        .collect())
}
