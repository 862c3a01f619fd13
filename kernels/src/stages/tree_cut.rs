//! Cuts of the vertex tree, and their meshes.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::{CutParams, Grid, RegionMesh, TreeCutRegion, Vertex};
use crate::stages::cut::Criterion;
use crate::stages::fit::Keys;
use crate::tree::{LeftOut, VertexTree};
use crate::{Level, Pyramid, Result, Volume, constants};
use std::rc::Rc;

/// Name of the stage.
pub const STAGE: &str = "tree_cut";

kernel_args! {
    /// Arguments of `tree_weigh`.
    TreeWeighArgs {
        /// What the importance depends on.
        params: CutParams,
    }
    /// Arguments of `tree_histogram`.
    TreeHistogramArgs {
        /// First key of bin 1.
        first_key: u32,
        /// A bin holds 2^shift keys.
        shift: u32,
        /// Keys, also where there is no node.
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
    }
    /// Arguments of `tree_sum`.
    TreeSumArgs {
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// Points of the surface.
        points: u32,
    }
    /// Arguments of `tree_count`.
    TreeCountArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// 1: there was no cut of the same tolerance before this one.
        first: u32,
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
    }
    /// Arguments of `tree_link`.
    TreeLinkArgs {
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// Entries of the table of edges.
        capacity: u32,
    }
    /// Arguments of `tree_check`.
    TreeCheckArgs {
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// Points of the surface.
        points: u32,
        /// 1: there was no cut of the same tolerance before this one.
        first: u32,
    }
    /// Arguments of `tree_vertices`.
    TreeVerticesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What vertices depend on: the feature's range.
        params: CutParams,
        /// Points of the surface.
        points: u32,
    }
}

/// A leaf as it is kept beside a point: the bits of its number, and where its level begins (`cl/lib/tree_leaf.h`).
pub const LEAF_NUMBER: u32 = 0x0fff_ffff;
/// See [`LEAF_NUMBER`].
pub const LEAF_LEVEL_SHIFT: u32 = 28;

/// Keys that one work-group of `tree_histogram` counts.
const HISTOGRAM_KEYS: usize = 8192;

/// A stage at work on a tree: what all its launches have in common.
pub struct Cutter<'a> {
    pub cx: &'a Context,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    pub tree: &'a VertexTree,
    /// Parts that cuts leave out.
    pub left_out: Option<Rc<LeftOut>>,
}

/// A cut while it is made again and again, until its topology is that of the full mesh.
pub struct CutWork {
    /// 1: the node is never merged.
    marks: Buffer<u8>,
    /// Of each region, whether there are new marks.
    marked: Buffer<u32>,
    /// Of each region, whether its keys are not those of the cut before.
    renewed: Buffer<u32>,
    pub keys: Buffer<u32>,
    /// Of each node, the key of the node above it.
    keys_above: Buffer<f32>,
    /// The leaf of each point, and that of the cut before.
    pub leaves: Buffer<u32>,
    previous: Buffer<u32>,
    /// Triangles by region and level.
    meshes: Buffer<RegionMesh>,
    /// Triangles around each leaf, those of its region and all others; cleared for the first cut to a tolerance.
    around: Buffer<u32>,
    /// Triangles whose leaves are not those of the cut before, and how many each region has.
    changed: Buffer<u32>,
    changed_counts: Buffer<u32>,
    /// Of the last cut; not a number before the first.
    tolerance: f32,
}

impl CutWork {
    /// What says where the cut is: the key of each node, and the leaf of each point.
    pub fn into_keys_and_leaves(self) -> (Buffer<u32>, Buffer<u32>) {
        (self.keys, self.leaves)
    }
}

/// A cut's triangles.
pub struct CutMesh {
    /// Three leaves a triangle.
    pub corners: Buffer<u32>,
    /// Where each region's triangles are.
    pub meshes: Buffer<RegionMesh>,
}

