//! Cuts of the vertex tree.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::{CutParams, NONE, RegionMesh, TreeCutRegion};
use crate::lock::lock;
use crate::stages::cut::Criterion;
use crate::stages::fit::Keys;
use crate::tree::{Importances, LeftOut, RegionWeights, VertexTree};
use crate::{Level, Pyramid, Result, Volume, constants};
use std::ops::Range;
use std::sync::Arc;

/// Name of the stage.
pub const STAGE: &str = "tree_cut";

kernel_args! {
    /// Arguments of `tree_weigh`.
    TreeWeighArgs {
        /// What the importance depends on.
        params: CutParams,
        /// First block of this launch.
        first_block: u32,
        /// Number of regions, which are the first blocks.
        regions: u32,
        /// Number of the block of nodes at which parts vanish, or `NONE`.
        vanishing: u32,
    }
    /// Arguments of `tree_lower`.
    TreeLowerArgs {
        /// First block of this launch.
        first_block: u32,
        /// Number of regions, which are the first blocks.
        regions: u32,
        /// First node above the regions.
        first_above: u32,
        /// Number of the block of nodes at which parts vanish, or `NONE`.
        vanishing: u32,
    }
    /// Arguments of `tree_keys`.
    TreeKeysArgs {
        /// 1: nodes have importances; 0: these are 0.
        has_importances: u32,
        /// 1: regions have weights; 0: these are 1.
        has_weights: u32,
        /// 1: with weights of regions, errors count as the next power of four.
        in_steps: u32,
        /// With weights of regions: nodes whose error over weight, without those, is above this one are never merged.
        guard: f32,
        /// First block of this launch.
        first_block: u32,
        /// Number of regions, which are the first blocks.
        regions: u32,
        /// First node above the regions.
        first_above: u32,
    }
    /// Arguments of `tree_histogram`.
    TreeHistogramArgs {
        /// First key of bin 1.
        first_key: u32,
        /// A bin holds 2^shift keys.
        shift: u32,
        /// Number of keys, including those of slots without a node.
        nodes: u32,
    }
    /// Arguments of `tree_leaves`.
    TreeLeavesArgs {
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// Points of the surface.
        points: u32,
        /// 1: there was no cut of the same tolerance before this one.
        first: u32,
        /// 1: parts are left out; 0: none are.
        removes: u32,
        /// First block of this launch.
        first_block: u32,
        /// Number of regions, which are the first blocks.
        regions: u32,
    }
}

/// Mask of the number in a packed leaf, as stored for each point; the level begins at [`LEAF_LEVEL_SHIFT`] (`cl/lib/tree_leaf.h`).
pub const LEAF_NUMBER: u32 = 0x0fff_ffff;
/// See [`LEAF_NUMBER`].
pub const LEAF_LEVEL_SHIFT: u32 = 28;

/// Keys that one work-group of `tree_histogram` counts.
const HISTOGRAM_KEYS: usize = 8192;

/// Cuts a tree: the state that all launches of a cut have in common.
pub struct Cutter<'a> {
    pub cx: &'a Context,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    pub tree: &'a VertexTree,
    /// Parts that cuts leave out.
    pub left_out: Option<Arc<LeftOut>>,
    /// Whether small parts may vanish.
    pub may_vanish: bool,
    /// Weights beside those of importance.
    pub weights: Option<CutWeights>,
}

/// Weights of regions and of the nodes above them, on the device.
pub struct CutWeights {
    pub of_regions: Buffer<f32>,
    /// Of each node above the regions the minimum of its points' regions, as bits.
    pub of_nodes: Buffer<u32>,
    /// Whether errors count as the next power of four.
    pub in_steps: bool,
    /// See [`TreeKeysArgs::guard`].
    pub guard: f32,
}

/// State of a cut that is repeated until its topology is that of the full mesh.
pub struct CutWork {
    /// 1: the node is never merged.
    pub(super) marks: Buffer<u8>,
    /// Of each block, whether there are new marks.
    pub(super) marked: Buffer<u32>,
    /// Of each block, whether its keys differ from those of the previous cut.
    pub(super) renewed: Buffer<u32>,
    pub keys: Buffer<u32>,
    /// The leaf of each node that is merged, and of each point.
    pub(super) tops: Buffer<u32>,
    pub leaves: Buffer<u32>,
    /// Region by region, the points whose leaf differs from that in the previous cut; then their number per region.
    pub(super) changed: Buffer<u32>,
    pub(super) changed_counts: Buffer<u32>,
    /// Triangles that each block's merged nodes remove.
    merged: Buffer<u32>,
    /// Triangles by region and level, and their numbers.
    pub(super) meshes: Buffer<RegionMesh>,
    pub(super) left: Buffer<u32>,
    /// Of each region, whether a point there has too few triangles around it.
    pub(super) broken: Buffer<u32>,
    /// Of each region, whether `left` is outdated because of a repair.
    pub(super) stale: Buffer<u32>,
    /// Data around each leaf, and edges, used while a cut is tested.
    pub(super) around: Buffer<u32>,
    pub(super) edges: Buffer<u32>,
    /// Tolerance of the last cut; NaN before the first.
    pub(super) tolerance: f32,
    /// Whether the last cut was the first one of its tolerance.
    pub is_first: bool,
}

