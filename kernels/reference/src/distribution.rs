//! Histogram of the blended feature of a cut's leaves over the surface.

use crate::cut::blended_feature;
use crate::tree_cut::{Cutter, TreeLeaf};
use crate::{Cut, Pyramid};
use isopeel_kernels::{CutParams, DistributionCounts};

/// Counts values: smoothness and user feature of each leaf, and whether it is coarse.
fn count(values: impl Iterator<Item = (f32, f32, bool)>, params: &CutParams, bins: u32) -> DistributionCounts {
    let mut counts = DistributionCounts {
        all: vec![0; bins as usize],
        coarse: vec![0; bins as usize],
    };
    for (s, f, is_coarse) in values {
        let bin = ((blended_feature(s, f, params).max(0.0) * bins as f32) as usize).min(bins as usize - 1);
        counts.all[bin] += 1;
        counts.coarse[bin] += u32::from(is_coarse);
    }
    counts
}

/// Of a cut of cubes: each active cell counts once.
pub fn of_cut(pyramid: &Pyramid, cut: &Cut, params: &CutParams, bins: u32) -> DistributionCounts {
    let leaves = cut.leaf_of.values().map(|leaf| {
        let node = &pyramid.nodes[usize::from(leaf.level)][&leaf.cube];
        (node.s, node.f, leaf.level > 0)
    });
    count(leaves, params, bins)
}

/// Of a cut of the vertex tree: each point counts once, except those of removed parts.
pub fn of_tree(
    cutter: &Cutter<'_>,
    leaves: &[TreeLeaf],
    is_removed: impl Fn(usize) -> bool,
    params: &CutParams,
    bins: u32,
) -> DistributionCounts {
    let left = leaves.iter().enumerate().filter(|(point, _)| !is_removed(*point));
    let values = left.map(|(_, leaf)| match *leaf {
        TreeLeaf::Point(point) => {
            let point = &cutter.mesh.points[point];
            (point.s, point.f, false)
        }
        TreeLeaf::Node(id) => {
            let node = cutter.node(id);
            (node.s, node.f, true)
        }
    });
    count(values, params, bins)
}