impl Cutter<'_> {
    fn launch(&self, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_regions(STAGE, kernel, args)
    }

    /// One work-group a region.
    pub(super) fn launch_regions(&self, stage: &'static str, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(stage, kernel, self.regions(), args)
    }

    fn launch_groups(&self, stage: &'static str, kernel: &str, groups: usize, args: &[&dyn Arg]) -> Result<()> {
        let kernels = self.cx.kernels(self.volume.sample_type)?;
        self.cx
            .launch(stage, kernels.get(kernel), groups, self.cx.tuning.region_group, args)
    }

    pub(super) fn regions(&self) -> usize {
        self.pyramid.host_regions.len()
    }

    /// The bits of the maximum importance of the points below each node; `None` where all are 0.
    pub fn importances(&self, params: &crate::CutParams) -> Result<Option<Buffer<u32>>> {
        if !params.has_importance() {
            return Ok(None);
        }
        self.weigh(&Criterion::upload(self.cx, params, Level::FINEST)?).map(Some)
    }

    fn weigh(&self, criterion: &Criterion) -> Result<Buffer<u32>> {
        let importances = self.cx.buffer(STAGE, self.tree.built.nodes.len())?;
        let args = TreeWeighArgs {
            params: criterion.params,
        };
        self.launch(
            "tree_weigh",
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
        Ok(importances)
    }

    /// Triangles of the full dual mesh that cuts do not leave out.
    pub fn full_triangles(&self) -> u64 {
        self.tree.full_triangles - self.left_out.as_ref().map_or(0, |left_out| left_out.triangles)
    }

    /// Root mean square distance, in world units, of a cut whose leaves' squared errors add up to `error2`: over the area of the full
    /// surface without what cuts leave out.
    pub fn rms(&self, error2: f64) -> f32 {
        let regions = self.tree.host_regions.iter();
        let area = match &self.left_out {
            Some(left_out) => left_out.area_left,
            None => regions.map(|region| f64::from(region.area)).sum::<f64>(),
        };
        if area <= 0.0 {
            return 0.0;
        }
        (f64::from(self.volume.grid.smallest_spacing()) * (error2.max(0.0) / area).sqrt()) as f32
    }

    /// A cut that is not made yet.
    pub fn begin(&self) -> Result<CutWork> {
        let (nodes, points) = (self.tree.built.nodes.len(), self.tree.points.len());
        let marks = self.cx.zeroed(STAGE, nodes)?;
        if let Some(left_out) = &self.left_out {
            self.mark_removed(&left_out.points, &marks)?;
        }
        Ok(CutWork {
            marks,
            marked: self.cx.filled(STAGE, self.regions(), 1)?,
            renewed: self.cx.buffer(STAGE, self.regions())?,
            // Above infinity where there is no node.
            keys: self.cx.filled(STAGE, nodes, u32::MAX)?,
            keys_above: self.cx.buffer(STAGE, nodes)?,
            leaves: self.cx.buffer(STAGE, points)?,
            previous: self.cx.buffer(STAGE, points)?,
            meshes: self.cx.upload(STAGE, &vec![RegionMesh::default(); self.regions()])?,
            around: self.cx.buffer(STAGE, 0)?,
            changed: self.cx.buffer(STAGE, self.tree.full_triangles as usize)?,
            changed_counts: self.cx.buffer(STAGE, self.regions())?,
            tolerance: f32::NAN,
        })
    }

    /// Fills in each node's key.
    pub fn keys(&self, importances: Option<&Buffer<u32>>, work: &CutWork) -> Result<()> {
        let weighted = u32::from(importances.is_some());
        let importances = importances.unwrap_or(&self.tree.built.point_parents);
        self.launch(
            "tree_keys",
            &[
                &weighted,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.built.node_parents,
                &self.tree.built.round_ends,
                importances,
                &work.marks,
                &work.marked,
                &work.renewed,
                &work.keys,
                &work.keys_above,
            ],
        )
    }

    /// Triangles that go where the tolerance passes each bin; the first bin is for keys before all others.
    pub fn histogram(&self, keys: &Buffer<u32>, range: Keys) -> Result<Vec<u32>> {
        let removed = self.cx.filled(STAGE, constants::FIT_BINS as usize, 0)?;
        let args = TreeHistogramArgs {
            first_key: range.first,
            shift: range.shift,
            nodes: keys.len() as u32,
        };
        let groups = keys.len().div_ceil(HISTOGRAM_KEYS);
        self.launch_groups(STAGE, "tree_histogram", groups, &[&args, keys, &removed])?;
        self.cx.read(STAGE, &removed, removed.len())
    }

    /// Cuts the tree: the leaf of each point, and the triangles that are left. Marks nodes whose merging changes the
    /// topology. Whether there are any; then the keys are to be made again.
    pub fn cut(&self, work: &mut CutWork, tolerance: f32) -> Result<bool> {
        std::mem::swap(&mut work.leaves, &mut work.previous);
        let points = self.tree.point_count();
        let is_first = tolerance != work.tolerance;
        work.tolerance = tolerance;
        let first = is_first.into();
        if is_first {
            work.around = self.cx.zeroed(STAGE, 2 * self.tree.leaf_count())?;
        }
        // Any buffer where nothing is left out.
        let (removes, removed): (u32, &dyn Arg) = match &self.left_out {
            Some(left_out) => (1, &left_out.points),
            None => (0, &self.tree.points),
        };
        let args = TreeLeavesArgs {
            tolerance,
            points,
            first,
            removes,
        };
        self.launch(
            "tree_leaves",
            &[
                &args,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.built.node_parents,
                &self.tree.built.point_parents,
                removed,
                &work.keys,
                &work.renewed,
                &work.previous,
                &work.leaves,
            ],
        )?;
        self.launch(
            "tree_count",
            &[
                &TreeCountArgs {
                    grid: self.volume.layout(),
                    cell_points: self.tree.cell_points,
                    points,
                    first,
                    tolerance,
                },
                &self.pyramid.region_index,
                &work.renewed,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &work.keys,
                &work.leaves,
                &work.previous,
                &work.meshes,
                &work.around,
                &work.changed,
                &work.changed_counts,
            ],
        )?;
        let changed = self.cx.read(STAGE, &work.changed_counts, self.regions())?;
        self.check(work, first, &changed)
    }

    /// Whether merges change the topology. `changed`: how many triangles changed in each region.
    fn check(&self, work: &CutWork, first: u32, changed: &[u32]) -> Result<bool> {
        let points = self.tree.point_count();
        let failed = self.cx.filled(STAGE, 1, 0)?;
        self.link(work, changed, &failed)?;
        self.launch(
            "tree_check",
            &[
                &TreeCheckArgs {
                    tolerance: work.tolerance,
                    points,
                    first,
                },
                &work.renewed,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &work.keys,
                &work.keys_above,
                &work.around,
                &work.marks,
                &work.marked,
                &failed,
            ],
        )?;
        Ok(self.cx.read(STAGE, &failed, 1)?[0] != 0)
    }

    /// Looks for edges of more than two triangles.
    fn link(&self, work: &CutWork, changed: &[u32], failed: &Buffer<u32>) -> Result<()> {
        // Inside the surface one of two triangles looks at an edge, so that half the entries stay free; some always do.
        let mut capacity = 0;
        let ends = changed.iter().map(|triangles| {
            capacity += 3 * triangles + 16;
            capacity
        });
        let table_bases: Vec<u32> = std::iter::once(0).chain(ends).collect();
        let table_bases = self.cx.upload(STAGE, &table_bases)?;
        let edges = self.cx.filled(STAGE, capacity as usize, constants::NONE)?;
        self.launch(
            "tree_link",
            &[
                &TreeLinkArgs {
                    cell_points: self.tree.cell_points,
                    points: self.tree.point_count(),
                    capacity,
                },
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &work.changed,
                &work.changed_counts,
                &self.tree.built.nodes,
                &work.around,
                &table_bases,
                &edges,
                &work.marks,
                &work.marked,
                failed,
            ],
        )
    }

    /// What each region's leaves add up to.
    pub fn sums(&self, work: &CutWork) -> Result<Vec<TreeCutRegion>> {
        let sums = self.cx.buffer(STAGE, self.regions())?;
        let args = TreeSumArgs {
            tolerance: work.tolerance,
            points: self.tree.point_count(),
        };
        self.launch(
            "tree_sum",
            &[
                &args,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &work.keys,
                &work.keys_above,
                &work.leaves,
                &sums,
            ],
        )?;
        self.cx.read(STAGE, &sums, self.regions())
    }

    /// Each region's triangles, by level.
    pub fn meshes(&self, work: &CutWork) -> Result<Vec<RegionMesh>> {
        self.cx.read(STAGE, &work.meshes, self.regions())
    }

    /// Makes the triangles. `meshes`: where each region's go.
    pub fn emit(&self, work: &CutWork, meshes: Buffer<RegionMesh>, triangles: usize) -> Result<CutMesh> {
        let made = CutMesh {
            corners: self.cx.buffer(STAGE, 3 * triangles)?,
            meshes,
        };
        self.launch(
            "tree_emit",
            &[
                &work.tolerance,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &work.keys,
                &work.leaves,
                &made.meshes,
                &made.corners,
            ],
        )?;
        Ok(made)
    }

    /// Replaces leaves by indices of vertices in their region's mesh. `table_bases`: where each region's hash table begins, and the end of
    /// the last. Returns the indices, the leaf of each vertex, and the meshes with their vertices counted.
    pub fn index(&self, mesh: &CutMesh, table_bases: &[u32]) -> Result<(Buffer<u32>, Buffer<u32>, Vec<RegionMesh>)> {
        let entries = table_bases.last().copied().unwrap_or(0) as usize;
        let bases = self.cx.upload(STAGE, table_bases)?;
        let own_firsts: Buffer<u32> = self.cx.buffer(STAGE, self.tree.leaf_count())?;
        let table_leaves: Buffer<u32> = self.cx.buffer(STAGE, entries)?;
        let table_firsts: Buffer<u32> = self.cx.buffer(STAGE, entries)?;
        let indices = self.cx.buffer(STAGE, mesh.corners.len())?;
        let vertex_leaves = self.cx.buffer(STAGE, mesh.corners.len())?;
        self.launch(
            "tree_index",
            &[
                &self.tree.point_count(),
                &self.pyramid.regions,
                &self.tree.built.regions,
                &bases,
                &mesh.corners,
                &own_firsts,
                &table_leaves,
                &table_firsts,
                &indices,
                &vertex_leaves,
                &mesh.meshes,
            ],
        )?;
        let meshes = self.cx.read(STAGE, &mesh.meshes, self.regions())?;
        Ok((indices, vertex_leaves, meshes))
    }

    /// Fills `vertices`.
    pub fn vertices(
        &self,
        params: &CutParams,
        meshes: &Buffer<RegionMesh>,
        vertex_leaves: &Buffer<u32>,
        vertices: &Buffer<Vertex>,
    ) -> Result<()> {
        let args = TreeVerticesArgs {
            grid: self.volume.layout(),
            params: *params,
            points: self.tree.point_count(),
        };
        self.launch(
            "tree_vertices",
            &[
                &args,
                &self.pyramid.regions,
                &self.pyramid.nodes,
                &self.pyramid.vertex_records,
                &self.tree.built.nodes,
                &self.tree.points,
                meshes,
                vertex_leaves,
                vertices,
            ],
        )
    }
}