impl CutWork {
    /// Returns the buffers that define the cut: the key of each node, and the leaf of each point.
    pub fn into_keys_and_leaves(self) -> (Buffer<u32>, Buffer<u32>) {
        (self.keys, self.leaves)
    }
}

impl Cutter<'_> {
    /// One work-group a region.
    pub(super) fn launch_regions(&self, stage: &'static str, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(stage, kernel, self.regions(), self.cx.tuning.region_group, args)
    }

    /// One wide work-group a region.
    pub(super) fn launch_wide(&self, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(STAGE, kernel, self.regions(), self.cx.tuning.wide_group, args)
    }

    /// `groups` work-groups of `local` work-items.
    pub(super) fn launch_groups(
        &self,
        stage: &'static str,
        kernel: &str,
        groups: usize,
        local: usize,
        args: &[&dyn Arg],
    ) -> Result<()> {
        self.cx.launch(
            stage,
            &self.cx.kernel(self.volume.sample_type, kernel)?,
            groups,
            local,
            args,
        )
    }

    pub(super) fn regions(&self) -> usize {
        self.pyramid.host_regions.len()
    }

    /// The blocks of each level, beginning with the regions.
    fn levels(&self) -> &[Range<usize>] {
        &self.tree.block_levels
    }

    /// One work-group a block of a level. `args` takes the number of the first one.
    fn launch_level(&self, kernel: &str, blocks: &Range<usize>, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(STAGE, kernel, blocks.len(), self.cx.tuning.region_group, args)
    }

    /// Returns the bits of the maximum importance of the points below each node; `None` if all are 0.
    pub fn importances(&self, params: &crate::CutParams) -> Result<Option<Arc<Buffer<u32>>>> {
        if !params.has_importance() {
            return Ok(None);
        }
        let last = lock(&self.tree.importances).clone();
        if let Some(last) = last.filter(|last| last.params.has_importance_of(params)) {
            return Ok(Some(last.bits));
        }
        let bits = Arc::new(self.weigh(&Criterion::upload(self.cx, params, Level::FINEST)?)?);
        *lock(&self.tree.importances) = Some(Importances {
            params: params.clone(),
            bits: Arc::clone(&bits),
        });
        Ok(Some(bits))
    }

    fn weigh(&self, criterion: &Criterion) -> Result<Buffer<u32>> {
        let importances = self.cx.zeroed(STAGE, self.tree.built.nodes.len())?;
        for blocks in self.levels() {
            let args = TreeWeighArgs {
                params: criterion.params,
                first_block: blocks.start as u32,
                regions: self.regions() as u32,
                vanishing: self.tree.vanishing.map_or(NONE, |block| block as u32),
            };
            self.launch_level(
                "tree_weigh",
                blocks,
                &[
                    &args,
                    &criterion.points,
                    &criterion.interests,
                    &self.pyramid.regions,
                    &self.tree.built.regions,
                    &self.tree.built.node_parents,
                    &self.tree.built.round_ends,
                    &self.tree.built.point_parents,
                    &self.tree.points,
                    &self.pyramid.nodes,
                    &importances,
                ],
            )?;
        }
        Ok(importances)
    }

    /// Puts weights of regions on the device.
    pub fn upload_weights(&self, weights: &RegionWeights, guard: f32) -> Result<CutWeights> {
        let of_regions = self.cx.upload(STAGE, &weights.of_regions)?;
        let above = self.tree.built.nodes.len() - self.first_above() as usize;
        let of_nodes = self.cx.filled(STAGE, above, f32::INFINITY.to_bits())?;
        for blocks in self.levels() {
            let args = TreeLowerArgs {
                first_block: blocks.start as u32,
                regions: self.regions() as u32,
                first_above: self.first_above(),
                vanishing: self.tree.vanishing.map_or(NONE, |block| block as u32),
            };
            self.launch_level(
                "tree_lower",
                blocks,
                &[
                    &args,
                    &self.pyramid.regions,
                    &self.tree.built.regions,
                    &self.tree.built.node_parents,
                    &self.tree.built.round_ends,
                    &self.tree.built.point_parents,
                    &of_regions,
                    &of_nodes,
                ],
            )?;
        }
        Ok(CutWeights {
            of_regions,
            of_nodes,
            in_steps: weights.in_steps,
            guard,
        })
    }

    /// The first node above the regions.
    fn first_above(&self) -> u32 {
        self.tree.first_above() - self.tree.point_count()
    }

    /// Triangles of the full dual mesh, without the parts that cuts leave out.
    pub fn full_triangles(&self) -> u64 {
        self.tree.full_triangles - self.left_out.as_ref().map_or(0, |left_out| left_out.triangles)
    }

    /// Root mean square distance, in world units, of a cut whose leaves' squared errors add up to `error2`. The mean is over the area of
    /// the full surface without the parts that cuts leave out.
    pub fn rms(&self, error2: f64) -> f32 {
        let regions = self.tree.blocks[..self.regions()].iter();
        let area = match &self.left_out {
            Some(left_out) => left_out.area_left,
            None => regions.map(|region| f64::from(region.area)).sum::<f64>(),
        };
        if area <= 0.0 {
            return 0.0;
        }
        (f64::from(self.volume.grid.smallest_spacing()) * (error2.max(0.0) / area).sqrt()) as f32
    }

    /// Allocates the state of a cut.
    pub fn begin(&self) -> Result<CutWork> {
        let (nodes, points) = (self.tree.built.nodes.len(), self.tree.points.len());
        let triangles = self.tree.full_triangles as usize + self.tree.beside.len();
        let blocks = self.tree.blocks.len();
        let edge_words = if self.cx.tuning.region_group == 1 { 2 } else { 1 };
        let mut marks = self.cx.zeroed(STAGE, nodes)?;
        if !self.may_vanish {
            let kept = self.tree.vanishing_nodes();
            self.cx.write_at(STAGE, &mut marks, kept.start, &vec![1; kept.len()])?;
        }
        if let Some(left_out) = &self.left_out {
            self.mark_removed(&left_out.points, &marks)?;
        }
        Ok(CutWork {
            marks,
            marked: self.cx.filled(STAGE, blocks, 1)?,
            renewed: self.cx.buffer(STAGE, blocks)?,
            // A slot without a node has a key above infinity.
            keys: self.cx.filled(STAGE, nodes, u32::MAX)?,
            tops: self.cx.buffer(STAGE, nodes)?,
            leaves: self.cx.buffer(STAGE, points)?,
            changed: self.cx.buffer(STAGE, points)?,
            changed_counts: self.cx.buffer(STAGE, blocks)?,
            merged: self.cx.buffer(STAGE, blocks)?,
            meshes: self.cx.upload(STAGE, &vec![RegionMesh::default(); self.regions()])?,
            left: self.cx.buffer(STAGE, triangles)?,
            broken: self.cx.buffer(STAGE, self.regions())?,
            stale: self.cx.buffer(STAGE, self.regions())?,
            around: self.cx.buffer(STAGE, self.tree.leaf_count())?,
            // A region's table has an entry of EDGE_WORDS (`cl/lib/tree_edges.h`) for each corner, and one that stays free.
            edges: self.cx.buffer(STAGE, edge_words * (3 * triangles + self.regions()))?,
            tolerance: f32::NAN,
            is_first: true,
        })
    }

    /// Fills in each node's key.
    pub fn keys(&self, importances: Option<&Buffer<u32>>, work: &CutWork) -> Result<()> {
        let has_importances = u32::from(importances.is_some());
        // If there are no importances or weights, any buffer serves as the argument.
        let importances = importances.unwrap_or(&self.tree.built.point_parents);
        let (of_regions, of_nodes): (&dyn Arg, &dyn Arg) = match &self.weights {
            Some(weights) => (&weights.of_regions, &weights.of_nodes),
            None => (&self.tree.built.point_parents, &self.tree.built.point_parents),
        };
        // Keys depend on those of the nodes above.
        for blocks in self.levels().iter().rev() {
            let args = TreeKeysArgs {
                has_importances,
                has_weights: self.weights.is_some().into(),
                in_steps: self.weights.as_ref().is_some_and(|weights| weights.in_steps).into(),
                guard: self.weights.as_ref().map_or(f32::INFINITY, |weights| weights.guard),
                first_block: blocks.start as u32,
                regions: self.regions() as u32,
                first_above: self.first_above(),
            };
            self.launch_level(
                "tree_keys",
                blocks,
                &[
                    &args,
                    &self.tree.built.regions,
                    &self.tree.built.node_errors,
                    &self.tree.built.node_parents,
                    &self.tree.built.round_ends,
                    importances,
                    of_regions,
                    of_nodes,
                    &work.marks,
                    &work.marked,
                    &work.renewed,
                    &work.keys,
                ],
            )?;
        }
        Ok(())
    }

    /// Returns the triangles removed once the tolerance passes each bin; the first bin is for keys before all others.
    pub fn histogram(&self, keys: &Buffer<u32>, range: Keys) -> Result<Vec<u32>> {
        let removed = self.cx.filled(STAGE, constants::FIT_BINS as usize, 0)?;
        let args = TreeHistogramArgs {
            first_key: range.first,
            shift: range.shift,
            nodes: keys.len() as u32,
        };
        let groups = keys.len().div_ceil(HISTOGRAM_KEYS);
        let local = self.cx.tuning.region_group;
        self.launch_groups(STAGE, "tree_histogram", groups, local, &[&args, keys, &removed])?;
        self.cx.read(STAGE, &removed, removed.len())
    }

    /// Cuts the tree: finds the leaf of each point. After a repair, only blocks with new keys are cut again.
    pub fn leaves(&self, work: &mut CutWork, tolerance: f32) -> Result<()> {
        work.is_first = tolerance != work.tolerance;
        work.tolerance = tolerance;
        // If nothing is left out, any buffer serves as this argument.
        let removed: &dyn Arg = match &self.left_out {
            Some(left_out) => &left_out.points,
            None => &self.tree.points,
        };
        for blocks in self.levels().iter().rev() {
            let args = TreeLeavesArgs {
                tolerance,
                points: self.tree.point_count(),
                first: work.is_first.into(),
                removes: self.left_out.is_some().into(),
                first_block: blocks.start as u32,
                regions: self.regions() as u32,
            };
            self.launch_level(
                "tree_leaves",
                blocks,
                &[
                    &args,
                    &self.pyramid.regions,
                    &self.tree.built.regions,
                    &self.tree.built.node_levels,
                    &self.tree.built.node_parents,
                    &self.tree.built.round_ends,
                    &self.tree.built.point_parents,
                    removed,
                    &work.keys,
                    &work.renewed,
                    &work.tops,
                    &work.leaves,
                    &work.changed,
                    &work.changed_counts,
                    &work.merged,
                ],
            )?;
        }
        Ok(())
    }

    /// Marks nodes and all their ancestors, so that no tolerance merges them. The next cut is computed from the beginning.
    pub fn forbid(&self, work: &mut CutWork, nodes: &[u32]) -> Result<()> {
        let count = self.tree.built.nodes.len();
        let parents = self.cx.read(STAGE, &self.tree.built.node_parents, count)?;
        let mut marks = self.cx.read(STAGE, &work.marks, count)?;
        for &node in nodes {
            let mut at = node;
            while at != NONE {
                marks[at as usize] = 1;
                at = parents[at as usize];
            }
        }
        // A part vanishes as a whole.
        for node in self.tree.vanishing_nodes().rev() {
            let parent = parents[node];
            if parent != NONE && marks[parent as usize] != 0 {
                marks[node] = 1;
            }
        }
        work.marks = self.cx.upload(STAGE, &marks)?;
        work.marked = self.cx.filled(STAGE, work.marked.len(), 1)?;
        work.tolerance = f32::NAN;
        Ok(())
    }

    /// Triangles of a cut: those of the full mesh less those that its merged nodes remove.
    pub fn triangles(&self, work: &CutWork) -> Result<u64> {
        let merged = self.merged(work)?;
        Ok(self.full_triangles() - merged.into_iter().map(u64::from).sum::<u64>())
    }

    /// Triangles that the merged nodes of each block remove.
    fn merged(&self, work: &CutWork) -> Result<Vec<u32>> {
        self.cx.read(STAGE, &work.merged, work.merged.len())
    }

    /// Whether nodes of levels above the regions are merged in a cut, besides those at which parts vanish.
    pub(super) fn merges_above(&self, work: &CutWork) -> Result<bool> {
        let above = self.regions()..self.tree.vanishing.unwrap_or(self.tree.blocks.len());
        Ok(self.tree.nodes_above() > 0 && self.merged(work)?[above].iter().any(|&removed| removed > 0))
    }

    /// Sums over each block's leaves.
    pub fn sums(&self, work: &CutWork) -> Result<Vec<TreeCutRegion>> {
        let blocks = 0..self.tree.blocks.len();
        let sums = self.cx.buffer(STAGE, blocks.len())?;
        self.launch_level(
            "tree_sum",
            &blocks,
            &[
                &self.tree.point_count(),
                &(self.regions() as u32),
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.node_errors,
                &self.tree.built.node_levels,
                &work.tops,
                &work.leaves,
                &sums,
            ],
        )?;
        self.cx.read(STAGE, &sums, blocks.len())
    }

    /// Each region's triangles, by level.
    pub fn meshes(&self, work: &CutWork) -> Result<Vec<RegionMesh>> {
        self.cx.read(STAGE, &work.meshes, self.regions())
    }
}
