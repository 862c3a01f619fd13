//! How the estimated error of a cut grows with its threshold.

use super::args::kernel_args;
use super::cut::Criterion;
use super::fit::Keys;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::{CutParams, Grid};
use crate::{Pyramid, Result, VertexTree, Volume, constants};

/// Name of the stage.
pub const STAGE: &str = "curve";

kernel_args! {
    /// Arguments of `curve_cut` and `curve_tree`.
    CurveArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the cut depends on; its threshold is not read.
        params: CutParams,
        /// First key of bin 1.
        first_key: u32,
        /// A bin holds 2^shift keys.
        shift: u32,
        /// Active regions, or blocks of the vertex tree.
        regions: u32,
    }
}

/// Work-groups, each with bins of its own, which the host adds up: enough for a large GPU.
const GROUPS: usize = 128;

fn args(volume: &Volume, regions: usize, params: CutParams, range: Keys) -> CurveArgs {
    CurveArgs {
        grid: volume.layout(),
        params,
        first_key: range.first,
        shift: range.shift,
        regions: regions as u32,
    }
}

/// Launches a kernel of this stage, whose last argument receives the changes per bin of each work-group, and adds them up.
fn run(cx: &Context, volume: &Volume, pyramid: &Pyramid, kernel: &str, inputs: &[&dyn Arg]) -> Result<Vec<f64>> {
    let (bins, groups) = (constants::FIT_BINS as usize, GROUPS.min(pyramid.host_regions.len()));
    let changes = cx.buffer::<f32>(STAGE, groups * bins)?;
    let args = [inputs, &[&changes]].concat();
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, kernel)?,
        groups,
        cx.tuning.region_group,
        &args,
    )?;
    let mut sums = vec![0.0; bins];
    for of_group in cx.read(STAGE, &changes, changes.len())?.chunks_exact(bins) {
        for (sum, &change) in sums.iter_mut().zip(of_group) {
            *sum += f64::from(change);
        }
    }
    Ok(sums)
}

/// For cuts of cubes, returns the change of the summed squared errors, weighted by triangles, when the threshold passes each bin.
/// `keys`: of [`super::fit::run`].
pub fn of_cut(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    criterion: &Criterion,
    range: Keys,
    keys: &Buffer<u32>,
) -> Result<Vec<f64>> {
    let inputs: [&dyn Arg; 8] = [
        &args(volume, pyramid.host_regions.len(), criterion.params, range),
        &criterion.points,
        &criterion.interests,
        &pyramid.regions,
        &pyramid.bricks,
        &pyramid.nodes,
        &pyramid.vertex_records,
        keys,
    ];
    run(cx, volume, pyramid, "curve_cut", &inputs)
}

/// For cuts of the vertex tree, returns the change of the summed squared errors, weighted by area, when the tolerance passes each bin.
pub fn of_tree(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    params: CutParams,
    tree: &VertexTree,
    range: Keys,
    keys: &Buffer<u32>,
) -> Result<Vec<f64>> {
    let built = &tree.built;
    let inputs: [&dyn Arg; 5] = [
        &args(volume, tree.blocks.len(), params, range),
        &built.regions,
        &built.node_errors,
        &built.node_parents,
        keys,
    ];
    run(cx, volume, pyramid, "curve_tree", &inputs)
}
