//! The cut: the cubes that represent the surface below them (docs/algorithm.md#4-importance-and-cut).

use std::collections::BTreeMap;

use crate::interest::{CellBox, raise};
use crate::{Node, Pyramid};
use isopeel_kernels::{CutParams, Level, Mesher};

/// A leaf: level and cube coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Leaf {
    /// 0 is a single cell.
    pub level: u8,
    /// Cell coordinates shifted right by the level.
    pub cube: [u32; 3],
}

impl Leaf {
    /// The region of 32³ cells that holds it.
    pub fn region(&self) -> [u32; 3] {
        self.cube.map(|c| c >> (5 - self.level))
    }
}

/// The leaves of a cut, each of which represents the active cells below it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cut {
    /// For each active cell the leaf above it (itself, at level 0).
    pub leaf_of: BTreeMap<[u32; 3], Leaf>,
    /// All leaves with their nodes, finest first.
    pub leaves: BTreeMap<Leaf, Node>,
}

impl Cut {
    /// Leaves of each level, 0 first.
    pub fn counts(&self) -> [u64; 6] {
        let mut counts = [0; 6];
        self.leaves.keys().for_each(|l| counts[usize::from(l.level)] += 1);
        counts
    }

    /// Decimated cubes whose corners all have one sign: marching cubes emits nothing for them.
    pub fn lost_cubes(&self) -> u64 {
        self.leaves.values().filter(|n| n.signs == 0 || n.signs == 255).count() as u64
    }
}

/// User feature over its range, `f̂` in [0, 1]. A division, not a product with the reciprocal: of 8-bit features many
/// nodes lie exactly at a threshold such as 25.5 of 255, which the product misses by one unit in the last place.
pub fn normalised_feature(f: f32, params: &CutParams) -> f32 {
    let [lo, hi] = params.feature_range;
    ((f.abs() - lo) / (hi - lo)).clamp(0.0, 1.0)
}

/// Importance of a node above level 0 in a volume of `dims` samples: eq. 3, raised if its cube meets a region of interest.
pub fn importance(node: &Node, leaf: Leaf, dims: [u32; 3], params: &CutParams) -> f32 {
    let cube = CellBox::cube(leaf.level, leaf.cube, dims);
    raise(importance_of(node.s, node.f, params), params, cube)
}

/// Error of a node above level 0 as the cut by error compares it with its tolerance: summed over the surface below, in which three
/// triangles are one square of the spacing. If all corners have one sign, the surface between them vanishes, so the diagonal counts too.
/// `error`: of its vertex.
pub fn summed_error(node: &Node, level: u8, spacing: [f32; 3], error: f32) -> f32 {
    let diagonal = spacing.map(|s| s * s).iter().sum::<f32>().sqrt() * f32::from(1u8 << level);
    let vanishes = node.signs == 0 || node.signs == 255;
    let counted = if vanishes { error + diagonal } else { error };
    counted * (node.count as f32 / 3.0).max(1.0).sqrt()
}

/// The input of the transfer function: smoothness `s` blended with the user feature `f`, eq. 3.
pub fn blended_feature(s: f32, f: f32, params: &CutParams) -> f32 {
    (1.0 - params.alpha) * s + params.alpha * normalised_feature(f, params)
}

/// Importance of a smoothness feature and a user feature, eq. 3.
pub fn importance_of(s: f32, f: f32, params: &CutParams) -> f32 {
    params.transfer.importance(blended_feature(s, f, params))
}

/// Cuts top-down: the coarsest node of level 1 to `max_level` that is not `missing` and has `I <= β` is a leaf; so is an
/// undecided node of level `prefix` (above 0), for the dual mesher also one that is `missing`; active cells below none are leaves of level 0.
pub fn cut(pyramid: &Pyramid, params: &CutParams, prefix: Level) -> Cut {
    guarded(pyramid, params, prefix, |_| true)
}

/// As [`cut`], but importance decides only about nodes that the guards `allow`.
pub fn guarded(pyramid: &Pyramid, params: &CutParams, prefix: Level, allow: impl Fn(&Leaf) -> bool) -> Cut {
    let mut result = Cut::default();
    for (&cell, own) in &pyramid.nodes[0] {
        let coarsest = params.max_level.get().max(prefix.get());
        let above = (1..=coarsest).rev().find_map(|level| {
            let leaf = Leaf {
                level,
                cube: cell.map(|c| c >> level),
            };
            let node = pyramid.nodes[usize::from(level)][&leaf.cube];
            let own = importance(&node, leaf, pyramid.dims, params);
            let unimportant = level <= params.max_level.get() && own <= params.beta;
            let decided = !node.missing && unimportant && allow(&leaf);
            let of_prefix = level == prefix.get() && (params.mesher == Mesher::Dual || !node.missing);
            (decided || of_prefix).then_some((leaf, node))
        });
        let (leaf, node) = above.unwrap_or((Leaf { level: 0, cube: cell }, *own));
        result.leaf_of.insert(cell, leaf);
        result.leaves.insert(leaf, node);
    }
    result
}
