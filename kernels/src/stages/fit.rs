//! Number of leaves of a cut as a function of its threshold.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, Grid};
use crate::stages::cut::Criterion;
use crate::{Pyramid, Result, Volume, constants};

/// Name of the stage.
pub const STAGE: &str = "fit";

kernel_args! {
    /// Arguments of `fit`.
    FitArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the cut depends on; its β is not read.
        params: CutParams,
        /// First key of bin 1.
        first_key: u32,
        /// A bin holds 2^shift keys.
        shift: u32,
    }
}

/// Bins beside those before and behind all others.
pub const INNER_BINS: usize = constants::FIT_BINS as usize - 2;

/// Keys of β by bin: `first`, then bins of 2^`shift` keys each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keys {
    pub first: u32,
    pub shift: u32,
}

/// Returns the change of the number of leaves when the threshold passes each bin, and each node's key. The first bin holds keys below
/// all others.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    criterion: &Criterion,
    range: Keys,
) -> Result<(Vec<i32>, Buffer<u32>)> {
    let keys: Buffer<u32> = cx.buffer(STAGE, pyramid.nodes.len())?;
    let changes = cx.filled(STAGE, constants::FIT_BINS as usize, 0)?;
    let args = FitArgs {
        grid: volume.layout(),
        params: criterion.params,
        first_key: range.first,
        shift: range.shift,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "fit")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[
            &args,
            &criterion.points,
            &criterion.interests,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            &pyramid.vertex_records,
            &keys,
            &changes,
        ],
    )?;
    let changes = cx.read(STAGE, &changes, changes.len())?;
    Ok((changes.into_iter().map(u32::cast_signed).collect(), keys))
}
